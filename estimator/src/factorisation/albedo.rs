//! Albedo per vertex: the segment's albedo plus the detail that the lit colours show.

use crate::factorisation::paint::{self, Logs};
use crate::factorisation::problem::{Colors, counted};
use crate::numerics::robust::{median, robust_sigma};
use firmware_config::tuning::FactorisationTuning;
use glam::Vec3;
use rayon::prelude::*;

/// Physically plausible range of an albedo.
const RANGE: (f32, f32) = (1e-4, 1.0);

/// Albedo and confidence of every vertex.
#[derive(Debug, Clone)]
pub struct Detail {
    /// Diffuse albedo, linear RGB: `[vertex]`.
    pub albedo: Vec<Vec3>,
    /// Confidence, 0 (never seen, or unlit) to 1: `[vertex]`.
    pub confidence: Vec<f32>,
    /// The share of its difference from the segment that is taken for paint: `[vertex]`.
    pub painted: Vec<f32>,
}

/// An albedo bounded to what is physically plausible.
#[must_use]
pub fn plausible(albedo: Vec3) -> Vec3 {
    albedo.clamp(Vec3::splat(RANGE.0), Vec3::splat(RANGE.1))
}

/// What determines the albedo of the vertices.
#[derive(Debug, Clone, Copy)]
pub struct Evidence<'a> {
    colors: &'a Colors<'a>,
    /// Irradiance over π, linear RGB: `[vertex]`.
    irradiance: &'a [Vec3],
    /// Relative error of the transfer: `[vertex]`.
    transfer_error: &'a [f32],
    /// The light is a model's: what it leaves of a patch is paint.
    modelled: bool,
}

impl<'a> Evidence<'a> {
    /// Lit colours, irradiance over π and relative error of the transfer, the latter two `[vertex]`.
    #[must_use]
    pub fn new(colors: &'a Colors, irradiance: &'a [Vec3], transfer_error: &'a [f32]) -> Self {
        Self { colors, irradiance, transfer_error, modelled: true }
    }

    /// The irradiance is a smooth function that no light explains: shadows that it leaves are no paint.
    #[must_use]
    pub fn unexplained(self) -> Self {
        Self { modelled: false, ..self }
    }
}

/// a_i = f_i / E_i, regularised towards the segment's albedo where E_i is small or uncertain: the posterior mean of log a_i
/// with the segment's spread as prior and the errors of f_i and E_i as likelihood. What spreads plain surfaces is error of the
/// light and the colours, not paint: a segment's own spread of albedo is what exceeds it, and a patch may have more
/// ([`paint::of_patches`]). `segment_albedo` is `[segment][channel]`; its scale is not fixed yet, nor is that of the answer.
#[must_use]
pub fn detail(evidence: &Evidence, segment_albedo: &[[f64; 3]], tuning: &FactorisationTuning) -> Detail {
    let &Evidence { colors, irradiance, transfer_error, modelled } = evidence;
    let count = colors.lit_color.len();
    let logs: Vec<Logs> = (0..count)
        .into_par_iter()
        .map(|i| {
            let (f, e) = (colors.lit_color[i], irradiance[i]);
            let usable = colors.lit_weight[i] > 0.0 && f.is_finite() && f.min_element() > 0.0 && e.min_element() > 0.0;
            let a = segment_albedo.get(colors.segment[i] as usize)?;
            // A lower bound that the segment's albedo keeps says nothing.
            let least = if colors.clipped[i] { 0.0 } else { f64::NEG_INFINITY };
            usable.then(|| [0, 1, 2].map(|c| libm::log(f64::from(f[c] / e[c]) / a[c].max(1e-9)).max(least)))
        })
        .collect();
    let spreads = spreads(colors.segment, &logs, segment_albedo.len());
    let unexplained = plain_spread(&spreads, tuning);
    let texture = |s: usize| (spreads[s].deviation * spreads[s].deviation - unexplained * unexplained).max(0.0);
    let brightness = medians(evidence, segment_albedo.len());
    let variance: Vec<f64> = (0..count)
        .into_par_iter()
        .map(|i| {
            let own = f64::from(irradiance[i].element_sum());
            let median = brightness.get(colors.segment[i] as usize).copied().unwrap_or(0.0);
            let light_error = tuning.light_error / (own / median.max(1e-30)).clamp(1e-3, 1.0);
            let seen = counted(colors.lit_weight, colors.reliability, i);
            let color_error = tuning.color_error / libm::sqrt(seen.max(0.05));
            unexplained * unexplained
                + light_error * light_error
                + color_error * color_error
                + f64::from(transfer_error[i] * transfer_error[i])
        })
        .collect();
    let patches = if modelled { paint::of_patches(&logs, &variance, colors) } else { vec![0.0; count] };
    let vector = |a: [f64; 3]| Vec3::from_array(a.map(|x| x as f32));
    let each: Vec<(Vec3, f32, f32)> = (0..count)
        .into_par_iter()
        .map(|i| {
            let segment = colors.segment[i] as usize;
            let base = segment_albedo.get(segment).copied().unwrap_or([tuning.initial_albedo; 3]);
            let Some(log) = logs[i] else {
                return (vector(base), 0.0, 0.0);
            };
            let (variance, seen) = (variance[i], counted(colors.lit_weight, colors.reliability, i));
            let paint = texture(segment).max(patches[i]);
            let detail_share = paint / (paint + variance);
            let albedo = [0, 1, 2].map(|c| base[c] * libm::exp((detail_share * log[c]).clamp(-3.0, 3.0)));
            (
                vector(albedo),
                (seen / (1.0 + variance / (tuning.half_confidence_error * tuning.half_confidence_error))) as f32,
                detail_share as f32,
            )
        })
        .collect();
    Detail {
        albedo: each.iter().map(|e| e.0).collect(),
        confidence: each.iter().map(|e| e.1).collect(),
        painted: each.iter().map(|e| e.2).collect(),
    }
}

/// How far the log albedos of a segment's vertices lie from the segment's.
struct Spread {
    /// Robust standard deviation.
    deviation: f64,
    /// Vertices with an albedo.
    vertices: usize,
}

/// The spread of every segment: `[segment]`.
fn spreads(segment: &[u32], logs: &[Logs], segments: usize) -> Vec<Spread> {
    let mut off: Vec<Vec<f64>> = vec![Vec::new(); segments];
    for (log, segment) in logs.iter().zip(segment) {
        if let (Some(log), Some(off)) = (log, off.get_mut(*segment as usize)) {
            off.push((log[0].abs() + log[1].abs() + log[2].abs()) / 3.0);
        }
    }
    off.into_iter().map(|off| Spread { vertices: off.len(), deviation: robust_sigma(off) }).collect()
}

/// The standard deviation of log albedo that is unexplained in plain surfaces: the largest of the plainest segments that hold
/// a share of the surface, and bounded, since all surfaces of a scene may have paint.
fn plain_spread(spreads: &[Spread], tuning: &FactorisationTuning) -> f64 {
    let mut sorted: Vec<&Spread> = spreads.iter().collect();
    sorted.sort_by(|a, b| a.deviation.total_cmp(&b.deviation));
    let plain = tuning.plain_share * sorted.iter().map(|s| s.vertices).sum::<usize>() as f64;
    let mut below = 0;
    let largest = sorted.into_iter().find(|s| {
        below += s.vertices;
        below as f64 > plain
    });
    largest.map_or(0.0, |s| s.deviation.min(tuning.max_unexplained))
}

/// Median of the irradiance summed over channels: `[segment]`.
fn medians(evidence: &Evidence, segments: usize) -> Vec<f64> {
    let mut all: Vec<Vec<f64>> = vec![Vec::new(); segments];
    for (e, segment) in evidence.irradiance.iter().zip(evidence.colors.segment) {
        if let Some(all) = all.get_mut(*segment as usize) {
            all.push(f64::from(e.element_sum()));
        }
    }
    all.into_iter().map(|values| median(values).unwrap_or(0.0)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::graph::Graph;

    /// Three surfaces of 100 vertices in even light: two are off by 5 % (error), one by half (paint).
    #[test]
    fn paint_stays_and_errors_of_plain_surfaces_go() {
        let segment: Vec<u32> = (0..300).map(|i| i / 100).collect();
        let off = |i: u32| if i / 100 == 2 { 0.5 } else { 0.05 };
        let lit_color: Vec<Vec3> =
            (0..300).map(|i| Vec3::splat(0.4 * if i % 2 == 0 { 1.0 + off(i) } else { 1.0 - off(i) })).collect();
        let weight = vec![1.0; 300];
        let clipped = vec![false; segment.len()];
        let colors = Colors {
            lit_color: &lit_color,
            lit_weight: &weight,
            reliability: &[],
            clipped: &clipped,
            segment: &segment,
            segments: 3,
            graph: &Graph::new(segment.len(), &[]),
            known: None,
        };
        let evidence = Evidence::new(&colors, &[Vec3::ONE; 300], &[0.0; 300]);
        let found = detail(&evidence, &[[0.4; 3]; 3], &FactorisationTuning::default());
        for (i, albedo) in found.albedo.iter().enumerate() {
            let (kept, seen) = (albedo.x / 0.4 - 1.0, lit_color[i].x / 0.4 - 1.0);
            if segment[i] == 2 {
                assert!(kept / seen > 0.9, "vertex {i}: {kept} of {seen}");
            } else {
                assert!(kept.abs() < 0.01, "vertex {i}: {kept}");
            }
        }
    }
}
