//! Check of the assumption of distant light: near light makes lit colours depend on position at equal normals.

use crate::association::Association;
use crate::factorisation::factorise::Factorised;
use crate::factorisation::held_out;
use crate::numerics::robust::median;
use firmware_config::tuning::DistanceCheckTuning;
use glam::Vec3;
use nalgebra::{DMatrix, DVector};
use recordings::decision::{Decision, PositionEvidence, Warning};
use recordings::types::Mesh;

/// Terms of the normal: residuals that depend on it are errors of the light, distant or not.
const NORMAL_TERMS: usize = 8;
/// Terms of the position.
const POSITION_TERMS: usize = 9;
/// Regresses log residuals of the brightness, within segments, on the normal alone and on normal and position, and compares
/// both on held-out vertices. `segment` is `[vertex]`. Returns the decision, and a warning if position explains too much.
#[must_use]
pub fn check(
    mesh: &Mesh,
    fields: &Association,
    segment: &[u32],
    found: &Factorised,
    tuning: &DistanceCheckTuning,
) -> (Decision, Option<Warning>) {
    let samples = samples(mesh, fields, segment, found, tuning);
    let position = position_evidence(&samples, tuning.min_segment_vertices as usize);
    let contradicted = position.explained > tuning.explained_share && position.change > tuning.changed_log;
    let decision = Decision::DistantLight { holds: !contradicted, position, vertices: samples.len() as u32 };
    (decision, contradicted.then_some(Warning::LightNotDistant(position)))
}

/// One vertex: its segment, terms, log residual, and whether it takes part in the fit.
struct Sample {
    segment: u32,
    terms: [f64; NORMAL_TERMS + POSITION_TERMS],
    residual: f64,
    fitted: bool,
}

fn samples(
    mesh: &Mesh,
    fields: &Association,
    segment: &[u32],
    found: &Factorised,
    tuning: &DistanceCheckTuning,
) -> Vec<Sample> {
    let usable = |i: &usize| {
        let (f, e) = (fields.lit_color[*i], found.irradiance[*i]);
        fields.lit_weight[*i] > tuning.min_lit_weight as f32
            && f.is_finite()
            && f.min_element() > 0.0
            && e.min_element() > 0.0
    };
    let all: Vec<usize> = (0..mesh.positions.len()).filter(usable).collect();
    let stride = all.len().div_ceil(tuning.max_vertices as usize).max(1);
    let all: Vec<usize> = all.into_iter().step_by(stride).collect();
    let count = all.len().max(1) as f32;
    let center = all.iter().map(|&i| mesh.positions[i]).sum::<Vec3>() / count;
    let size = (all.iter().map(|&i| mesh.positions[i].distance_squared(center)).sum::<f32>() / count).sqrt();
    let brightness: Vec<f32> = all.iter().map(|&i| found.irradiance[i].element_sum()).collect();
    let dark = tuning.min_relative_light as f32 * median(brightness.iter().copied()).unwrap_or(0.0);
    all.iter()
        .zip(&brightness)
        .filter(|(_, b)| **b > dark)
        .map(|(&i, _)| {
            let n = mesh.normals[i].to_array().map(f64::from);
            let p = ((mesh.positions[i] - center) / size.max(f32::MIN_POSITIVE)).to_array().map(f64::from);
            let albedo = found.solution.albedo[segment[i] as usize];
            let predicted: f64 = (0..3).map(|c| albedo[c] * f64::from(found.irradiance[i][c])).sum();
            let residual = libm::log(f64::from(fields.lit_color[i].element_sum()) / predicted.max(1e-30));
            let quadratic =
                |v: [f64; 3]| [v[0] * v[1], v[1] * v[2], v[0] * v[2], v[0] * v[0], v[1] * v[1], v[2] * v[2]];
            let (nn, pp) = (quadratic(n), quadratic(p));
            Sample {
                segment: segment[i],
                // The squares of a unit normal sum to 1: two of them suffice.
                terms: [
                    n[0], n[1], n[2], nn[0], nn[1], nn[2], nn[3], nn[4], p[0], p[1], p[2], pp[0], pp[1], pp[2], pp[3],
                    pp[4], pp[5],
                ],
                residual: residual.clamp(-tuning.max_log_residual, tuning.max_log_residual),
                fitted: held_out::block(i as u32).is_none(),
            }
        })
        .collect()
}

/// Evidence where nothing can be fitted.
const UNEXPLAINED: PositionEvidence = PositionEvidence { explained: 0.0, change: 0.0 };

/// How far position explains the residuals on held-out vertices beyond the normal.
fn position_evidence(samples: &[Sample], min_segment_vertices: usize) -> PositionEvidence {
    let segments = samples.iter().map(|s| s.segment as usize + 1).max().unwrap_or(0);
    let mut centered: Vec<(bool, [f64; NORMAL_TERMS + POSITION_TERMS], f64)> = Vec::with_capacity(samples.len());
    for s in 0..segments {
        let of: Vec<&Sample> = samples.iter().filter(|x| x.segment as usize == s).collect();
        let fitted = of.iter().filter(|x| x.fitted).count();
        if fitted < min_segment_vertices {
            continue;
        }
        let mean =
            |get: &dyn Fn(&Sample) -> f64| of.iter().filter(|x| x.fitted).map(|x| get(x)).sum::<f64>() / fitted as f64;
        let terms: [f64; NORMAL_TERMS + POSITION_TERMS] = std::array::from_fn(|k| mean(&|x| x.terms[k]));
        let residual = mean(&|x| x.residual);
        centered.extend(
            of.iter().map(|x| (x.fitted, std::array::from_fn(|k| x.terms[k] - terms[k]), x.residual - residual)),
        );
    }
    let fit = |k: usize| -> Option<DVector<f64>> {
        let mut normal = DMatrix::<f64>::zeros(k, k);
        let mut target = DVector::zeros(k);
        for (_, terms, residual) in centered.iter().filter(|c| c.0) {
            for a in 0..k {
                for b in 0..k {
                    normal[(a, b)] += terms[a] * terms[b];
                }
                target[a] += terms[a] * residual;
            }
        }
        let ridge = 1e-6 * normal.trace().max(1e-30);
        (0..k).for_each(|a| normal[(a, a)] += ridge);
        normal.cholesky().map(|c| c.solve(&target))
    };
    let (Some(with), Some(without)) = (fit(NORMAL_TERMS + POSITION_TERMS), fit(NORMAL_TERMS)) else {
        return UNEXPLAINED;
    };
    let predict = |x: &DVector<f64>, terms: &[f64], from: usize| -> f64 {
        x.iter().zip(terms).skip(from).map(|(x, t)| x * t).sum()
    };
    let (mut left, mut better, mut part, mut count) = (0.0, 0.0, 0.0, 0.0);
    for (_, terms, residual) in centered.iter().filter(|c| !c.0) {
        left += (residual - predict(&without, terms, 0)).powi(2);
        better += (residual - predict(&with, terms, 0)).powi(2);
        part += predict(&with, terms, NORMAL_TERMS).powi(2);
        count += 1.0;
    }
    if left <= 0.0 || count < 1.0 {
        return UNEXPLAINED;
    }
    PositionEvidence { explained: (1.0 - better / left).max(0.0), change: libm::sqrt(part / count) }
}
