//! From radiance over directions to coefficients.

use crate::factorisation::solution::{DIRECTIONS, directions};
use crate::numerics::sh;
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
