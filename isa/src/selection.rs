//! The instruction set of this machine.

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
    /// The best one of this machine; the environment variable `LUMISCAN_ISA=portable` or `avx2` selects a lesser one.
    #[must_use]
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
