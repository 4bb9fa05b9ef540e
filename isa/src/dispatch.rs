//! Hot loops, compiled once for each instruction set.
//!
//! The only `unsafe` are the two calls in [`dispatch`]. A function with `#[target_feature]` must not run on a CPU without that
//! feature; each call stands behind a run-time check of exactly the features it needs. Nothing else in the functions is unsafe.

use crate::selection::Isa;

/// A hot loop. `run` must be `#[inline(always)]`, so that it is compiled for each instruction set (a closure would stay a
/// separate function, compiled for the baseline).
pub trait Hot {
    /// What it returns.
    type Output;
    /// Runs the loop.
    fn run(self) -> Self::Output;
}

/// Runs a hot loop compiled for `isa`.
#[inline]
#[allow(unsafe_code)]
pub fn dispatch<H: Hot>(isa: Isa, hot: H) -> H::Output {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn avx2<H: Hot>(hot: H) -> H::Output {
            hot.run()
        }
        #[target_feature(enable = "avx2,avx512f,avx512vl,avx512bw,avx512dq")]
        fn avx512<H: Hot>(hot: H) -> H::Output {
            hot.run()
        }
        match isa {
            // SAFETY: the only precondition of `avx2` is a CPU with AVX2, checked in the guard.
            Isa::Avx2 if is_x86_feature_detected!("avx2") => return unsafe { avx2(hot) },
            // SAFETY: the only precondition of `avx512` is a CPU with AVX2 (implied by AVX-512 F) and AVX-512 F, VL, BW and
            // DQ, checked in the guard.
            Isa::Avx512
                if is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512vl")
                    && is_x86_feature_detected!("avx512bw")
                    && is_x86_feature_detected!("avx512dq") =>
            {
                return unsafe { avx512(hot) };
            }
            _ => {}
        }
    }
    let _ = isa;
    hot.run()
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Sum<'a>(&'a [f64]);

    impl Hot for Sum<'_> {
        type Output = f64;

        #[inline(always)]
        fn run(self) -> f64 {
            let mut lanes = [0.0; 8];
            for chunk in self.0.as_chunks::<8>().0 {
                (0..8).for_each(|i| lanes[i] += chunk[i] * chunk[i]);
            }
            lanes.iter().sum()
        }
    }

    #[test]
    fn every_instruction_set_gives_the_same_bits() {
        let values: Vec<f64> = (0..4096).map(|i| (f64::from(i) * 0.37 - 11.0) / 7.0).collect();
        let of = |isa| dispatch(isa, Sum(&values)).to_bits();
        // One that the machine lacks runs as the baseline.
        assert!([Isa::Avx2, Isa::Avx512].iter().all(|isa| of(*isa) == of(Isa::Portable)));
    }
}
