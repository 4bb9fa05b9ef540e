//! How much tracking may cost: coarse-to-fine schedules, and the choice among them under a budget.
//!
//! The budget is kept by counting work, not by reading a clock, so that a replay gives the same bits on any machine.

use crate::tracking::align::{Geometry, Step};
use firmware_config::FusionConfig;

/// One way to track a frame.
#[derive(Debug, PartialEq)]
pub struct Effort {
    /// Frame to frame: coarse, wide.
    pub coarse: &'static [Step],
    /// Frame to anchor and model: fine.
    pub fine: &'static [Step],
    /// CPU time on the reference machine for a frame full of depth, milliseconds.
    track_ms: f64,
}

const fn reference(level: usize, rounds: usize, cut: f32) -> Step {
    Step { level, geometry: Geometry::Reference, rounds, cut }
}

const fn volume(level: usize, stride: usize, rounds: usize, cut: f32) -> Step {
    Step { level, geometry: Geometry::Volume { stride }, rounds, cut }
}

/// From the best to the cheapest.
static EFFORTS: [Effort; 3] = [
    Effort {
        coarse: &[reference(2, 3, 12.0), reference(1, 1, 6.0)],
        fine: &[volume(1, 2, 1, 6.0), volume(0, 1, 3, 4.0)],
        track_ms: 14.0,
    },
    Effort { coarse: &[reference(2, 3, 12.0)], fine: &[volume(1, 3, 2, 6.0), volume(0, 3, 1, 4.0)], track_ms: 8.0 },
    Effort { coarse: &[reference(2, 2, 12.0)], fine: &[volume(1, 6, 2, 5.0)], track_ms: 4.5 },
];

/// Frame to anchor when lost: coarse, from further away.
pub static FIND: [Step; 2] = [reference(2, 8, 20.0), reference(1, 4, 8.0)];

/// Cost of a frame apart from tracking, on the reference machine: milliseconds fixed and per block integrated.
const FIXED_MS: f64 = 5.0;
const BLOCK_MS: f64 = 0.002;

/// The best effort there is.
pub fn best() -> &'static Effort {
    &EFFORTS[0]
}

/// The best effort that fits the budget beside integrating as many blocks as the last frame did; the cheapest if none.
pub fn choose(config: &FusionConfig, last_blocks: usize, valid: f32) -> &'static Effort {
    let rest = config.max_cpu_ms_per_frame - FIXED_MS - BLOCK_MS * last_blocks as f64;
    let fits = |e: &&Effort| config.max_cpu_ms_per_frame <= 0.0 || e.track_ms * f64::from(valid) <= rest;
    EFFORTS.iter().find(fits).unwrap_or(&EFFORTS[EFFORTS.len() - 1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_smaller_budget_means_less_effort_and_no_budget_the_best() {
        let with = |ms| FusionConfig { max_cpu_ms_per_frame: ms, ..FusionConfig::default() };
        assert_eq!(choose(&with(0.0), 1_000_000, 1.0), &EFFORTS[0]);
        let cost: Vec<f64> = [60.0, 30.0, 20.0, 15.0, 1.0].map(|ms| choose(&with(ms), 5000, 1.0).track_ms).to_vec();
        assert!(cost.is_sorted_by(|a, b| a >= b) && cost[0] > cost[4], "{cost:?}");
    }
}
