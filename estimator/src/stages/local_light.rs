//! Light that is not distant, where held-out surface asks for it.

use crate::association::seen_lamps::SeenLamp;
use crate::factorisation::{Colors, Factorised};
use crate::light_model::choose::{self, Chosen, Near};
use crate::light_model::covered::covered;
use crate::light_model::lamps::Sphere;
use crate::stages::prepare::Prepared;
use crate::stages::result::check_distance;
use crate::stages::run::Run;
use crate::stages::veil::near_veil;
use recordings::local_light::{LightModel, LocalLight};

/// Puts the answer of a richer model of light in place of the distant one if held-out surface asks for it; the distant one is
/// checked before. Where no model explains the colours, as in closed rooms that were seen in part, what another sheet covers
/// counts as unseen, what was not seen may radiate, and the models are tried again. Veiling glare that the near model tells is taken
/// out of the colours, and the models are tried once more. Changes nothing else.
pub fn select_local_light(prepared: &mut Prepared, found: &mut Factorised, run: &mut Run) -> LocalLight {
    let sphere = |l: &SeenLamp| Sphere { center: l.center, radius: l.radius };
    let seen_lamps: Vec<Sphere> = prepared.fields.seen_lamps.iter().map(sphere).collect();
    let choose = |prepared: &Prepared, lit_weight: &[f32], unseen_radiates: bool, run: &mut Run| {
        let colors = Colors { lit_weight, ..prepared.colors() };
        let (mesh, rays) = (&prepared.mesh, &prepared.scene);
        let scene = choose::Scene { mesh, rays, colors, unseen_radiates, seen_lamps: &seen_lamps };
        let tuning = &run.config.tuning.factorisation;
        let chosen = choose::choose(&scene, found, tuning, &mut || tuning.near_light && run.plan.local_light());
        if chosen.searched {
            run.plan.local_light_done();
        }
        chosen
    };
    let is_unexplained = |c: &Chosen| c.near.as_ref().is_some_and(|n| n.light.model == LightModel::Unexplained);
    let mut chosen = choose(prepared, &prepared.fields.lit_weight, false, run);
    // Of the vertices; empty unless what another sheet covers counts as unseen.
    let mut hidden: Vec<bool> = Vec::new();
    if is_unexplained(&chosen) {
        let covered = covered(&prepared.mesh, &prepared.scene);
        let mut uncovered = prepared.fields.lit_weight.clone();
        hide(&mut uncovered, &covered);
        let again = choose(prepared, &uncovered, true, run);
        if explained(&again).is_some() {
            (chosen, prepared.fields.lit_weight, hidden) = (again, uncovered, covered);
        }
    }
    // Glare of the lens, and all of it again without.
    let looks_for_veil = run.config.tuning.factorisation.veil && run.plan.fits_local_light();
    if let Some(near) = explained(&chosen).filter(|_| looks_for_veil) {
        let (veil, mut share) = near_veil(prepared, &near.irradiance);
        if share.chosen > 0.0 {
            prepared.fields.take_veil(&veil, share.chosen);
            hide(&mut prepared.fields.lit_weight, &hidden);
            let again = choose(prepared, &prepared.fields.lit_weight, !hidden.is_empty(), run);
            if explained(&again).is_some() {
                chosen = again;
            } else {
                // A near model that holds only with the glare left in tells nothing of it.
                prepared.fields.take_veil(&veil, -share.chosen);
                hide(&mut prepared.fields.lit_weight, &hidden);
                (prepared.fields.veil_share, share.chosen) = (0.0, 0.0);
            }
        }
        prepared.decisions.push(share.decision(&veil));
    }
    prepared.decisions.extend(chosen.decisions);
    let Some(near) = chosen.near else { return LocalLight::default() };
    check_distance(prepared, found, run.config);
    (found.solution, found.detail, found.irradiance) = (near.solution, near.detail, near.irradiance);
    prepared.decisions.push(near.scale);
    near.light
}

/// The near model that explains the colours, if one does.
fn explained(chosen: &Chosen) -> Option<&Near> {
    chosen.near.as_ref().filter(|n| n.light.model != LightModel::Unexplained)
}

/// Takes its weight from every vertex that is `covered`.
fn hide(weights: &mut [f32], covered: &[bool]) {
    weights.iter_mut().zip(covered).filter(|(_, covered)| **covered).for_each(|(weight, _)| *weight = 0.0);
}
