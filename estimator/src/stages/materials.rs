//! Segments of like albedo become one material, before gloss is looked for, so that light is found once more, and after it.

use crate::factorisation::{FactorisationOptions, Factorised, factorise};
use crate::model_selection::held_out_error;
use crate::numerics::robust::median;
use crate::segmentation::materials::{Paint, materials};
use crate::stages::gloss::Answer;
use crate::stages::prepare::Prepared;
use firmware_config::EstimatorConfig;
use firmware_config::tuning::FactorisationTuning;
use glam::{DVec3, Vec3};
use recordings::decision::Decision;
use std::sync::Arc;

/// Rounds of segmentation and factorisation: the light that materials tell moves the albedos that tell materials.
const ROUNDS: usize = 2;
/// The merged materials may leave more unexplained on held-out vertices by this share.
const TOLERATED: f64 = 0.05;

/// Joins segments by the albedo that `found` gives them, and factorises again with one albedo a material, which ties the light
/// of all places where it is. Keeps the segments where that explains the colours worse.
pub fn merge_materials(
    prepared: &mut Prepared,
    found: Factorised,
    options: &FactorisationOptions,
    config: &EstimatorConfig,
) -> Factorised {
    let (segment, segments) = (prepared.segment.clone(), prepared.segments);
    let before = held_out_error(&found, &prepared.colors(), &config.tuning);
    let mut best: Option<Factorised> = None;
    for _ in 0..ROUNDS {
        let last = best.as_ref().unwrap_or(&found);
        let paints = paints(prepared, &segment, segments, &last.irradiance);
        let materials = materials(&paints, &config.tuning.segmentation);
        let merged: Vec<u32> = segment.iter().map(|s| materials[*s as usize]).collect();
        if merged == prepared.segment {
            break;
        }
        prepared.segments = materials.iter().max().map_or(0, |m| *m as usize + 1);
        prepared.segment = merged;
        best = Some(factorised_again(prepared, last, options));
    }
    let Some(merged) = best else { return found };
    let held_out = held_out_error(&merged, &prepared.colors(), &config.tuning);
    let is_kept = held_out <= before * (1.0 + TOLERATED);
    prepared.decisions.push(Decision::Materials {
        segments: segments as u32,
        materials: if is_kept { prepared.segments } else { segments } as u32,
        held_out_segments: before,
        held_out,
    });
    if is_kept {
        return merged;
    }
    (prepared.segment, prepared.segments) = (segment, segments);
    found
}

/// Factorises again after the segments have changed, from the light of `last` and the albedos under it.
pub(super) fn factorised_again(prepared: &Prepared, last: &Factorised, options: &FactorisationOptions) -> Factorised {
    let start = last.start_with(albedos(prepared, &last.irradiance, options.tuning));
    factorise(Arc::clone(&last.transfer.traced), &prepared.colors(), options, Some(start))
}

/// Albedo of every segment under an irradiance over π, `[vertex]`.
pub(super) fn albedos(prepared: &Prepared, irradiance: &[Vec3], tuning: &FactorisationTuning) -> Vec<[f64; 3]> {
    let paints = paints(prepared, &prepared.segment, prepared.segments, irradiance);
    let albedo = paints.iter().map(|p| p.map(|p| p.log_albedo.to_array().map(libm::exp)));
    albedo.map(|a| a.unwrap_or([tuning.initial_albedo; 3])).collect()
}

/// Median albedo of every segment by lit colour and irradiance: `[segment]`; `None` where nothing is known.
fn paints(prepared: &Prepared, segment: &[u32], segments: usize, irradiance: &[Vec3]) -> Vec<Option<Paint>> {
    let (lit_color, lit_weight) = (&prepared.fields.lit_color, &prepared.fields.lit_weight);
    let mut logs: Vec<[Vec<f64>; 3]> = vec![Default::default(); segments];
    for (i, &s) in segment.iter().enumerate() {
        let (f, e) = (lit_color[i], irradiance[i]);
        if lit_weight[i] > 0.0 && f.is_finite() && f.min_element() > 0.0 && e.min_element() > 0.0 {
            (0..3).for_each(|c| logs[s as usize][c].push(libm::log(f64::from(f[c] / e[c]))));
        }
    }
    let paint = |logs: [Vec<f64>; 3]| {
        let seen = logs[0].len() as f64;
        let [r, g, b] = logs.map(median);
        Some(Paint { log_albedo: DVec3::new(r?, g?, b?), seen, glossy: false })
    };
    logs.into_iter().map(paint).collect()
}

/// Names the materials of the answer: segments of like albedo and gloss get one number, one albedo and one gloss, each the mean
/// by seen vertices. Albedo and light per vertex stay.
pub fn name_materials(prepared: &mut Prepared, answer: &mut Answer, config: &EstimatorConfig) {
    let seen = prepared.colors().seen();
    let albedo = &answer.found.solution.albedo;
    let paint = |(s, a): (usize, &[f64; 3])| Paint::known(*a, seen[s], answer.gloss[s].significant);
    let paints: Vec<Option<Paint>> = albedo.iter().enumerate().map(paint).collect();
    let materials = materials(&paints, &config.tuning.segmentation);
    let count = materials.iter().max().map_or(0, |m| *m as usize + 1);
    let mut members: Vec<Vec<usize>> = vec![Vec::new(); count];
    materials.iter().enumerate().for_each(|(s, m)| members[*m as usize].push(s));
    let mean = |of: &[usize], value: &dyn Fn(usize) -> f64| {
        let (sum, total) = of.iter().fold((0.0, 0.0), |(x, n), &s| (x + seen[s] * value(s), n + seen[s]));
        if total > 0.0 { sum / total } else { value(of[0]) }
    };
    let log = |s: usize, c: usize| libm::log(albedo[s][c].max(f64::MIN_POSITIVE));
    let albedo = members.iter().map(|of| [0, 1, 2].map(|c| libm::exp(mean(of, &|s| log(s, c))))).collect();
    let gloss = members.iter().map(|of| {
        // The lobe is that of the surest segment.
        let surest = of.iter().min_by(|a, b| answer.gloss[**a].error.total_cmp(&answer.gloss[**b].error));
        let mut gloss = answer.gloss[surest.map_or(0, |s| *s)];
        if gloss.significant {
            gloss.w_s = mean(of, &|s| answer.gloss[s].w_s);
            gloss.w_d = mean(of, &|s| answer.gloss[s].w_d);
        }
        gloss
    });
    answer.gloss = gloss.collect();
    answer.found.solution.albedo = albedo;
    prepared.segment.iter_mut().for_each(|s| *s = materials[*s as usize]);
    prepared.segments = count;
}
