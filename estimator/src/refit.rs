//! Gloss found, taken out of exposures and lit colours, and the factorisation run once more (§3.4).

use crate::association::Association;
use crate::factorise::{Colors, Factorised, Settings, factorise};
use crate::material;
use crate::scene::Scene;
use crate::specular::{self, Gloss, Reflection};
use glam::Vec3;
use recordings::result::Decision;
use recordings::types::Mesh;
use std::sync::Arc;

/// Times that lit colours are cleaned of gloss and factorised at most: light without gloss in it tells gloss better.
const PASSES: usize = 3;
/// Change of the log gains (RMS) that is worth another factorisation.
const WORTHWHILE_GAIN: f64 = 2e-3;

/// Finds the gloss of every segment (Eq. 13). Where there is any, exposures are left to matte segments, and lit colours
/// are cleaned of it and factorised once more, as long as the keyframes are predicted better for it; `fields` then hold
/// the clean colours.
#[must_use]
pub fn refit(
    mesh: &Mesh,
    scene: &Scene,
    fields: &mut Association,
    segment: &[u32],
    mut found: Factorised,
    settings: &Settings,
) -> (Factorised, Vec<Gloss>, Decision) {
    let segments = found.solution.albedo.len();
    let fit = |found: &Factorised, fields: &Association| {
        specular::fit(&reflection(mesh, scene, found), fields, segment, segments)
    };
    let decision = |choice: &str, evidence: String| Decision {
        name: "specular".into(),
        choice: choice.into(),
        evidence,
        next_level: String::new(),
    };
    let matte = vec![Gloss::NONE; segments];
    let mut gloss = fit(&found, fields);
    let mut exposed = String::new();
    if gloss.iter().any(|g| g.significant) {
        let is_matte: Vec<bool> = segment.iter().map(|s| !gloss[*s as usize].significant).collect();
        if let Some(moved) = fields.expose_by(&is_matte, mesh, scene.median_edge()) {
            exposed = format!("; exposures by matte segments alone differ by {moved:.4} (RMS of logs)");
            if moved > WORTHWHILE_GAIN {
                let colors = colors(&fields.lit_color, fields, segment, segments);
                found = factorise(Arc::clone(&found.transfer.traced), &colors, settings, None);
                gloss = fit(&found, fields);
            }
        }
    }
    let glossy = gloss.iter().filter(|g| g.significant).count();
    if glossy == 0 {
        let evidence = format!("no weight stands out of its error in {segments} segments{exposed}");
        return (found, gloss, decision("none", evidence));
    }

    let judge = |f: &Factorised, albedo: &[[f64; 3]], fields: &Association, gloss: &[Gloss]| {
        specular::prediction_error(&reflection(mesh, scene, f), fields, segment, albedo, gloss)
    };
    let without = judge(&found, &found.solution.albedo, fields, &matte);
    // Lit colours without the gloss, and light from them.
    let mut errors = vec![without];
    let (mut best, mut best_gloss, mut next) = (None::<(Factorised, Vec<Vec3>)>, Vec::new(), gloss);
    for _ in 0..PASSES {
        let from = best.as_ref().map_or(&found, |(f, _)| f);
        let clean = specular::clean(&reflection(mesh, scene, from), fields, segment, &next);
        let start = Some((from.solution.clone(), from.detail.clone()));
        let colors = colors(&clean, fields, segment, segments);
        let trial = factorise(Arc::clone(&from.transfer.traced), &colors, settings, start);
        next = fit(&trial, fields);
        let error = judge(&trial, &trial.solution.albedo, fields, &next);
        let falls = errors.iter().all(|e| error < *e);
        errors.push(error);
        if !falls {
            break;
        }
        (best, best_gloss) = (Some((trial, clean)), next.clone());
    }
    let told: Vec<String> = errors[1..].iter().map(|e| format!("{e:.4}")).collect();
    let evidence = format!(
        "{glossy} of {segments} segments; mean relative error against the keyframes: {without:.4} without gloss, {} \
         with it{exposed}",
        told.join(", ")
    );
    let Some((found_clean, clean)) = best else {
        return (found, matte, decision("none", evidence));
    };
    fields.lit_color = clean;
    let best_gloss = material::pooled(mesh, segment, &found_clean.solution.albedo, &best_gloss);
    (found_clean, best_gloss, decision("lit colours cleaned of gloss and factorised once more", evidence))
}

fn colors<'a>(lit_color: &'a [Vec3], fields: &'a Association, segment: &'a [u32], segments: usize) -> Colors<'a> {
    Colors { lit_color, lit_weight: &fields.lit_weight, segment, segments }
}

/// What predicts mirrored light.
#[must_use]
pub fn reflection<'a>(mesh: &'a Mesh, scene: &'a Scene, found: &'a Factorised) -> Reflection<'a> {
    Reflection { mesh, scene, light: &found.solution.light, irradiance: &found.irradiance }
}
