//! Prediction of the validation frames.

use crate::association::AssociationContext;
use crate::specular::Reflection;
use crate::stages::gloss::Answer;
use crate::stages::prepare::Prepared;
use crate::stages::run::Run;
use crate::texture::detail::Detail;
use crate::validation;
use glam::Vec3;
use rayon::prelude::*;
use recordings::decision::{Cut, Decision};
use recordings::result::{Texture, WitnessError};
use recordings::scan::Scan;

/// Frames that are predicted at once: a bound of their memory.
const AT_ONCE: usize = 8;

/// Predicts the validation frames as far as the budget allows. `lit_with_gloss` are the lit colours before gloss was removed,
/// linear RGB: `[vertex]`.
pub fn witnesses(
    prepared: &mut Prepared,
    scan: &Scan,
    answer: &Answer,
    lit_with_gloss: &[Vec3],
    texture: Option<&Texture>,
    run: &mut Run,
) -> Vec<WitnessError> {
    run.progress.stage("witnesses", 0.0);
    let Answer { found, gloss } = answer;
    let diffuse: Vec<Vec3> = found.detail.albedo.iter().zip(&found.irradiance).map(|(a, e)| *a * *e).collect();
    let albedo = &found.detail.albedo;
    let detail = texture.and_then(|t| Detail::new(t, &prepared.mesh, albedo).ok());
    let reflection = Reflection::new(&prepared.mesh, &prepared.scene, found);
    let model = validation::Model {
        reflection: &reflection,
        lit_color: lit_with_gloss,
        lit_weight: &prepared.fields.lit_weight,
        diffuse: &diffuse,
        segment: &prepared.segment,
        gloss,
        matte: &prepared.fields.lit_color,
        detail: detail.as_ref(),
        lens: prepared.fields.lens,
    };
    let context = AssociationContext::new(&prepared.mesh, &prepared.scene, &prepared.fields.lens.response, run.config);
    let (mut compared, mut predicted) = (Vec::new(), 0);
    for frames in scan.witnesses.chunks(AT_ONCE) {
        let fitting = frames.iter().take_while(|_| run.plan.witness()).count();
        let of_frame = |frame| validation::compare(&model, &context, frame, run.config);
        compared.extend(frames[..fitting].par_iter().filter_map(of_frame).collect::<Vec<_>>());
        predicted += fitting;
        if fitting < frames.len() {
            run.plan.cut(Cut::Witnesses { predicted: predicted as u32, of: scan.witnesses.len() as u32 });
            break;
        }
    }
    let found = validation::texture_prediction(&compared);
    for decision in &mut prepared.decisions {
        if let Decision::Texture { prediction, .. } = decision {
            *prediction = found;
        }
    }
    prepared.decisions.extend(validation::decision(&compared, run.config));
    compared.into_iter().map(|c| c.error).collect()
}
