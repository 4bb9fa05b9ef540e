//! Albedo at the resolution of the photographs.

use crate::association::AssociationContext;
use crate::stages::gloss::Answer;
use crate::stages::prepare::Prepared;
use crate::stages::run::Run;
use crate::texture::albedo;
use crate::texture::filling::VertexColors;
use glam::Vec3;
use recordings::result::Texture;
use recordings::scan::Scan;

/// The texture, if it is asked for and fits the budget. `lit_with_gloss` are the lit colours before gloss was removed, linear
/// RGB: `[vertex]`.
pub fn texture(
    prepared: &mut Prepared,
    scan: &Scan,
    answer: &Answer,
    lit_with_gloss: &[Vec3],
    run: &mut Run,
) -> Option<Texture> {
    if !run.plan.texture() {
        return None;
    }
    run.progress.stage("texture", 0.0);
    let context = AssociationContext::new(&prepared.mesh, &prepared.scene, &prepared.fields.lens.response, run.config);
    let colors = VertexColors {
        with_gloss: lit_with_gloss,
        matte: &prepared.fields.lit_color,
        weight: &prepared.fields.lit_weight,
        albedo: &answer.found.detail.albedo,
    };
    let stride = run.plan.workload().keyframe_stride;
    let keyframes: Vec<_> = (scan.keyframes.iter().zip(&prepared.fields.views))
        .zip(&prepared.fields.veils)
        .map(|((keyframe, view), veil)| (keyframe, view, veil))
        .step_by(stride)
        .collect();
    let (texture, decision) = albedo::texture(&context, &keyframes, colors, prepared.fields.lens);
    prepared.decisions.push(decision);
    run.plan.texture_done();
    texture
}
