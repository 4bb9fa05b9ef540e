//! What keyframes saw beyond the scan: the only direct evidence of the light.

use crate::association::{Association, RefinedView};
use crate::factorisation::SeenBackground;
use crate::factorisation::drawn_light::Chosen;
use crate::numerics::cielab::luminance;
use crate::rays::RayScene;
use crate::render::lighting::environment::{self, Environment};
use crate::render::lighting::observed_background::one_view;
use firmware_config::tuning::SurroundingsTuning;
use glam::Vec3;
use rayon::prelude::*;
use recordings::decision::{BackgroundLikeness, Decision};
use recordings::result::{Light, ResultKeyframe};
use recordings::scan::Scan;
use recordings::types::Keyframe;
use std::collections::BTreeMap;

/// Texels of an environment along the side of a direction that is compared: 2.8°.
const TEXELS: usize = 4;
/// Pixels between samples.
const STEP_PX: u32 = 6;
/// Fewer directions tell nothing.
const MIN_DIRECTIONS: usize = 100;

/// What the keyframes saw beyond the scan. Every second one is evidence of the light, the others judge it.
#[derive(Default)]
pub struct Background {
    /// Of the light.
    pub evidence: SeenBackground,
    left_out: Vec<Seen>,
}

/// What one keyframe saw in one direction.
struct Seen {
    keyframe: u32,
    direction: usize,
    /// In the units of the lit colours, linear RGB.
    radiance: Vec3,
    clipped: bool,
}

impl Background {
    /// Looks past the mesh of `scene` from the refined views of `fields` whose pictures were used.
    pub fn observe(scan: &Scan, fields: &Association, scene: &RayScene) -> Self {
        let views = &fields.views;
        let table = fields.lens.response.linear_table();
        let tuning = SurroundingsTuning { sample_step_px: STEP_PX, ..SurroundingsTuning::default() };
        let of_keyframe = |j: &usize| {
            let Ok(picture) = scan.keyframes[*j].color.decode() else { return Vec::new() };
            let view = as_refined(&scan.keyframes[*j], &views[*j]);
            let seen = one_view(&view, &picture, scene, &table, fields.lens.vignetting, &tuning).into_iter();
            seen.map(|(texel, radiance, clipped)| Seen {
                keyframe: *j as u32,
                direction: cell(texel),
                radiance,
                clipped,
            })
            .collect()
        };
        let used: Vec<usize> = (0..scan.keyframes.len()).filter(|j| fields.veils[*j].is_some()).collect();
        let seen: Vec<Vec<Seen>> = used.par_iter().map(of_keyframe).collect();
        let mut halves = [Vec::new(), Vec::new()];
        for (n, seen) in seen.into_iter().enumerate() {
            halves[n % 2].extend(seen);
        }
        let [told, left_out] = halves;
        let side = environment::SIDE / TEXELS;
        let evidence = SeenBackground::new(
            means(&told).into_iter().map(|(cell, (radiance, clipped))| (direction(cell), radiance, clipped)),
            1.0 / (side * side) as f64,
        );
        Self { evidence, left_out }
    }

    /// How the distant part of a light that was `drawn` to the evidence correlates with what was left out.
    pub fn likeness(&self, light: &Light, drawn: Option<Chosen>) -> Decision {
        let environment = Environment::from_light(light);
        let pair = |(cell, (seen, _)): (&usize, &(Vec3, bool))| {
            (f64::from(luminance(*seen)), f64::from(luminance(environment.radiance(direction(*cell)))))
        };
        let pairs: Vec<(f64, f64)> = means(&self.left_out).iter().map(pair).collect();
        let keyframes = self.left_out.chunk_by(|a, b| a.keyframe == b.keyframe).count() as u32;
        let (weight, held_out) = drawn.map_or((0.0, Vec::new()), |c| (c.weight, c.held_out));
        Decision::Background(BackgroundLikeness {
            weight,
            held_out,
            keyframes,
            directions: pairs.len() as u32,
            correlation: if pairs.len() < MIN_DIRECTIONS { None } else { correlation(&pairs) },
        })
    }
}

/// Mean radiance by direction, and whether most of it was clipped.
fn means(seen: &[Seen]) -> BTreeMap<usize, (Vec3, bool)> {
    let mut sums: BTreeMap<usize, (Vec3, u32, u32)> = BTreeMap::new();
    for s in seen {
        let (sum, count, clipped) = sums.entry(s.direction).or_default();
        *sum += s.radiance;
        *count += 1;
        *clipped += u32::from(s.clipped);
    }
    sums.into_iter().map(|(cell, (sum, n, clipped))| (cell, (sum / n as f32, 2 * clipped > n))).collect()
}

/// A keyframe with its refined pose and exposure.
fn as_refined(keyframe: &Keyframe, view: &RefinedView) -> ResultKeyframe {
    ResultKeyframe {
        name: keyframe.name.clone(),
        timestamp_ns: keyframe.color.timestamp_ns,
        gain: view.gain,
        world_from_camera: view.world_from_camera,
        camera: keyframe.camera,
        residual_px: view.residual_px,
    }
}

/// The direction that is compared for a texel of an environment, by its number.
fn cell(texel: usize) -> usize {
    let (row, column) = (texel / environment::SIDE, texel % environment::SIDE);
    row / TEXELS * (environment::SIDE / TEXELS) + column / TEXELS
}

/// The middle of a direction that is compared.
fn direction(cell: usize) -> Vec3 {
    let side = environment::SIDE / TEXELS;
    let at = |i: usize| i * TEXELS + TEXELS / 2;
    environment::direction(at(cell / side) * environment::SIDE + at(cell % side))
}

/// Pearson's; `None` where one side is constant.
fn correlation(pairs: &[(f64, f64)]) -> Option<f64> {
    let n = pairs.len() as f64;
    let (x, y) = pairs.iter().fold((0.0, 0.0), |(x, y), p| (x + p.0 / n, y + p.1 / n));
    let (xx, xy, yy) = pairs.iter().fold((0.0, 0.0, 0.0), |(xx, xy, yy), p| {
        let (a, b) = (p.0 - x, p.1 - y);
        (xx + a * a, xy + a * b, yy + b * b)
    });
    let scale = libm::sqrt(xx * yy);
    (scale > 0.0 && scale.is_finite()).then(|| xy / scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sky that is bright above, seen by one keyframe, and light that falls from `from`.
    fn likeness(from: f64, cells: usize) -> Option<f64> {
        let seen =
            |c: usize| Seen { keyframe: 1, direction: c, radiance: Vec3::splat(1.0 + direction(c).z), clipped: false };
        let background = Background { left_out: (0..cells).map(|c| seen(c * 7)).collect(), ..Background::default() };
        let mut light = Light { coefficients: vec![[0.0; 3]; 4], ..Light::default() };
        light.coefficients[0] = [1.0; 3];
        light.coefficients[2] = [0.3 * from; 3];
        let Decision::Background(found) = background.likeness(&light, None) else { unreachable!() };
        assert_eq!((found.keyframes, found.directions), (1, cells as u32));
        found.correlation
    }

    #[test]
    fn light_from_where_the_background_is_bright_correlates() {
        assert!(likeness(1.0, 300).unwrap() > 0.99);
        assert!(likeness(-1.0, 300).unwrap() < -0.99);
        assert_eq!(likeness(1.0, 99), None, "too little seen");
    }

    #[test]
    fn the_middle_of_a_direction_is_within_it() {
        let side = environment::SIDE / TEXELS;
        assert!((0..side * side).all(|c| cell(environment::texel(direction(c))) == c));
    }
}
