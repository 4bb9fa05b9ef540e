//! The factor per channel that albedo × light leaves free.

use crate::factorisation::problem::Colors;
use crate::factorisation::solution::Solution;
use firmware_config::tuning::FactorisationTuning;
use glam::Vec3;

/// The rule of `fix`, as it stands in the result.
#[must_use]
pub fn rule(tuning: &FactorisationTuning) -> String {
    let (percent, albedo) = (100.0 * tuning.scale_min_share, tuning.scale_albedo);
    format!("per channel, the brightest segment with at least {percent} % of the seen vertices has albedo {albedo}")
}

/// Scales albedo and light by the rule. Returns the factors of the albedo, RGB.
pub(super) fn fix(solution: &mut Solution, colors: &Colors, tuning: &FactorisationTuning) -> Vec3 {
    let mut seen = vec![0.0f64; colors.segments];
    for (segment, weight) in colors.segment.iter().zip(colors.lit_weight) {
        if *weight > 0.0 {
            seen[*segment as usize] += 1.0;
        }
    }
    let mut scale = Vec3::ONE;
    for c in 0..3 {
        let albedo: Vec<f64> = solution.albedo.iter().map(|a| a[c]).collect();
        let factor = tuning.scale_albedo / brightest_large(&albedo, &seen, tuning);
        if factor.is_finite() && factor > 0.0 {
            solution.albedo.iter_mut().for_each(|a| a[c] *= factor);
            let light = solution.light.iter_mut().chain(&mut solution.standard_deviation).chain(&mut solution.radiance);
            light.for_each(|l| l[c] /= factor);
            scale[c] = factor as f32;
        }
    }
    scale
}

/// Albedo of the brightest segment that holds the minimum share of the seen vertices. `albedo` and `seen` are `[segment]`.
pub(super) fn brightest_large(albedo: &[f64], seen: &[f64], tuning: &FactorisationTuning) -> f64 {
    let min_seen = tuning.scale_min_share * seen.iter().sum::<f64>();
    let large = albedo.iter().zip(seen).filter(|(_, n)| **n >= min_seen && **n > 0.0).map(|(a, _)| *a);
    large.fold(0.0, f64::max)
}
