//! The sun: a lamp at infinity beside distant light in all its bands, whose harmonics hold no shadows as sharp as it casts.

use crate::factorisation::{FactorisationOptions, Factorised, directions, factorise};
use crate::light_model::choose::{Choice, REGULARISATION};
use crate::light_model::growth::least_held_out;
use crate::light_model::held_out::{Blocks, cross_validated, is_better};
use crate::light_model::lamps::{self, Sphere};
use crate::light_model::samples;
use crate::numerics::cielab::luminance_f64;
use crate::transfer::Sun;
use firmware_config::SolverChoice;
use glam::Vec3;
use rayon::prelude::*;
use recordings::local_light::Lamp;
use std::sync::Arc;

/// A sun is at least so many times as bright as the rest of the light on the mean, if it has the solid angle of one of [`directions`].
/// Harmonics hold what is dimmer; gloss and errors of the transfer can pass for it.
const LEAST: f64 = 10.0;

impl Choice<'_> {
    /// The distant answer `found` with a sun where it fits best, and what that leaves unexplained of the held-out blocks; `None` where none
    /// is bright.
    pub(super) fn sunny(&self, found: &Factorised, options: &FactorisationOptions) -> Option<(Factorised, Blocks)> {
        if options.solver != SolverChoice::Robust {
            return None;
        }
        let mut places = self.search(&[], &[]).best_directions();
        places.retain(|direction| !self.scene.background.has_no_lamp(*direction));
        if places.is_empty() {
            return None;
        }
        // Cheap models first: the factorisation takes longer than all of the search.
        let solved = |direction: Vec3| self.solved(&[], &[self.at_infinity(direction)], REGULARISATION);
        let (without, with) = rayon::join(
            || self.solved(&[], &[], REGULARISATION),
            || least_held_out(places.into_par_iter().map(solved).collect()),
        );
        let with = with?;
        if !is_better(&with.blocks, &without.blocks) {
            return None;
        }
        let sphere = with.lamps[0];
        // Segments that shadows divide have the albedos under the sun from the start: those under light without it hide it.
        let albedo = with.solved.albedo;
        let traced = Arc::new(found.transfer.traced.with_sun(self.sun(&sphere)));
        let sunny = factorise(traced, &self.scene.colors, options, Some(found.start_with(albedo)));
        let count = directions().len();
        let mean = sunny.solution.radiance.iter().take(count).map(luminance_f64).sum::<f64>() / count as f64;
        if luminance_f64(&sunny.solution.sun()?) < LEAST * mean {
            return None;
        }
        let irradiance = self.samples.irradiance(&sunny);
        Some((sunny, cross_validated(&self.samples, |_| irradiance.clone()).blocks))
    }

    /// A lamp at infinity with its transfer. Where its coefficient is 1, it is as bright as one of [`directions`] of that radiance.
    fn sun(&self, sphere: &Sphere) -> Sun {
        let (mesh, rays) = (self.scene.mesh, self.scene.rays);
        let (low, high) = samples::bounds(mesh);
        let distance = f64::from(sphere.center.distance(0.5 * (low + high)));
        // The power P = L r² of (N2) that brings, over π, what the solid angle 4π / n of a direction does.
        let power = 4.0 / directions().len() as f64 * distance * distance;
        let every: Vec<u32> = (0..mesh.positions.len() as u32).collect();
        let mut direct = lamps::form_factors(mesh, rays, &every, sphere);
        direct.iter_mut().for_each(|g| *g *= power as f32);
        let radiance = [power / (f64::from(sphere.radius) * f64::from(sphere.radius)); 3];
        Sun { lamp: Lamp { center: sphere.center.to_array(), radius_m: sphere.radius, radiance }, direct }
    }
}
