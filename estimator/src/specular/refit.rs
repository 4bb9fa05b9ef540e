//! Gloss found, taken out of exposures and lit colours, and the factorisation run once more (§3.4).

use crate::association::Association;
use crate::factorisation::{Colors, Factorised, Settings, factorise};
use crate::numerics::sh;
use crate::rays::RayScene;
use crate::specular::material;
use crate::specular::{self, Gloss, Prediction, Reflection};
use glam::Vec3;
use recordings::decision::Decision;
use recordings::types::Mesh;
use std::sync::Arc;

/// Times that lit colours are cleaned of gloss and factorised at most: light without gloss in it tells gloss better.
const PASSES: usize = 3;
/// Change of the log gains (RMS) that is worth another factorisation.
const WORTHWHILE_GAIN: f64 = 2e-3;
/// More bands must predict the keyframes better by this many standard errors.
const SIGNIFICANT_GAIN: f64 = 1.0;

/// An answer with the gloss taken out.
struct Cleaned {
    found: Factorised,
    lit_color: Vec<Vec3>,
    gloss: Vec<Gloss>,
    prediction: Prediction,
    settings: Settings,
}

/// Finds the gloss of every segment (Eq. 13). Where there is any, exposures are left to matte segments, and lit colours
/// are cleaned of it and factorised once more, as long as the keyframes are predicted better for it; `fields` then hold the
/// clean colours. What gloss had hidden may ask for more bands.
#[must_use]
pub fn refit(
    mesh: &Mesh,
    scene: &RayScene,
    fields: &mut Association,
    segment: &[u32],
    mut found: Factorised,
    settings: &Settings,
) -> (Factorised, Vec<Gloss>, Vec<Decision>) {
    let segments = found.solution.albedo.len();
    let fit = |found: &Factorised, fields: &Association| {
        specular::fit(&reflection(mesh, scene, found), fields, segment, segments)
    };
    let matte = vec![Gloss::NONE; segments];
    let mut gloss = fit(&found, fields);
    let mut exposure_change = None;
    if gloss.iter().any(|g| g.significant) {
        let is_matte: Vec<bool> = segment.iter().map(|s| !gloss[*s as usize].significant).collect();
        if let Some(moved) = fields.expose_by(&is_matte, mesh, scene.median_edge()) {
            exposure_change = Some(moved);
            if moved > WORTHWHILE_GAIN {
                let colors = colors(&fields.lit_color, fields, segment, segments);
                found = factorise(Arc::clone(&found.transfer.traced), &colors, settings, None);
                gloss = fit(&found, fields);
            }
        }
    }
    let glossy = gloss.iter().filter(|g| g.significant).count();
    let decision = |cleaned, without_gloss, with_gloss| Decision::Specular {
        cleaned,
        segments: segments as u32,
        glossy: glossy as u32,
        exposure_change,
        without_gloss,
        with_gloss,
    };
    if glossy == 0 {
        return (found, gloss, vec![decision(false, None, Vec::new())]);
    }

    let judge = |f: &Factorised, gloss: &[Gloss]| {
        specular::predict(&reflection(mesh, scene, f), fields, segment, &f.solution.albedo, gloss)
    };
    // Lit colours without the gloss, and light from them.
    let cleaned = |from: &Factorised, gloss: &[Gloss], settings: Settings| {
        let lit_color = specular::clean(&reflection(mesh, scene, from), fields, segment, gloss);
        let colors = colors(&lit_color, fields, segment, segments);
        // More bands are new evidence for the pull, now that gloss is out.
        let same_bands = from.solution.light.len() == settings.bands * settings.bands;
        let start = same_bands.then(|| from.start());
        let found = factorise(Arc::clone(&from.transfer.traced), &colors, &settings, start);
        let gloss = fit(&found, fields);
        let prediction = judge(&found, &gloss);
        Cleaned { found, lit_color, gloss, prediction, settings }
    };
    let without = judge(&found, &matte);
    let mut best = cleaned(&found, &gloss, *settings);
    let mut told = vec![best.prediction.error()];
    // Weights that stand out of their errors are evidence; that the keyframes are predicted no worse is the proof.
    let holds = best.prediction.gain_over(&without) > -SIGNIFICANT_GAIN;
    let again = |best: &mut Cleaned, told: &mut Vec<f64>, most: usize| {
        for _ in 0..most {
            let trial = cleaned(&best.found, &best.gloss, best.settings);
            told.push(trial.prediction.error());
            if trial.prediction.error() >= best.prediction.error() {
                break;
            }
            *best = trial;
        }
    };
    if holds {
        again(&mut best, &mut told, PASSES - 1);
    }
    let mut decisions = vec![decision(holds, Some(without.error()), told)];
    if !holds {
        return (found, matte, decisions);
    }
    let first = best.settings.bands;
    while best.settings.bands + 2 <= settings.most_bands {
        let before = best.settings.bands;
        let error_before = best.prediction.error();
        let more = Settings { bands: before + 2, ..best.settings };
        let mut trial = cleaned(&best.found, &best.gloss, more);
        let mut errors = vec![trial.prediction.error()];
        again(&mut trial, &mut errors, PASSES - 1);
        let better = trial.prediction.gain_over(&best.prediction) > SIGNIFICANT_GAIN;
        if better {
            best = trial;
        }
        decisions.push(Decision::BandsWithoutGloss {
            chosen: best.settings.bands as u32,
            first: first as u32,
            before: before as u32,
            tried: more.bands as u32,
            error_before,
            errors,
        });
        if !better {
            break;
        }
    }
    fields.lit_color = best.lit_color;
    let gloss = material::pooled(mesh, segment, &best.found.solution.albedo, &best.gloss);
    (best.found, gloss, decisions)
}

fn colors<'a>(lit_color: &'a [Vec3], fields: &'a Association, segment: &'a [u32], segments: usize) -> Colors<'a> {
    Colors { lit_color, lit_weight: &fields.lit_weight, segment, segments }
}

/// What predicts mirrored light: the bands that mirrors show.
#[must_use]
pub fn reflection<'a>(mesh: &'a Mesh, scene: &'a RayScene, found: &'a Factorised) -> Reflection<'a> {
    let light = &found.solution.light;
    let light = &light[..light.len().min(sh::MIRRORED_BANDS * sh::MIRRORED_BANDS)];
    Reflection { mesh, scene, light, irradiance: &found.irradiance }
}
