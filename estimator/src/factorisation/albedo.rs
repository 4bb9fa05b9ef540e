//! Albedo per vertex: the segment's albedo plus the detail that the lit colours show.

use crate::factorisation::problem::Colors;
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
    /// Standard deviation of the log irradiance that the model of light leaves unexplained in plain surfaces.
    unexplained: f64,
}

impl<'a> Evidence<'a> {
    /// Lit colours, irradiance over π and relative error of the transfer, the latter two `[vertex]`.
    #[must_use]
    pub fn new(colors: &'a Colors, irradiance: &'a [Vec3], transfer_error: &'a [f32]) -> Self {
        Self { colors, irradiance, transfer_error, unexplained: 0.0 }
    }

    /// The same where the model of light leaves this standard deviation of the log irradiance unexplained in plain surfaces: a
    /// segment's own spread of albedo is what exceeds it.
    #[must_use]
    pub fn with_unexplained(self, unexplained: f64) -> Self {
        Self { unexplained, ..self }
    }
}

/// a_i = f_i / E_i, regularised towards the segment's albedo where E_i is small or uncertain: the posterior mean of log a_i
/// with the segment's spread as prior and the errors of f_i and E_i as likelihood. `segment_albedo` is `[segment][channel]`;
/// its scale is not fixed yet, nor is that of the answer.
#[must_use]
pub fn detail(evidence: &Evidence, segment_albedo: &[[f64; 3]], tuning: &FactorisationTuning) -> Detail {
    let &Evidence { colors, irradiance, transfer_error, unexplained } = evidence;
    let count = colors.lit_color.len();
    let logs: Vec<Option<[f64; 3]>> = (0..count)
        .into_par_iter()
        .map(|i| {
            let (f, e) = (colors.lit_color[i], irradiance[i]);
            let usable = colors.lit_weight[i] > 0.0 && f.is_finite() && f.min_element() > 0.0 && e.min_element() > 0.0;
            let a = segment_albedo.get(colors.segment[i] as usize)?;
            usable.then(|| [0, 1, 2].map(|c| libm::log(f64::from(f[c] / e[c]) / a[c].max(1e-9))))
        })
        .collect();
    let spreads = spreads(colors.segment, &logs, segment_albedo.len());
    let brightness = medians(evidence, segment_albedo.len());
    let vector = |a: [f64; 3]| Vec3::from_array(a.map(|x| x as f32));
    let (albedo, confidence) = (0..count)
        .into_par_iter()
        .map(|i| {
            let segment = colors.segment[i] as usize;
            let base = segment_albedo.get(segment).copied().unwrap_or([tuning.initial_albedo; 3]);
            let Some(log) = logs[i] else {
                return (vector(base), 0.0);
            };
            let relative_light = f64::from(irradiance[i].element_sum()) / brightness[segment].max(1e-30);
            let light_error = tuning.light_error / relative_light.clamp(1e-3, 1.0);
            let color_error = tuning.color_error / libm::sqrt(f64::from(colors.lit_weight[i]).clamp(0.05, 1.0));
            let variance = unexplained * unexplained
                + light_error * light_error
                + color_error * color_error
                + f64::from(transfer_error[i] * transfer_error[i]);
            let texture = (spreads[segment] * spreads[segment] - unexplained * unexplained).max(0.0);
            let detail_share = texture / (texture + variance);
            let albedo = [0, 1, 2].map(|c| base[c] * libm::exp((detail_share * log[c]).clamp(-3.0, 3.0)));
            let seen = f64::from(colors.lit_weight[i]).min(1.0);
            (
                vector(albedo),
                (seen / (1.0 + variance / (tuning.half_confidence_error * tuning.half_confidence_error))) as f32,
            )
        })
        .unzip();
    Detail { albedo, confidence }
}

/// Robust standard deviation of log albedo: `[segment]`.
fn spreads(segment: &[u32], logs: &[Option<[f64; 3]>], segments: usize) -> Vec<f64> {
    let mut off: Vec<Vec<f64>> = vec![Vec::new(); segments];
    for (log, segment) in logs.iter().zip(segment) {
        if let (Some(log), Some(off)) = (log, off.get_mut(*segment as usize)) {
            off.push((log[0].abs() + log[1].abs() + log[2].abs()) / 3.0);
        }
    }
    off.into_iter().map(robust_sigma).collect()
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
