//! Prediction of the validation frames.

use crate::association::AssociationContext;
use crate::specular::Reflection;
use crate::stages::gloss::Answer;
use crate::stages::prepare::Prepared;
use crate::stages::run::Run;
use crate::validation;
use glam::Vec3;
use recordings::decision::Cut;
use recordings::result::WitnessError;
use recordings::scan::Scan;

/// Predicts the validation frames as far as the budget allows. `lit_with_gloss` are the lit colours before gloss was removed,
/// linear RGB: `[vertex]`.
pub fn witnesses(
    prepared: &mut Prepared,
    scan: &Scan,
    answer: &Answer,
    lit_with_gloss: &[Vec3],
    run: &mut Run,
) -> Vec<WitnessError> {
    run.progress.stage("witnesses", 0.0);
    let Answer { found, gloss } = answer;
    let diffuse: Vec<Vec3> = found.detail.albedo.iter().zip(&found.irradiance).map(|(a, e)| *a * *e).collect();
    let model = validation::Model {
        reflection: Reflection::new(&prepared.mesh, &prepared.scene, found),
        lit_color: lit_with_gloss,
        lit_weight: &prepared.fields.lit_weight,
        diffuse: &diffuse,
        segment: &prepared.segment,
        gloss,
    };
    let context = AssociationContext::new(&prepared.mesh, &prepared.scene, &scan.sensor.response, run.config);
    let mut compared = Vec::new();
    for (i, frame) in scan.witnesses.iter().enumerate() {
        if !run.plan.witness() {
            run.plan.cut(Cut::Witnesses { predicted: i as u32, of: scan.witnesses.len() as u32 });
            break;
        }
        compared.extend(validation::compare(&model, &context, frame, run.config));
    }
    prepared.decisions.extend(validation::decision(&compared, run.config));
    compared.into_iter().map(|c| c.error).collect()
}
