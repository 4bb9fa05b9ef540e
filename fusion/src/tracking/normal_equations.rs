//! Weighted normal equations of Gauss–Newton, summed in a fixed order.

use rayon::prelude::*;

/// Points per rayon task; fixed, so that sums have one order.
pub const CHUNK: usize = 2048;

/// Unknowns: pose (6), brightness gain, brightness offset, read-out time.
const UNKNOWNS: usize = 9;

/// Weighted normal equations H δ = b, `[unknown][unknown]` (upper triangle), with statistics of the residuals.
#[derive(Debug, Clone, Copy)]
pub struct System {
    pub h: [[f64; UNKNOWNS]; UNKNOWNS],
    pub b: [f64; UNKNOWNS],
    /// Number of residuals.
    pub count: usize,
    /// Number of residuals within 3 σ.
    pub inliers: usize,
    /// Sum of |r|, from which the scale is estimated.
    pub absolute: f64,
}

impl System {
    pub const ZERO: Self =
        Self { h: [[0.0; UNKNOWNS]; UNKNOWNS], b: [0.0; UNKNOWNS], count: 0, inliers: 0, absolute: 0.0 };

    /// Adds a residual r with its derivatives j and weight w.
    #[inline(always)]
    pub fn add<const N: usize>(&mut self, j: &[f32; N], r: f32, w: f32) {
        let (r, w) = (f64::from(r), f64::from(w));
        let j = j.map(f64::from);
        for a in 0..N {
            let wj = w * j[a];
            for (h, jc) in self.h[a][a..N].iter_mut().zip(&j[a..]) {
                *h += wj * jc;
            }
            self.b[a] -= wj * r;
        }
    }

    /// Entry of the full symmetric matrix.
    pub fn symmetric(&self, a: usize, c: usize) -> f64 {
        self.h[a.min(c)][a.max(c)]
    }

    fn merge(mut self, other: &Self) -> Self {
        for a in 0..UNKNOWNS {
            for c in a..UNKNOWNS {
                self.h[a][c] += other.h[a][c];
            }
            self.b[a] += other.b[a];
        }
        self.count += other.count;
        self.inliers += other.inliers;
        self.absolute += other.absolute;
        self
    }
}

/// Sums over points in fixed chunks: the result does not depend on the number of threads.
pub fn sum_chunks<T: Sync>(points: &[T], f: impl Fn(&[T]) -> System + Sync + Send) -> System {
    let parts: Vec<System> = points.par_chunks(CHUNK).map(f).collect();
    parts.iter().fold(System::ZERO, |sum, part| sum.merge(part))
}
