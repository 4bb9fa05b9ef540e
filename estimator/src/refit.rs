//! Gloss found, taken out of the lit colours, and the factorisation run once more (§3.4).

use crate::association::Association;
use crate::factorise::{Colors, Factorised, Settings, factorise};
use crate::scene::Scene;
use crate::specular::{self, Gloss, Reflection};
use recordings::result::Decision;
use recordings::types::Mesh;
use std::sync::Arc;

/// Finds the gloss of every segment (Eq. 13). Where there is any, lit colours are cleaned of it and factorised once more;
/// the answer is kept only if it predicts the keyframes better, and then `fields` hold the clean colours.
#[must_use]
pub fn refit(
    mesh: &Mesh,
    scene: &Scene,
    fields: &mut Association,
    segment: &[u32],
    found: Factorised,
    settings: &Settings,
) -> (Factorised, Vec<Gloss>, Decision) {
    let segments = found.solution.albedo.len();
    let gloss = specular::fit(&reflection(mesh, scene, &found), fields, segment, segments);
    let glossy = gloss.iter().filter(|g| g.significant).count();
    let decision = |choice: &str, evidence: String| Decision {
        name: "specular".into(),
        choice: choice.into(),
        evidence,
        next_level: String::new(),
    };
    if glossy == 0 {
        let evidence = format!("no weight stands out of its error in {segments} segments");
        return (found, gloss, decision("none", evidence));
    }
    let matte = vec![Gloss::NONE; segments];
    let judge = |f: &Factorised, fields: &Association, gloss: &[Gloss]| {
        specular::prediction_error(&reflection(mesh, scene, f), fields, segment, &f.solution.albedo, gloss)
    };
    let before = judge(&found, fields, &matte);
    let clean = specular::clean(&reflection(mesh, scene, &found), fields, segment, &gloss);
    let colors = Colors { lit_color: &clean, lit_weight: &fields.lit_weight, segment, segments };
    let start = Some((found.solution.clone(), found.detail.clone()));
    let again = factorise(Arc::clone(&found.transfer.traced), &colors, settings, start);
    let after = judge(&again, fields, &gloss);
    let evidence = format!(
        "{glossy} of {segments} segments; mean relative error against the keyframes {before:.4} without, {after:.4} with"
    );
    if after >= before {
        return (found, matte, decision("none", evidence));
    }
    fields.lit_color = clean;
    let gloss = specular::fit(&reflection(mesh, scene, &again), fields, segment, segments);
    (again, gloss, decision("lit colours cleaned of gloss and factorised once more", evidence))
}

/// What predicts mirrored light.
#[must_use]
pub fn reflection<'a>(mesh: &'a Mesh, scene: &'a Scene, found: &'a Factorised) -> Reflection<'a> {
    Reflection { mesh, scene, light: &found.solution.light, irradiance: &found.irradiance }
}
