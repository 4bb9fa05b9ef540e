//! From radiance over directions to coefficients.

use crate::factorisation::solution::{DIRECTIONS, directions};
use crate::numerics::sh;
use crate::transfer::Transfer;
use nalgebra::DMatrix;

/// Projection of radiance over the directions to coefficients, light = P · radiance: SH values times the solid angle of a
/// direction, `[k][direction]`.
#[derive(Debug, Clone)]
pub struct Projection(DMatrix<f64>);

impl Projection {
    /// For `k` coefficients, at least one.
    #[must_use]
    pub fn new(k: usize) -> Self {
        let mut y = vec![0.0; k];
        let mut projection = DMatrix::zeros(k, DIRECTIONS);
        for (d, direction) in directions().into_iter().enumerate() {
            sh::eval(direction, &mut y);
            projection
                .column_mut(d)
                .iter_mut()
                .zip(&y)
                .for_each(|(p, y)| *p = y * 4.0 * std::f64::consts::PI / DIRECTIONS as f64);
        }
        Self(projection)
    }

    /// For the harmonics of `bands` and, if the transfer has a sun, for one direction more, whose radiance is a coefficient of its own.
    #[must_use]
    pub fn of(transfer: &Transfer, bands: usize) -> Self {
        let Self(mut projection) = Self::new(bands * bands);
        if transfer.traced.sun.is_some() {
            let (k, directions) = projection.shape();
            projection = projection.resize(k + 1, directions + 1, 0.0);
            projection[(k, directions)] = 1.0;
        }
        Self(projection)
    }

    /// Number of directions.
    #[must_use]
    pub fn directions(&self) -> usize {
        self.0.ncols()
    }

    /// Number of coefficients.
    #[must_use]
    pub fn coefficients(&self) -> usize {
        self.0.nrows()
    }

    /// P.
    #[must_use]
    pub fn matrix(&self) -> &DMatrix<f64> {
        &self.0
    }
}
