//! Instruction sets of the hot loops, selected once at run time. The code is the same for each, sums are never reordered and
//! products never fused, so the results are the same bits.
//!
//! This file has the only `unsafe` of the crate: the two calls in [`dispatch`]. A function with `#[target_feature]` must not
//! run on a CPU without that feature; each call stands behind a run-time check of exactly the features it needs. Nothing
//! else in the functions is unsafe.

use std::sync::OnceLock;

/// An instruction set of the hot loops.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Isa {
    /// The baseline of the target.
    Portable,
    /// x86-64 with AVX2.
    Avx2,
    /// x86-64 with AVX-512 F, VL, BW, DQ.
    Avx512,
}

impl Isa {
    /// The best one of this machine; `LUMISCAN_ISA=portable` or `avx2` selects a lesser one.
    pub fn detect() -> Self {
        static ISA: OnceLock<Isa> = OnceLock::new();
        *ISA.get_or_init(|| {
            let wish = std::env::var("LUMISCAN_ISA").unwrap_or_default();
            best(&wish)
        })
    }
}

#[cfg(target_arch = "x86_64")]
fn best(wish: &str) -> Isa {
    let avx2 = is_x86_feature_detected!("avx2");
    let avx512 = avx2
        && is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512vl")
        && is_x86_feature_detected!("avx512bw")
        && is_x86_feature_detected!("avx512dq");
    match wish {
        "portable" => Isa::Portable,
        "avx2" if avx2 => Isa::Avx2,
        _ if avx512 => Isa::Avx512,
        _ if avx2 => Isa::Avx2,
        _ => Isa::Portable,
    }
}

#[cfg(not(target_arch = "x86_64"))]
fn best(_wish: &str) -> Isa {
    Isa::Portable
}

/// A hot loop. `run` must be `#[inline(always)]`, so that it is compiled for each instruction set (a closure would stay a
/// separate function, compiled for the baseline).
pub trait Hot {
    /// Runs the loop.
    fn run(self);
}

/// Runs a hot loop compiled for `isa`.
#[inline]
#[allow(unsafe_code)]
pub fn dispatch(isa: Isa, hot: impl Hot) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn avx2(hot: impl Hot) {
            hot.run();
        }
        #[target_feature(enable = "avx2,avx512f,avx512vl,avx512bw,avx512dq")]
        fn avx512(hot: impl Hot) {
            hot.run();
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
    hot.run();
}
