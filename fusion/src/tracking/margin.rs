//! How far tracking is from its gates.

use crate::camera::rig::LEVELS;
use crate::frame::preprocess::Frame;
use crate::report::Margin;
use crate::tracking::align::Alignment;
use crate::tracking::reference::Reference;
use firmware_config::FusionConfig;
use nalgebra::Vector6;

/// What a tracked frame was found by.
pub struct Evidence<'a> {
    pub frame: &'a Frame,
    pub anchor: &'a Reference,
    pub coarse: &'a Alignment,
    pub fine: &'a Alignment,
    /// Correlations with the references.
    pub correlations: &'a [f32],
    /// Motion since the last frame: metres, radians.
    pub twist: Vector6<f64>,
    /// Time since the last frame, seconds.
    pub dt_s: f64,
}

/// Every part is 0 at its gate and 1 where it is at ease: at twice the smallest fit, at a correlation 0.4 above the
/// smallest, at half of the largest step, at 30 times the eigenvalue of an unobserved direction (or 400 points of
/// texture), at a quarter of the image with depth.
pub fn margin(evidence: &Evidence<'_>, config: &FusionConfig) -> Margin {
    let Evidence { frame, anchor, coarse, fine, correlations, twist, dt_s } = evidence;
    let tuning = &config.tuning.tracking;
    let min_fit = config.min_fit as f32;
    let grown = fine.overlap >= tuning.min_overlap as f32 && fine.fit >= tuning.min_agreement as f32 * fine.overlap;
    let fit = if grown { fine.fit.max(coarse.fit) } else { fine.fit };
    let min_ncc = (tuning.ncc_share * config.min_likeness) as f32;
    let ncc = correlations.iter().copied().reduce(f32::max);
    let (step, turn) = (twist.fixed_rows::<3>(0).norm(), twist.fixed_rows::<3>(3).norm());
    let dt = dt_s.max(1.0 / 60.0);
    let largest = (config.max_speed_m_s * dt).min(config.max_step_m);
    let share = (step / largest).max(turn / (config.max_turn_rad_s * dt).min(config.max_step_rad)) as f32;
    let eigenvalue = libm::log10(fine.condition.max(1e-12) / config.unobserved_below.max(1e-9)) as f32;
    let texture = fine.photo_seen * anchor.photo[LEVELS - 1].len() as f32;
    Margin {
        fit: ramp(fit, min_fit, 2.0 * min_fit),
        likeness: ncc.map_or(1.0, |ncc| ramp(ncc, min_ncc, min_ncc + 0.4)),
        motion: ramp(1.0 - share, 0.0, 0.5),
        structure: ramp(eigenvalue, 0.0, 1.5).max(ramp(texture, 50.0, 400.0)),
        depth: ramp(frame.valid, tuning.min_valid_share as f32, 0.25),
    }
}

fn ramp(x: f32, zero: f32, one: f32) -> f32 {
    ((x - zero) / (one - zero).max(1e-6)).clamp(0.0, 1.0)
}
