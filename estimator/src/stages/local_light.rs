//! Light that is not distant, where held-out surface asks for it.

use crate::factorisation::Factorised;
use crate::light_model::choose;
use crate::stages::prepare::Prepared;
use crate::stages::result::check_distance;
use crate::stages::run::Run;
use recordings::local_light::LocalLight;

/// Puts the answer of a richer model of light in place of the distant one if held-out surface asks for it; the distant one is
/// checked before. Changes nothing else.
pub fn select_local_light(prepared: &mut Prepared, found: &mut Factorised, run: &mut Run) -> LocalLight {
    let clipped = prepared.fields.always_clipped();
    let scene =
        choose::Scene { mesh: &prepared.mesh, rays: &prepared.scene, colors: prepared.colors(), clipped: &clipped };
    let tuning = &run.config.tuning.factorisation;
    let chosen = choose::choose(&scene, found, tuning, &mut || tuning.near_light && run.plan.local_light());
    prepared.decisions.push(chosen.decision);
    if chosen.searched {
        run.plan.local_light_done();
    }
    let Some(near) = chosen.near else { return LocalLight::default() };
    check_distance(prepared, found, run.config);
    (found.solution, found.detail, found.irradiance) = (near.solution, near.detail, near.irradiance);
    prepared.decisions.push(near.scale);
    near.light
}
