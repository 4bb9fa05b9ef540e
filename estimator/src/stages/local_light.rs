//! Light that is not distant, where held-out surface asks for it.

use crate::association::seen_lamps::SeenLamp;
use crate::factorisation::{Colors, Factorised};
use crate::light_model::choose::{self, Chosen};
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
    let seen = |prepared: &Prepared, covered: Option<&[bool]>| -> Vec<f32> {
        let is_covered = |i: usize| covered.is_some_and(|c| c[i]);
        let weights = prepared.fields.lit_weight.iter().enumerate();
        weights.map(|(i, w)| if is_covered(i) { 0.0 } else { *w }).collect()
    };
    let mut hidden: Option<Vec<bool>> = None;
    if is_unexplained(&chosen) {
        let covered = covered(&prepared.mesh, &prepared.scene);
        let uncovered = seen(prepared, Some(&covered));
        let again = choose(prepared, &uncovered, true, run);
        if again.near.is_some() && !is_unexplained(&again) {
            chosen = again;
            prepared.fields.lit_weight = uncovered;
            hidden = Some(covered);
        }
    }
    // Glare of the lens, and all of it again without.
    let looks_for_veil =
        run.config.tuning.factorisation.veil && run.plan.fits_local_light() && !is_unexplained(&chosen);
    if let Some(near) = chosen.near.as_ref().filter(|_| looks_for_veil) {
        let (veil, mut share) = near_veil(prepared, &near.irradiance);
        if share.chosen > 0.0 {
            prepared.fields.take_veil(&veil, share.chosen);
            let again = choose(prepared, &seen(prepared, hidden.as_deref()), hidden.is_some(), run);
            if again.near.is_some() && !is_unexplained(&again) {
                chosen = again;
            } else {
                // A near model that holds only with the glare left in tells nothing of it.
                prepared.fields.take_veil(&veil, -share.chosen);
                (prepared.fields.veil_share, share.chosen) = (0.0, 0.0);
            }
            prepared.fields.lit_weight = seen(prepared, hidden.as_deref());
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
