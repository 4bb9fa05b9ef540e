//! What keyframes saw beyond the scan, by the directions of the light.

use crate::factorisation::solution::{DIRECTIONS, directions};
use glam::Vec3;
use nalgebra::DVector;

/// Sharpness s of the weight exp(s (cos − 1)) of a sample in a direction of the light: those are 11° apart, and what is beside them
/// is like them.
const SHARPNESS: f32 = 60.0;
/// A direction of which at least this share was seen, and no more than that of what was seen clipped, has no bright lamp.
const SEEN: f64 = 0.5;
const CLIPPED: f32 = 0.01;

/// Radiance beyond the scan, as far as it was seen.
#[derive(Debug, Clone, Default)]
pub struct SeenBackground {
    /// Mean radiance in the units of the lit colours, linear RGB, and which share of it was clipped; where most of it was, it is a
    /// lower bound: `[direction]`; empty where nothing was seen.
    radiance: Vec<(Vec3, f32)>,
    /// Share of the direction that was seen: `[direction]`.
    share: Vec<f64>,
}

impl SeenBackground {
    /// From samples in unit directions that each stand for the share `solid_angle` of the sphere: radiance, and whether it was
    /// clipped. There is at most one sample for each of them.
    #[must_use]
    pub fn new(samples: impl Iterator<Item = (Vec3, Vec3, bool)>, solid_angle: f64) -> Self {
        let directions: Vec<Vec3> = directions().iter().map(|d| d.as_vec3()).collect();
        let mut sums = vec![(Vec3::ZERO, 0.0f32, 0.0f32); DIRECTIONS];
        for (direction, radiance, clipped) in samples {
            for ((sum, weight, bounds), d) in sums.iter_mut().zip(&directions) {
                let w = libm::expf(SHARPNESS * (d.dot(direction) - 1.0));
                *sum += radiance * w;
                *weight += w;
                *bounds += if clipped { w } else { 0.0 };
            }
        }
        if sums.iter().all(|s| s.1 == 0.0) {
            return Self::default();
        }
        let mean = |&(sum, w, bounds): &(Vec3, f32, f32)| {
            let w = w.max(f32::MIN_POSITIVE);
            (sum / w, bounds / w)
        };
        // The weights of samples in all directions.
        let all = f64::from(0.5 / SHARPNESS) / solid_angle;
        Self {
            radiance: sums.iter().map(mean).collect(),
            share: sums.iter().map(|(_, w, _)| (f64::from(*w) / all).min(1.0)).collect(),
        }
    }

    /// Nothing was seen.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.radiance.is_empty()
    }

    /// True if pictures show that there is no bright lamp in this direction, a unit vector.
    #[must_use]
    pub fn has_no_lamp(&self, direction: Vec3) -> bool {
        let cosine = |d: &usize| directions()[*d].as_vec3().dot(direction);
        let nearest = (0..self.radiance.len()).max_by(|a, b| cosine(a).total_cmp(&cosine(b)));
        nearest.is_some_and(|d| self.share[d] >= SEEN && self.radiance[d].1 <= CLIPPED)
    }

    /// Share of a direction that was seen.
    pub(super) fn share(&self, direction: usize) -> f64 {
        self.share[direction]
    }

    /// Radiance of a channel in units of `level`, at least `told` where it was clipped: `[direction]`.
    pub(super) fn relative_to(&self, channel: usize, level: f64, told: &DVector<f64>) -> DVector<f64> {
        let of = |((radiance, clipped), told): (&(Vec3, f32), &f64)| {
            let seen = f64::from(radiance[channel]) / level;
            if *clipped > 0.5 { seen.max(*told) } else { seen }
        };
        DVector::from_iterator(DIRECTIONS, self.radiance.iter().zip(told.iter()).map(of))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::sh;

    #[test]
    fn a_direction_is_known_as_far_as_it_was_seen() {
        let all: Vec<Vec3> = sh::even_directions(4000).iter().map(|d| d.as_vec3().normalize()).collect();
        let above = |least: f32| all.iter().filter(move |d| d.z > least).map(|d| (*d, Vec3::splat(3.0), true));
        let seen = SeenBackground::new(above(0.0), 1.0 / 4000.0);
        let of = |z: f64| {
            let off = |d: &usize| (directions()[*d].z - z).abs();
            (0..DIRECTIONS).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap()
        };
        assert!(
            seen.share(of(1.0)) > 0.97 && seen.share(of(-0.8)) < 0.01,
            "{} {}",
            seen.share(of(1.0)),
            seen.share(of(-0.8))
        );
        assert!((0.3..0.7).contains(&seen.share(of(0.0))), "{}", seen.share(of(0.0)));
        let told = DVector::from_element(DIRECTIONS, 5.0);
        assert!((seen.relative_to(1, 0.5, &told)[of(1.0)] - 6.0).abs() < 1e-4);
        assert_eq!(seen.relative_to(1, 1.0, &told)[of(1.0)], 5.0, "what is clipped is brighter than it shows");
        // Clipped above, unclipped below, where one sample is clipped.
        let hemispheres = all.iter().map(|d| (*d, Vec3::ONE, d.z > 0.2 || d.x > 0.999));
        let seen = SeenBackground::new(hemispheres, 1.0 / 4000.0);
        let told = [Vec3::NEG_Z, Vec3::Z, Vec3::X].map(|d| seen.has_no_lamp(d));
        assert_eq!(told, [true, false, false]);
        assert!(!SeenBackground::new(above(0.0), 1.0 / 4000.0).has_no_lamp(Vec3::NEG_Z), "not seen");
        assert!(SeenBackground::new(above(2.0), 1.0 / 4000.0).is_empty());
    }
}
