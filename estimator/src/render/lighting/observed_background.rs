//! Background that the keyframes observed past the mesh: the part of the surroundings that needs no completion.

use crate::association::vignetting::Vignetting;
use crate::numerics::robust::median;
use crate::rays::RayScene;
use crate::render::lighting::environment::{Environment, SIDE, texel};
use firmware_config::tuning::SurroundingsTuning;
use glam::Vec3;
use rayon::prelude::*;
use recordings::result::{Estimate, ResultKeyframe};
use recordings::scan::Scan;
use recordings::types::RgbImage;

/// Radiance of one texel of the surroundings.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ObservedTexel {
    /// Radiance, in the light's units.
    pub radiance: Vec3,
    /// Agreement of the keyframes, 0..1; 0 = not observed.
    pub agreement: f32,
    /// True if the picture was clipped there: the radiance is a lower bound.
    pub clipped: bool,
    /// Radiance extrapolated from observed directions around.
    pub extrapolated: Vec3,
    /// Proximity of those, 0..1; 0 = none observed.
    pub proximity: f32,
}

/// Camera ray through a pixel, in the world: unit direction.
#[must_use]
pub fn ray(keyframe: &ResultKeyframe, u: f64, v: f64) -> Vec3 {
    let d = keyframe.world_from_camera.rotation * keyframe.camera.unproject(u, v);
    d.normalize().as_vec3()
}

/// The keyframes' pictures as a backdrop at infinity, as sharp as they are.
#[derive(Debug, Default)]
pub struct ObservedBackground {
    views: Vec<(ResultKeyframe, RgbImage)>,
    table: Vec<f32>,
    clearance_px: f64,
    /// Extrapolation where no keyframe looked.
    continued: Option<Environment>,
}

impl ObservedBackground {
    /// From pictures, one a keyframe (`None` where there is none).
    #[must_use]
    pub fn new(
        estimate: &Estimate,
        pictures: Vec<Option<RgbImage>>,
        known: &[ObservedTexel],
        tuning: &SurroundingsTuning,
    ) -> Self {
        let views = estimate.keyframes.iter().zip(pictures).filter_map(|(k, p)| Some((k.clone(), p?))).collect();
        let extrapolated = || Environment::from_texels(known.iter().map(|k| k.extrapolated).collect());
        let continued = known.iter().any(|k| k.proximity > 0.0).then(extrapolated);
        Self { views, table: estimate.response.linear_table().to_vec(), clearance_px: tuning.clearance_px, continued }
    }

    /// Radiance from beyond the scan in a unit direction: per channel the median of the keyframes that look there past
    /// every surface that `blocks` a ray (origin, direction); extrapolated where none looks, `None` without keyframes.
    #[must_use]
    pub fn radiance(&self, direction: Vec3, blocks: impl Fn(Vec3, Vec3) -> bool) -> Option<Vec3> {
        let seen: Vec<Vec3> = self.views.iter().filter_map(|(k, p)| self.from(k, p, direction, &blocks)).collect();
        let middle = |c: usize| {
            let mut x: Vec<f32> = seen.iter().map(|r| r[c]).collect();
            x.sort_by(f32::total_cmp);
            // Of an even number, both in the middle.
            (x[(x.len() - 1) / 2] + x[x.len() / 2]) * 0.5
        };
        if seen.is_empty() {
            return self.continued.as_ref().map(|e| e.radiance(direction));
        }
        Some(Vec3::new(middle(0), middle(1), middle(2)))
    }

    fn from(
        &self,
        keyframe: &ResultKeyframe,
        picture: &RgbImage,
        direction: Vec3,
        blocks: impl Fn(Vec3, Vec3) -> bool,
    ) -> Option<Vec3> {
        let eye = keyframe.world_from_camera.translation.as_vec3();
        let (u, v) = keyframe.camera.project(keyframe.world_from_camera.rotation.inverse() * direction.as_dvec3())?;
        let (x, y) = (libm::floor(u), libm::floor(v));
        let (w, h) = (f64::from(picture.width), f64::from(picture.height));
        let inside = x >= 0.0 && y >= 0.0 && x + 1.0 < w && y + 1.0 < h;
        let misses = |dx: f64, dy: f64| !blocks(eye, ray(keyframe, u + dx, v + dy));
        let c = self.clearance_px;
        if !inside || !misses(0.0, 0.0) || !misses(-c, 0.0) || !misses(c, 0.0) || !misses(0.0, -c) || !misses(0.0, c) {
            return None;
        }
        let at = |x: u32, y: u32| {
            let p = &picture.data[3 * (y * picture.width + x) as usize..][..3];
            Vec3::new(self.table[p[0] as usize], self.table[p[1] as usize], self.table[p[2] as usize])
        };
        let (fx, fy) = ((u - x) as f32, (v - y) as f32);
        let (x, y) = (x as u32, y as u32);
        let linear = at(x, y).lerp(at(x + 1, y), fx).lerp(at(x, y + 1).lerp(at(x + 1, y + 1), fx), fy);
        Some(linear / Vec3::from(keyframe.gain.map(|g| g as f32)).max(Vec3::splat(1e-9)))
    }
}

/// Observed directions with a weight below e to this power have none: far less than the weight that all have.
const LEAST_LOG_WEIGHT: f32 = -20.0;

/// Extrapolates the observed radiance smoothly into all directions.
fn extrapolate(known: &mut [ObservedTexel], tuning: &SurroundingsTuning) {
    let sharpness = tuning.extrapolation_sharpness as f32;
    let seen: Vec<usize> = (0..known.len()).filter(|&i| known[i].agreement > 0.5).collect();
    let step = seen.len().div_ceil(tuning.extrapolated_from as usize).max(1);
    let few: Vec<(Vec3, Vec3)> = seen
        .iter()
        .step_by(step)
        .map(|&i| (crate::render::lighting::environment::direction(i), known[i].radiance))
        .collect();
    if few.is_empty() {
        return;
    }
    // Each stands for `step` texels; the influence of a whole sphere of them is 2π / sharpness.
    let all = sharpness * 2.0 * step as f32 / (SIDE * SIDE) as f32;
    known.par_iter_mut().enumerate().for_each(|(i, k)| {
        let d = crate::render::lighting::environment::direction(i);
        // Far from every observed direction all weights are small and equal.
        let weighted = few.iter().map(|(at, r)| {
            let x = sharpness * (d.dot(*at) - 1.0);
            let w = if x > LEAST_LOG_WEIGHT { libm::expf(x) } else { 0.0 };
            (*r * (1e-6 + w), w)
        });
        let (sum, weight) = weighted.fold((Vec3::ZERO, 0.0), |(s, w), (r, v)| (s + r, w + v));
        k.extrapolated = sum / (1e-6 * few.len() as f32 + weight);
        let influence = all * weight;
        k.proximity = influence / (influence + tuning.half_weight as f32);
    });
}

/// Pictures of a result's keyframes, `[keyframe]`; `None` where the scan has none that can be decoded.
#[must_use]
pub fn pictures(estimate: &Estimate, scan: Option<&Scan>) -> Vec<Option<RgbImage>> {
    let of = |name: &str| scan?.keyframes.iter().find(|k| k.name == name)?.color.decode().ok();
    estimate.keyframes.iter().map(|k| of(&k.name)).collect()
}

/// Surroundings per texel of an [`Environment`], from pictures (one a keyframe, `None` where there is none).
#[must_use]
pub fn surroundings(
    estimate: &Estimate,
    scene: &RayScene,
    pictures: &[Option<RgbImage>],
    tuning: &SurroundingsTuning,
) -> Vec<ObservedTexel> {
    let table = estimate.response.linear_table();
    let views: Vec<Vec<(usize, Vec3, bool)>> = estimate
        .keyframes
        .par_iter()
        .zip(pictures)
        .map(|(keyframe, picture)| {
            picture.as_ref().map_or(Vec::new(), |p| one_view(keyframe, p, scene, &table, Vignetting::default(), tuning))
        })
        .collect();
    let mut samples: Vec<Vec<(Vec3, bool)>> = vec![Vec::new(); SIDE * SIDE];
    for (i, radiance, clipped) in views.into_iter().flatten() {
        samples[i].push((radiance, clipped));
    }
    let mut known: Vec<ObservedTexel> = samples.par_iter().map(|s| agree(s, tuning.spread as f32)).collect();
    extrapolate(&mut known, tuning);
    known
}

/// The light with observed radiance in place of inferred radiance.
#[must_use]
pub fn overlay(light: &Environment, known: &[ObservedTexel]) -> Environment {
    light.overlaid(|i, inferred| {
        let k = &known[i];
        let radiance = if k.clipped { k.radiance.max(inferred) } else { k.radiance };
        inferred.lerp(radiance, k.agreement)
    })
}

/// Mean radiance of every texel that one keyframe saw past the mesh, ascending, freed of vignetting, and whether it was clipped.
#[must_use]
pub fn one_view(
    keyframe: &ResultKeyframe,
    picture: &RgbImage,
    scene: &RayScene,
    table: &[f32; 256],
    vignetting: Vignetting,
    tuning: &SurroundingsTuning,
) -> Vec<(usize, Vec3, bool)> {
    let eye = keyframe.world_from_camera.translation.as_vec3();
    let gain = Vec3::from(keyframe.gain.map(|g| g as f32)).max(Vec3::splat(1e-9));
    let mut found = Vec::new();
    for y in (0..picture.height).step_by(tuning.sample_step_px as usize) {
        for x in (0..picture.width).step_by(tuning.sample_step_px as usize) {
            let misses = |dx: f64, dy: f64| !scene.occluded(eye, ray(keyframe, f64::from(x) + dx, f64::from(y) + dy));
            let c = tuning.clearance_px;
            if misses(0.0, 0.0) && misses(-c, 0.0) && misses(c, 0.0) && misses(0.0, -c) && misses(0.0, c) {
                let p = &picture.data[3 * (y * picture.width + x) as usize..][..3];
                let linear = Vec3::new(table[p[0] as usize], table[p[1] as usize], table[p[2] as usize]);
                let clipped = p.iter().any(|v| u32::from(*v) >= tuning.clipped_from);
                let shade = vignetting.shade(&keyframe.camera.intrinsics, f64::from(x), f64::from(y));
                found.push((texel(ray(keyframe, f64::from(x), f64::from(y))), linear / (gain * shade), clipped));
            }
        }
    }
    found.sort_by_key(|(i, _, _)| *i);
    found
        .chunk_by(|a, b| a.0 == b.0)
        .map(|same| {
            let mean = same.iter().map(|(_, r, _)| *r).sum::<Vec3>() / same.len() as f32;
            (same[0].0, mean, same.iter().any(|(_, _, c)| *c))
        })
        .collect()
}

fn agree(samples: &[(Vec3, bool)], half_spread: f32) -> ObservedTexel {
    if samples.is_empty() {
        return ObservedTexel::default();
    }
    let channel = |c: usize| median(samples.iter().map(|(r, _)| r[c])).unwrap_or(0.0);
    let radiance = Vec3::new(channel(0), channel(1), channel(2));
    let deviation = median(samples.iter().map(|(r, _)| (*r - radiance).abs().element_sum())).unwrap_or(0.0);
    let spread = deviation / radiance.element_sum().max(f32::MIN_POSITIVE) / half_spread;
    let clipped = samples.iter().filter(|(_, c)| *c).count() * 2 > samples.len();
    ObservedTexel { radiance, agreement: 1.0 / (1.0 + spread * spread), clipped, ..ObservedTexel::default() }
}
