//! Albedo in detail: the segments' albedo refined per vertex where light and colours tell more.

use crate::numerics::robust::{median, robust_sigma};
use glam::Vec3;
use rayon::prelude::*;

/// Relative error that a lit colour has, however often it was seen.
const COLOR_ERROR: f64 = 0.02;
/// Relative error of the irradiance where it is as strong as the segment's median.
const LIGHT_ERROR: f64 = 0.02;
/// Relative error at which the confidence is down to one half.
const HALF_CONFIDENCE: f64 = 0.15;
/// Albedos outside are not of this world.
const RANGE: (f32, f32) = (1e-4, 1.0);

/// Albedo and confidence of every vertex.
#[derive(Debug, Clone)]
pub struct Detail {
    /// Diffuse albedo.
    pub albedo: Vec<Vec3>,
    /// 0 (never seen, or unlit) to 1.
    pub confidence: Vec<f32>,
}

/// What is known of the vertices.
#[derive(Debug, Clone, Copy)]
pub struct Known<'a> {
    /// Lit colour f.
    pub lit_color: &'a [Vec3],
    /// Weight behind it; 0 = never seen.
    pub lit_weight: &'a [f32],
    /// Irradiance over π.
    pub irradiance: &'a [Vec3],
    /// Relative error of the transfer.
    pub transfer_error: &'a [f32],
    /// Segment.
    pub segment: &'a [u32],
}

/// `a_i = f_i / E_i`, drawn towards the segment's albedo where E_i is small or uncertain. Both errors and the segment's
/// own spread are variances of log albedo, so the draw is the posterior mean of a log-normal segment.
#[must_use]
pub fn detail(known: &Known, segment_albedo: &[[f64; 3]]) -> Detail {
    let count = known.lit_color.len();
    let logs: Vec<Option<[f64; 3]>> = (0..count)
        .into_par_iter()
        .map(|i| {
            let (f, e) = (known.lit_color[i], known.irradiance[i]);
            let usable = known.lit_weight[i] > 0.0 && f.is_finite() && f.min_element() > 0.0 && e.min_element() > 0.0;
            let a = segment_albedo.get(known.segment[i] as usize)?;
            usable.then(|| [0, 1, 2].map(|c| libm::log(f64::from(f[c] / e[c]) / a[c].max(1e-9))))
        })
        .collect();
    let spreads = spreads(known, &logs, segment_albedo.len());
    let brightness = medians(known, segment_albedo.len());
    let (albedo, confidence) = (0..count)
        .into_par_iter()
        .map(|i| {
            let segment = known.segment[i] as usize;
            let base = segment_albedo.get(segment).copied().unwrap_or([0.5; 3]);
            let clamp = |a: [f64; 3]| Vec3::from_array(a.map(|x| (x as f32).clamp(RANGE.0, RANGE.1)));
            let Some(log) = logs[i] else {
                return (clamp(base), 0.0);
            };
            let relative_light = f64::from(known.irradiance[i].element_sum()) / brightness[segment].max(1e-30);
            let light_error = LIGHT_ERROR / relative_light.clamp(1e-3, 1.0);
            let color_error = COLOR_ERROR / libm::sqrt(f64::from(known.lit_weight[i]).clamp(0.05, 1.0));
            let variance = light_error * light_error
                + color_error * color_error
                + f64::from(known.transfer_error[i] * known.transfer_error[i]);
            let share = spreads[segment] * spreads[segment] / (spreads[segment] * spreads[segment] + variance);
            let albedo = [0, 1, 2].map(|c| base[c] * libm::exp((share * log[c]).clamp(-3.0, 3.0)));
            let seen = f64::from(known.lit_weight[i]).min(1.0);
            (clamp(albedo), (seen / (1.0 + variance / (HALF_CONFIDENCE * HALF_CONFIDENCE))) as f32)
        })
        .unzip();
    Detail { albedo, confidence }
}

/// Robust standard deviation of log albedo within each segment.
fn spreads(known: &Known, logs: &[Option<[f64; 3]>], segments: usize) -> Vec<f64> {
    let mut off: Vec<Vec<f64>> = vec![Vec::new(); segments];
    for (log, segment) in logs.iter().zip(known.segment) {
        if let (Some(log), Some(off)) = (log, off.get_mut(*segment as usize)) {
            off.push((log[0].abs() + log[1].abs() + log[2].abs()) / 3.0);
        }
    }
    off.into_iter().map(robust_sigma).collect()
}

/// Median irradiance of each segment, summed over channels.
fn medians(known: &Known, segments: usize) -> Vec<f64> {
    let mut all: Vec<Vec<f64>> = vec![Vec::new(); segments];
    for (e, segment) in known.irradiance.iter().zip(known.segment) {
        if let Some(all) = all.get_mut(*segment as usize) {
            all.push(f64::from(e.element_sum()));
        }
    }
    all.into_iter().map(|values| median(values).unwrap_or(0.0)).collect()
}
