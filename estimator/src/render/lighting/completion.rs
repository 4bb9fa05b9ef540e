//! Completes the light beyond its few spherical harmonics: radiance that keyframes observed, an even level elsewhere, and
//! lamps where the rest of the light must come from.
//!
//! Lamps are found by CLEAN (Högbom, "Aperture Synthesis with a Non-Regular Distribution of Interferometer Baselines",
//! A&AS 15, 1974): the brightest direction of the residual gets a small lamp, its blurred image is subtracted, and again.

use crate::numerics::cielab::{luminance, luminance_f64};
use crate::numerics::dense::dot;
use crate::numerics::{robust, sh};
use crate::rays::RayScene;
use crate::render::lighting::environment::{Environment, SIDE, direction, texel};
use crate::render::lighting::observed_background::{ObservedTexel, pictures, surroundings};
use firmware_config::tuning::SurroundingsTuning;
use glam::Vec3;
use rayon::prelude::*;
use recordings::result::{Estimate, Light};
use recordings::scan::Scan;

/// Directions that are searched for peaks.
const DIRECTIONS: usize = 4000;

/// Light of a result over the surface `scene`, with what the keyframes of its `scan` saw beyond that surface.
#[must_use]
pub fn completed(result: &Estimate, scan: Option<&Scan>, scene: &RayScene) -> Environment {
    let tuning = SurroundingsTuning::default();
    complete(&result.light, &surroundings(result, scene, &pictures(result, scan), &tuning), &tuning)
}

/// Light of a result with the background that its keyframes observed (`[texel]`, or empty).
#[must_use]
pub fn complete(light: &Light, known: &[ObservedTexel], tuning: &SurroundingsTuning) -> Environment {
    let bands = (light.bands() as usize).min(sh::MAX_BANDS);
    if bands < 2 {
        return Environment::from_light(light);
    }
    let agreement = |i: usize| known.get(i).map_or(0.0, |k| if k.clipped { 0.0 } else { k.agreement });
    let radiance = |i: usize| known.get(i).map_or(Vec3::ZERO, |k| k.radiance);
    let total = &light.coefficients[..bands * bands];

    // The even level: the median of the observed radiance, at most its share of the light still unexplained.
    let seen = Environment::from_texels((0..SIDE * SIDE).map(|i| radiance(i) * agreement(i)).collect());
    let unseen = Environment::from_texels((0..SIDE * SIDE).map(|i| Vec3::splat(1.0 - agreement(i))).collect());
    let (seen_mean, unseen_mean) = (seen.project(1)[0], unseen.project(1)[0]);
    let middle = median(known);
    let even: [f64; 3] = std::array::from_fn(|c| {
        let left = tuning.even_share * (total[0][c] - seen_mean[c]) / unseen_mean[c].max(1e-9);
        middle.map_or(0.5 * left, |m| m[c]).min(left).max(0.0)
    });
    let even = Vec3::from(even.map(|x| x as f32));
    let extrapolated = |i: usize| known.get(i).map_or(even, |k| even.lerp(k.extrapolated, k.proximity));
    let base =
        Environment::from_texels((0..SIDE * SIDE).map(|i| extrapolated(i).lerp(radiance(i), agreement(i))).collect());
    let explained = base.project(bands);
    let mut rest: Vec<[f64; 3]> =
        total.iter().zip(explained).map(|(t, e)| std::array::from_fn(|c| t[c] - e[c])).collect();

    let variance = luminance_variance(light, bands);
    let dark = |d| agreement(texel(d)) < 0.5;
    let lamps = clean(&mut rest, &variance, total[0], tuning, dark);
    let width = tuning.lamp_width_rad / bands as f64;
    let sharpness = (1.0 / (width * width)) as f32;
    // ∫ exp(s (cos − 1)) dω = 2π (1 − e^(−2s)) / s.
    let peak = sharpness / std::f32::consts::TAU;
    smooth(&mut rest, &variance, total[0], tuning);
    let texels: Vec<Vec3> = (0..SIDE * SIDE)
        .into_par_iter()
        .map(|i| {
            let d = direction(i);
            let mut sum = Vec3::from(sh::radiance(&rest, d.as_dvec3()).map(|x| x as f32));
            for (at, flux) in &lamps {
                let x = sharpness * (d.dot(*at) - 1.0);
                if x > -12.0 {
                    sum += *flux * (peak * libm::expf(x));
                }
            }
            let clipped = known.get(i).is_some_and(|k| k.clipped && k.agreement > 0.0);
            let inferred = within(extrapolated(i) + sum, even, tuning.floor as f32);
            let inferred = if clipped { inferred.max(radiance(i)) } else { inferred };
            inferred.lerp(radiance(i), agreement(i))
        })
        .collect();
    Environment::from_texels(texels)
}

/// What is left beside the lamps: low bands, with the hue of the whole light `mean` as far as their own is within their error.
fn smooth(rest: &mut [[f64; 3]], variance: &[f64], mean: [f64; 3], tuning: &SurroundingsTuning) {
    let errors = tuning.lamp_significance * tuning.lamp_significance;
    for (k, r) in rest.iter_mut().enumerate() {
        let l = (k.isqrt() as f64).min(tuning.residual_bands);
        let window = 0.5 * (1.0 + libm::cos(std::f64::consts::PI * l / tuning.residual_bands));
        let power = r.iter().map(|x| x * x / 3.0).sum::<f64>().max(f64::MIN_POSITIVE);
        let trust = (1.0 - errors * variance[k] / power).max(0.0);
        *r = with_hue_of(mean, *r, trust).map(|x| window * x);
    }
}

/// `own` with the hue of `mean` at its luminance, as far as its hue is not believed: `trust`, 0 to 1.
fn with_hue_of(mean: [f64; 3], own: [f64; 3], trust: f64) -> [f64; 3] {
    let mean_luminance = luminance_f64(&mean);
    // A light without luminance has no hue.
    if mean_luminance <= 0.0 {
        return own;
    }
    let level = luminance_f64(&own) / mean_luminance;
    std::array::from_fn(|c| trust * own[c] + (1.0 - trust) * mean[c] * level)
}

/// Few bands ring, and each channel does so for itself: what falls below its floor is drawn towards the even level's hue
/// at its own luminance, until no channel does.
fn within(light: Vec3, even: Vec3, lowest: f32) -> Vec3 {
    let floor = even * lowest;
    let level = (luminance(light) / luminance(even).max(f32::MIN_POSITIVE)).max(lowest);
    let grey = even * level;
    let share = (0..3).fold(1.0f32, |t, c| {
        if light[c] >= floor[c] { t } else { t.min((grey[c] - floor[c]) / (grey[c] - light[c]).max(f32::MIN_POSITIVE)) }
    });
    grey.lerp(light, share.clamp(0.0, 1.0)).max(floor)
}

/// Middle radiance of the directions that were seen, per channel.
fn median(known: &[ObservedTexel]) -> Option<[f64; 3]> {
    let channel =
        |c: usize| robust::median(known.iter().filter(|k| k.agreement > 0.5).map(|k| f64::from(k.radiance[c])));
    Some([channel(0)?, channel(1)?, channel(2)?])
}

/// Variance of the luminance of each coefficient, `[k]`. The errors of the channels are taken as one error: they come
/// from the same surface. Zero where the light does not say.
fn luminance_variance(light: &Light, bands: usize) -> Vec<f64> {
    let deviation = |k: usize| light.standard_deviation.get(k).copied().unwrap_or_default();
    (0..bands * bands).map(|k| luminance_f64(&deviation(k)).powi(2)).collect()
}

/// Directions in which the light is more than its own error.
struct Candidates {
    directions: Vec<Vec3>,
    /// Y_k of each, `[direction][k]`.
    basis: Vec<f64>,
    /// Luminance below which nothing is taken any more, `[direction]`.
    least: Vec<f64>,
    /// How far their hue is believed, 0 to 1: 1 − (error / luminance)², `[direction]`.
    trust: Vec<f64>,
}

impl Candidates {
    /// Those that `may` be of the light `rest`, `[k]`; `variance`: that of its luminance, `[k]`.
    fn new(rest: &[[f64; 3]], variance: &[f64], significance: f64, may: impl Fn(Vec3) -> bool) -> Self {
        let mut found = Self { directions: Vec::new(), basis: Vec::new(), least: Vec::new(), trust: Vec::new() };
        let luminance: Vec<f64> = rest.iter().map(luminance_f64).collect();
        for d in sh::even_directions(DIRECTIONS).into_iter().filter(|d| may(d.as_vec3())) {
            let mut y = [0.0; sh::MAX_COEFFICIENTS];
            let y = &mut y[..variance.len()];
            sh::eval(d, y);
            let value = dot(y, &luminance);
            let error = significance * y.iter().zip(variance).map(|(y, v)| y * y * v).sum::<f64>().sqrt();
            if value > error {
                found.directions.push(d.as_vec3());
                found.basis.extend_from_slice(y);
                // What was left of a lamp stays one down to half of what it took to be one.
                found.least.push(0.5 * error);
                found.trust.push(1.0 - (error / value) * (error / value));
            }
        }
        found
    }

    /// The brightest one in `rest`, and its luminance there.
    fn brightest(&self, rest: &[[f64; 3]]) -> Option<(usize, f64)> {
        let luminance: Vec<f64> = rest.iter().map(luminance_f64).collect();
        let values = self.basis.chunks_exact(luminance.len()).map(|y| dot(y, &luminance)).enumerate();
        values.filter(|(i, x)| *x > self.least[*i]).max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)))
    }
}

/// Moves peaks of `rest` into lamps: direction and RGB flux. `variance`: that of the coefficients' luminance, `[k]`; `mean`: RGB of the whole
/// light, whose hue lamps have as far as their own is not believed.
fn clean(
    rest: &mut [[f64; 3]],
    variance: &[f64],
    mean: [f64; 3],
    tuning: &SurroundingsTuning,
    may: impl Fn(Vec3) -> bool,
) -> Vec<(Vec3, Vec3)> {
    let k = variance.len();
    let candidates = Candidates::new(rest, variance, tuning.lamp_significance, may);
    let mut lamps: Vec<(Vec3, Vec3)> = Vec::new();
    let mut first = None;
    for _ in 0..tuning.max_lamps {
        let Some((best, brightest)) = candidates.brightest(rest) else { break };
        let first = *first.get_or_insert(brightest);
        if brightest <= tuning.faintest_lamp * first || brightest <= 0.0 {
            break;
        }
        let y = &candidates.basis[best * k..(best + 1) * k];
        // A lamp of flux 1 shows as Σ Y_k(ω') Y_k(ω), bands² / 4π at its own place.
        let unit = k as f64 / (4.0 * std::f64::consts::PI);
        let own: [f64; 3] = std::array::from_fn(|c| y.iter().zip(rest.iter()).map(|(y, r)| y * r[c]).sum());
        let flux = with_hue_of(mean, own, candidates.trust[best]).map(|x| (tuning.loop_gain * x / unit).max(0.0));
        for (r, y) in rest.iter_mut().zip(y) {
            *r = std::array::from_fn(|c| r[c] - flux[c] * y);
        }
        lamps.push((candidates.directions[best], Vec3::from(flux.map(|f| f as f32))));
    }
    lamps
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lamp_is_found_where_it_is_and_the_light_stays_the_same() {
        let at = Vec3::new(0.48, 0.36, 0.8);
        let truth = Environment::from_fn(|d| Vec3::splat(0.3) + Vec3::ONE * if d.dot(at) > 0.985 { 60.0 } else { 0.0 });
        let light = Light { coefficients: truth.project(5), ..Light::default() };
        let found = complete(&light, &[], &SurroundingsTuning::default());
        assert!(found.radiance(at).y > 10.0 * Environment::from_light(&light).radiance(-at).y.max(0.1));
        let back = found.project(3);
        for (a, b) in back.iter().zip(&light.coefficients) {
            assert!((a[1] - b[1]).abs() < 0.1 * light.coefficients[0][1], "{a:?} {b:?}");
        }
    }

    #[test]
    fn a_peak_that_the_error_of_the_light_explains_is_no_lamp() {
        let at = Vec3::new(0.48, 0.36, 0.8);
        let truth = Environment::from_fn(|d| Vec3::splat(0.3) + Vec3::ONE * if d.dot(at) > 0.985 { 60.0 } else { 0.0 });
        let coefficients = truth.project(5);
        // Standard deviation at the lamp, Σ Y_k² σ² = 25 σ² / 4π, beside its blurred peak.
        let peak = sh::radiance(&coefficients, at.as_dvec3())[1];
        let lamp = |share: f64| {
            let deviation = share * peak / (25.0 / (4.0 * std::f64::consts::PI)).sqrt();
            let light = Light {
                standard_deviation: vec![[deviation; 3]; 25],
                coefficients: coefficients.clone(),
                ..Light::default()
            };
            complete(&light, &[], &SurroundingsTuning::default()).radiance(at).y
        };
        assert!(lamp(0.1) > 1.5 * peak as f32, "{} {peak}", lamp(0.1));
        assert!(lamp(1.0) < 1.1 * peak as f32, "{} {peak}", lamp(1.0));
    }
}
