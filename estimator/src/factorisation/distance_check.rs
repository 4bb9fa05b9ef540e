//! Is the light distant, as the model assumes? Where lit colours depend on position at equal normals, it is not.

use crate::association::Association;
use crate::factorisation::Factorised;
use crate::factorisation::robust_solver::held_out_block;
use firmware_config::tuning::DistanceCheckTuning;
use glam::Vec3;
use nalgebra::{DMatrix, DVector};
use recordings::decision::{Decision, PositionEvidence, Warning};
use recordings::types::Mesh;

/// Vertices that are looked at, at most.
const LOOKED_AT: usize = 20_000;
/// A segment's share of them below which it says nothing of positions.
const LEAST_OF_SEGMENT: usize = 60;
/// Terms in the normal: a residual that depends on it is the light's business, distant or not.
const NORMAL_TERMS: usize = 8;
/// Terms in the position.
const POSITION_TERMS: usize = 9;
/// Log residuals count up to this.
const CAPPED: f64 = 1.0;
/// Looks for position in the residuals. Returns the decision, and the warning if there is one.
///
/// Log residuals of the luminance are regressed, within segments, on the normal alone and on normal and position; blocks of
/// vertices that took no part in the fit say how much position explains.
#[must_use]
pub fn check(
    mesh: &Mesh,
    fields: &Association,
    segment: &[u32],
    found: &Factorised,
    tuning: &DistanceCheckTuning,
) -> (Decision, Option<Warning>) {
    let samples = samples(mesh, fields, segment, found);
    let position = position_share(&samples);
    let contradicted = position.explained > tuning.explained_share && position.change > tuning.changed_log;
    let decision = Decision::DistantLight { holds: !contradicted, position, vertices: samples.len() as u32 };
    (decision, contradicted.then_some(Warning::LightNotDistant(position)))
}

/// One vertex: its segment, terms, log residual, whether it takes part in the fit.
struct Sample {
    segment: u32,
    terms: [f64; NORMAL_TERMS + POSITION_TERMS],
    residual: f64,
    fitted: bool,
}

fn samples(mesh: &Mesh, fields: &Association, segment: &[u32], found: &Factorised) -> Vec<Sample> {
    let usable = |i: &usize| {
        let (f, e) = (fields.lit_color[*i], found.irradiance[*i]);
        fields.lit_weight[*i] > 0.2 && f.is_finite() && f.min_element() > 0.0 && e.min_element() > 0.0
    };
    let all: Vec<usize> = (0..mesh.positions.len()).filter(usable).collect();
    let stride = all.len().div_ceil(LOOKED_AT).max(1);
    let all: Vec<usize> = all.into_iter().step_by(stride).collect();
    let count = all.len().max(1) as f32;
    let center = all.iter().map(|&i| mesh.positions[i]).sum::<Vec3>() / count;
    let size = (all.iter().map(|&i| mesh.positions[i].distance_squared(center)).sum::<f32>() / count).sqrt();
    let brightness: Vec<f32> = all.iter().map(|&i| found.irradiance[i].element_sum()).collect();
    let mut sorted = brightness.clone();
    sorted.sort_unstable_by(f32::total_cmp);
    let dark = sorted.get(sorted.len() / 2).map_or(0.0, |m| 0.1 * m);
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
                // A unit normal's squares sum to one: two of them say all.
                terms: [
                    n[0], n[1], n[2], nn[0], nn[1], nn[2], nn[3], nn[4], p[0], p[1], p[2], pp[0], pp[1], pp[2], pp[3],
                    pp[4], pp[5],
                ],
                residual: residual.clamp(-CAPPED, CAPPED),
                fitted: held_out_block(i as u32).is_none(),
            }
        })
        .collect()
}

/// Evidence where nothing can be fitted.
const UNEXPLAINED: PositionEvidence = PositionEvidence { explained: 0.0, change: 0.0 };

/// Share of the left-out residual that position explains beyond the normal, and the standard deviation of its part.
fn position_share(samples: &[Sample]) -> PositionEvidence {
    let segments = samples.iter().map(|s| s.segment as usize + 1).max().unwrap_or(0);
    let mut centered: Vec<(bool, [f64; NORMAL_TERMS + POSITION_TERMS], f64)> = Vec::with_capacity(samples.len());
    for s in 0..segments {
        let of: Vec<&Sample> = samples.iter().filter(|x| x.segment as usize == s).collect();
        let fitted = of.iter().filter(|x| x.fitted).count();
        if fitted < LEAST_OF_SEGMENT {
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
