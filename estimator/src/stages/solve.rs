//! Light, albedo, materials and gloss of a prepared scan (§3.2 to §3.4).

use crate::factorisation::{FactorisationOptions, factorise};
use crate::specular::Gloss;
use crate::stages::division::divide_segments;
use crate::stages::gloss::{Answer, remove_gloss};
use crate::stages::hidden::continue_hidden;
use crate::stages::local_light::select_local_light;
use crate::stages::materials::merge_materials;
use crate::stages::model::{select_model, spend, trace};
use crate::stages::prepare::Prepared;
use crate::stages::result::check_distance;
use crate::stages::run::Run;
use crate::stages::scale::fix_scale;
use crate::stages::veil::remove_veil;
use firmware_config::SolverChoice;
use glam::Vec3;
use recordings::local_light::{LightModel, LocalLight};
use std::sync::Arc;

/// Light and albedo of a prepared scan.
pub struct Solved<'a> {
    /// Light and albedo; no gloss yet.
    pub answer: Answer,
    /// Light that is not distant.
    pub local_light: LocalLight,
    /// The distant part's transfer level, bounces and bands.
    pub options: FactorisationOptions<'a>,
}

/// Transfer (Eq. 8), then light and albedo (Eqs. 9–12); light that is not distant where held-out surface asks for it (N1).
pub fn light_and_albedo<'a>(prepared: &mut Prepared, run: &mut Run<'a>) -> Solved<'a> {
    let traced = trace(prepared, run);
    let model = select_model(prepared, traced, run);
    let mut found = factorise(Arc::clone(&model.traced), &prepared.colors(), &model.options, model.start);
    run.plan.light_done(model.traced.mean_blocked(), model.options.bands);
    let local_light = select_local_light(prepared, &mut found, &model.options, run);
    let gloss = vec![Gloss::NONE; prepared.segments];
    Solved { answer: Answer { found, gloss }, local_light, options: model.options }
}

/// Materials (§3.2 again), glare of the lens, specular weights and the factorisation without gloss (Eq. 13), where light is distant.
/// Returns the lit colours before gloss was taken out as well, linear sensor values, `[vertex]`.
pub fn materials_and_gloss(prepared: &mut Prepared, solved: Solved, run: &mut Run) -> (Answer, LocalLight, Vec<Vec3>) {
    let Solved { answer: Answer { mut found, gloss }, local_light, options } = solved;
    if local_light.model != LightModel::Distant {
        // Eq. (13) mirrors distant light alone.
        return (Answer { found, gloss }, local_light, prepared.fields.lit_color.clone());
    }
    let config = run.config;
    let (blocked, bands) = (found.transfer.traced.mean_blocked(), options.bands);
    if run.plan.materials(blocked, bands) {
        if config.solver == SolverChoice::Robust {
            found = divide_segments(prepared, found, &options, config);
            found = remove_veil(prepared, found, &options, config);
            found = merge_materials(prepared, found, &options, config);
        }
        run.plan.materials_done(blocked, bands);
    }
    let lit_with_gloss = prepared.fields.lit_color.clone();
    let mut answer = remove_gloss(prepared, found, &options, run);
    answer.found = spend(prepared, answer.found, &options, run);
    check_distance(prepared, &answer.found, config);
    // The factor per channel that Eq. (9) leaves free (S1).
    fix_scale(prepared, &mut answer, config);
    continue_hidden(&prepared.colors(), &mut answer.found, config);
    (answer, local_light, lit_with_gloss)
}
