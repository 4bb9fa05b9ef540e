//! Light and segment albedos.

use crate::numerics::sh;
use glam::DVec3;

/// Directions that carry radiance.
pub(super) const DIRECTIONS: usize = 320;

/// Light and segment albedos, up to one factor per channel.
#[derive(Debug, Clone)]
pub struct Solution {
    /// SH coefficients of the radiance: `[k][channel]`, bands² rows, and one for the sun, where the transfer has one.
    pub light: Vec<[f64; 3]>,
    /// Posterior standard deviation of `light`, same shape.
    pub standard_deviation: Vec<[f64; 3]>,
    /// Non-negative radiance over [`directions`], and of the sun: `[direction][channel]`.
    pub radiance: Vec<[f64; 3]>,
    /// Albedo: `[segment][channel]`.
    pub albedo: Vec<[f64; 3]>,
    /// Relative RMS error on held-out vertices.
    pub held_out: f64,
    /// Regularisation weight chosen by held-out error: `[channel]`.
    pub regularisation: [f64; 3],
    /// Condition number of the normal equations of the light, without regularisation.
    pub condition: f64,
}

impl Solution {
    /// SH bands of the light.
    #[must_use]
    pub fn bands(&self) -> usize {
        self.light.len().isqrt()
    }

    /// The SH coefficients alone.
    #[must_use]
    pub fn harmonics(&self) -> &[[f64; 3]] {
        &self.light[..self.bands() * self.bands()]
    }

    /// Radiance of the sun, in units of that of one of [`directions`], if it has one.
    #[must_use]
    pub fn sun(&self) -> Option<[f64; 3]> {
        self.radiance.get(DIRECTIONS).copied()
    }

    /// Multiplies albedo and light by these factors, per channel.
    pub fn scale(&mut self, albedo: DVec3, light: DVec3) {
        self.albedo.iter_mut().for_each(|a| (0..3).for_each(|c| a[c] *= albedo[c]));
        let lights = self.light.iter_mut().chain(&mut self.standard_deviation).chain(&mut self.radiance);
        lights.for_each(|l| (0..3).for_each(|c| l[c] *= light[c]));
    }
}

/// The unit directions of [`Solution::radiance`], evenly spread.
#[must_use]
pub fn directions() -> Vec<DVec3> {
    sh::even_directions(DIRECTIONS)
}

/// Rows of one value a channel: `[row][channel]`; `value` gets channel and row.
pub(super) fn zip3(rows: usize, value: &dyn Fn(usize, usize) -> f64) -> Vec<[f64; 3]> {
    (0..rows).map(|i| [0, 1, 2].map(|c| value(c, i))).collect()
}
