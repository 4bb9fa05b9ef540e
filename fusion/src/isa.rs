//! The instruction set the hot loops are compiled for, chosen once at run time. The code is the same for each, sums are
//! never reordered and products never fused, so the results are the same bits.

use std::sync::OnceLock;

/// An instruction set that hot loops are compiled for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Isa {
    /// What the target guarantees.
    Portable,
    /// x86-64 with AVX2.
    Avx2,
    /// x86-64 with AVX-512 F, VL, BW, DQ.
    Avx512,
}

impl Isa {
    /// The best one this machine has; `LUMISCAN_ISA=portable` (or `avx2`) asks for less.
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

/// A hot loop. `run` must be `#[inline(always)]`, so that it is compiled anew for each instruction set (a closure would
/// stay a function of its own, compiled for none of them).
pub trait Hot {
    /// Does the work.
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
            // SAFETY: a safe function whose only precondition is that the CPU has AVX2; `best` (the only source of
            // this variant in use) detected it, and it is checked once more here.
            Isa::Avx2 if is_x86_feature_detected!("avx2") => return unsafe { avx2(hot) },
            // SAFETY: as above; AVX-512 F, VL, BW and DQ are checked here.
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
