//! From radiance over directions to coefficients.

use crate::factorisation::solution::{DIRECTIONS, directions};
use crate::numerics::{dense, sh};
use crate::transfer::Transfer;
use nalgebra::{DMatrix, DVector};

/// Projection of radiance over the directions to coefficients, light = P · radiance: SH values times the solid angle of a
/// direction, `[k][direction]`, and a sun, if there is one, whose radiance is the last coefficient.
#[derive(Debug, Clone)]
pub struct Projection {
    harmonics: DMatrix<f64>,
    has_sun: bool,
}

impl Projection {
    /// For `k` harmonics, at least one.
    #[must_use]
    pub fn new(k: usize) -> Self {
        let mut y = vec![0.0; k];
        let mut harmonics = DMatrix::zeros(k, DIRECTIONS);
        for (d, direction) in directions().into_iter().enumerate() {
            sh::eval(direction, &mut y);
            harmonics
                .column_mut(d)
                .iter_mut()
                .zip(&y)
                .for_each(|(p, y)| *p = y * 4.0 * std::f64::consts::PI / DIRECTIONS as f64);
        }
        Self { harmonics, has_sun: false }
    }

    /// For the harmonics of `bands` and the sun of the transfer, if it has one.
    #[must_use]
    pub fn of(transfer: &Transfer, bands: usize) -> Self {
        Self { has_sun: transfer.traced.sun.is_some(), ..Self::new(bands * bands) }
    }

    /// Number of directions, the sun's among them.
    #[must_use]
    pub fn directions(&self) -> usize {
        self.harmonics.ncols() + usize::from(self.has_sun)
    }

    /// Number of coefficients.
    #[must_use]
    pub fn coefficients(&self) -> usize {
        self.harmonics.nrows() + usize::from(self.has_sun)
    }

    /// P without the sun.
    #[must_use]
    pub fn matrix(&self) -> &DMatrix<f64> {
        &self.harmonics
    }

    /// Coefficients of a radiance, `[direction]`: `[k]`.
    #[must_use]
    pub fn light(&self, radiance: &DVector<f64>) -> DVector<f64> {
        let (harmonics, sun) = radiance.as_slice().split_at(self.harmonics.ncols());
        let mut light = dense::times(&self.harmonics, &DVector::from_column_slice(harmonics));
        light.extend(sun.iter().copied());
        light
    }
}
