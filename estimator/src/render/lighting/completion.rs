//! Completes the light beyond its few spherical harmonics: radiance that keyframes observed, an even level elsewhere, and
//! lamps where the rest of the light must come from.
//!
//! Lamps are found by CLEAN (Högbom, "Aperture Synthesis with a Non-Regular Distribution of Interferometer Baselines",
//! A&AS 15, 1974): the brightest direction of the residual gets a small lamp, its blurred image is subtracted, and again.

use crate::numerics::cielab::{LUMINANCE, luminance};
use crate::numerics::{robust, sh};
use crate::render::lighting::environment::{Environment, SIDE, direction};
use crate::render::lighting::observed_background::ObservedTexel;
use firmware_config::tuning::SurroundingsTuning;
use glam::Vec3;
use rayon::prelude::*;
use recordings::result::Light;

/// Directions that are searched for peaks.
const DIRECTIONS: usize = 4000;

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

    let lamps = clean(&mut rest, bands, tuning, |d| agreement(crate::render::lighting::environment::texel(d)) < 0.5);
    let width = tuning.lamp_width_rad / bands as f64;
    let sharpness = (1.0 / (width * width)) as f32;
    // ∫ exp(s (cos − 1)) dω = 2π (1 − e^(−2s)) / s.
    let peak = sharpness / std::f32::consts::TAU;
    for (k, r) in rest.iter_mut().enumerate() {
        let l = (k.isqrt() as f64).min(tuning.residual_bands);
        *r = r.map(|x| x * 0.5 * (1.0 + libm::cos(std::f64::consts::PI * l / tuning.residual_bands)));
    }
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

/// Moves peaks of `rest` into lamps: direction and RGB flux.
fn clean(
    rest: &mut [[f64; 3]],
    bands: usize,
    tuning: &SurroundingsTuning,
    may: impl Fn(Vec3) -> bool,
) -> Vec<(Vec3, Vec3)> {
    let k = bands * bands;
    let directions: Vec<_> = sh::even_directions(DIRECTIONS).into_iter().filter(|d| may(d.as_vec3())).collect();
    let basis: Vec<f64> = directions
        .iter()
        .flat_map(|d| {
            let mut y = [0.0; sh::MAX_COEFFICIENTS];
            sh::eval(*d, &mut y[..k]);
            y.into_iter().take(k)
        })
        .collect();
    let mut lamps: Vec<(Vec3, Vec3)> = Vec::new();
    let mut first = None;
    for _ in 0..tuning.max_lamps {
        let luminance: Vec<f64> = rest.iter().map(|r| (0..3).map(|c| LUMINANCE[c] * r[c]).sum()).collect();
        let value = |row: &[f64]| -> f64 { row.iter().zip(&luminance).map(|(y, l)| y * l).sum() };
        let Some((best, brightest)) =
            basis.chunks_exact(k).map(value).enumerate().fold(None, |m: Option<(usize, f64)>, (i, x)| {
                if m.is_none_or(|(_, b)| x > b) { Some((i, x)) } else { m }
            })
        else {
            break;
        };
        let first = *first.get_or_insert(brightest);
        if brightest <= tuning.faintest_lamp * first || brightest <= 0.0 {
            break;
        }
        let y = &basis[best * k..(best + 1) * k];
        // A lamp of flux 1 shows as Σ Y_k(ω') Y_k(ω), bands² / 4π at its own place.
        let unit = k as f64 / (4.0 * std::f64::consts::PI);
        let here: [f64; 3] = std::array::from_fn(|c| y.iter().zip(rest.iter()).map(|(y, r)| y * r[c]).sum());
        let flux = here.map(|h| (tuning.loop_gain * h / unit).max(0.0));
        for (r, y) in rest.iter_mut().zip(y) {
            *r = std::array::from_fn(|c| r[c] - flux[c] * y);
        }
        lamps.push((directions[best].as_vec3(), Vec3::from(flux.map(|f| f as f32))));
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
}
