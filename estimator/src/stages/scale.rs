//! The scale of the distant answer.

use crate::factorisation::scale::{self, Scaled};
use crate::numerics::cielab::luminance_f64;
use crate::stages::gloss::Answer;
use crate::stages::prepare::Prepared;
use firmware_config::EstimatorConfig;
use recordings::decision::Decision;

/// Fixes the factor per channel of albedo and light that the factorisation leaves free. Gloss keeps its luminance.
pub fn fix_scale(prepared: &mut Prepared, answer: &mut Answer, config: &EstimatorConfig) {
    let Answer { found, gloss } = answer;
    let before = level(&found.solution.light);
    let scaled = Scaled {
        solution: &mut found.solution,
        detail: &mut found.detail,
        irradiance: &mut found.irradiance,
        deviation: scale::UNKNOWN,
    };
    let fixed = scale::fix(scaled, &prepared.colors(), &config.tuning.factorisation);
    let ratio = before / level(&found.solution.light);
    if ratio.is_finite() && ratio > 0.0 {
        gloss.iter_mut().for_each(|g| g.scale_specular(ratio));
    }
    prepared.decisions.push(fixed.decision);
}

/// The rule that fixed the scale, in words.
#[must_use]
pub fn scale_rule(decisions: &[Decision]) -> String {
    let scale = decisions.iter().rev().find(|d| matches!(d, Decision::AlbedoScale { .. }));
    scale.map_or(String::new(), |d| d.text().choice)
}

/// Luminance of the mean radiance, up to a factor.
fn level(light: &[[f64; 3]]) -> f64 {
    light.first().map_or(0.0, luminance_f64)
}
