//! Light that is not distant, where held-out surface asks for it.

use crate::association::seen_lamps::SeenLamp;
use crate::factorisation::{Colors, FactorisationOptions, Factorised};
use crate::light_model::choose::{self, Chosen, Near};
use crate::light_model::covered::covered;
use crate::light_model::division::Division;
use crate::light_model::lamps::Sphere;
use crate::stages::materials::factorised_again;
use crate::stages::prepare::Prepared;
use crate::stages::result::check_distance;
use crate::stages::run::Run;
use crate::stages::veil::near_veil;
use recordings::local_light::{LightModel, LocalLight};

/// What is allowed in a choice of the model.
#[derive(Clone, Copy, PartialEq)]
enum Trial {
    /// Segments may be divided.
    First,
    /// All stays as it is.
    Again,
    /// What was not seen may radiate.
    UnseenRadiates,
}

/// Puts the answer of a richer model of light in place of the distant one if held-out surface asks for it; the distant one is
/// checked before. Where no model clearly explains the colours, segments may be divided, and the models are tried again. Where none
/// explains them at all, as in closed rooms that were seen in part, what another sheet covers counts as unseen, what was not seen may
/// radiate, and they are tried once more. Veiling glare that the near model tells is taken out of the colours, and they are tried a last
/// time. Changes nothing else.
pub fn select_local_light(
    prepared: &mut Prepared,
    found: &mut Factorised,
    options: &FactorisationOptions,
    run: &mut Run,
) -> LocalLight {
    let sphere = |l: &SeenLamp| Sphere { center: l.center, radius: l.radius };
    let seen_lamps: Vec<Sphere> = prepared.fields.seen_lamps.iter().map(sphere).collect();
    let config = run.config;
    let tuning = &config.tuning.factorisation;
    let paints = &config.tuning.segmentation;
    let choose = |prepared: &Prepared, found: &Factorised, lit_weight: &[f32], trial: Trial, run: &mut Run| {
        let colors = Colors { lit_weight, ..prepared.colors() };
        let Prepared { mesh, scene: rays, background, fields, .. } = prepared;
        let unseen_radiates = trial == Trial::UnseenRadiates;
        // As segmented, divided, and the final one.
        let divided_by = (trial == Trial::First && run.plan.fits_local_light(3)).then_some(paints);
        let (seen_lamps, lampless_air, background) = (&seen_lamps, &fields.lampless_air, &background.evidence);
        let scene =
            choose::Scene { mesh, rays, colors, unseen_radiates, seen_lamps, lampless_air, background, divided_by };
        let chosen = choose::choose(&scene, found, options, &mut || tuning.near_light && run.plan.local_light());
        if chosen.searches > 0 {
            run.plan.local_light_done(chosen.searches);
        }
        chosen
    };
    let is_unexplained = |c: &Chosen| c.near.as_ref().is_some_and(|n| n.light.model == LightModel::Unexplained);
    let mut chosen = choose(prepared, found, &prepared.fields.lit_weight, Trial::First, run);
    if let Some((Division { part, of }, decision)) = chosen.division.take() {
        prepared.decisions.push(decision);
        (prepared.segment, prepared.segments) = (part, of.len());
        *found = factorised_again(prepared, found, options);
        chosen = choose(prepared, found, &prepared.fields.lit_weight, Trial::Again, run);
    }
    if let Some(sunny) = chosen.sunny.take() {
        *found = sunny;
    }
    // Of the vertices; empty unless what another sheet covers counts as unseen.
    let mut hidden: Vec<bool> = Vec::new();
    if is_unexplained(&chosen) {
        let covered = covered(&prepared.mesh, &prepared.graph, &prepared.scene);
        let mut uncovered = prepared.fields.lit_weight.clone();
        hide(&mut uncovered, &covered);
        let again = choose(prepared, found, &uncovered, Trial::UnseenRadiates, run);
        if explained(&again).is_some() {
            (chosen, prepared.fields.lit_weight, hidden) = (again, uncovered, covered);
        }
    }
    // Glare of the lens, and all of it again without.
    let looks_for_veil = tuning.veil && run.plan.fits_local_light(1);
    if let Some(near) = explained(&chosen).filter(|_| looks_for_veil) {
        let (veil, mut share) = near_veil(prepared, &near.irradiance);
        if share.chosen > 0.0 {
            prepared.fields.take_veil(&veil, share.chosen);
            hide(&mut prepared.fields.lit_weight, &hidden);
            let trial = if hidden.is_empty() { Trial::Again } else { Trial::UnseenRadiates };
            let again = choose(prepared, found, &prepared.fields.lit_weight, trial, run);
            if explained(&again).is_some() {
                chosen = again;
            } else {
                // A near model that holds only with the glare left in tells nothing of it.
                prepared.fields.take_veil(&veil, -share.chosen);
                hide(&mut prepared.fields.lit_weight, &hidden);
                (prepared.fields.lens.veil_share, share.chosen) = (0.0, 0.0);
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
