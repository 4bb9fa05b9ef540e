//! CPU budget of tracking: the choice of a schedule.
//!
//! The budget is kept by counting work, not by reading a clock, so that a replay gives the same bits on any machine.

use crate::tracking::schedule::{Stage, reference, volume};
use firmware_config::FusionConfig;

/// The schedules by which a frame is tracked.
#[derive(Debug, PartialEq)]
pub struct Effort {
    /// Frame to frame: coarse, wide.
    pub coarse: &'static [Stage],
    /// Frame to anchor and model: fine.
    pub fine: &'static [Stage],
}

/// From the best to the cheapest.
static EFFORTS: [Effort; 3] = [
    Effort {
        coarse: &[reference(2, 3, 12.0), reference(1, 1, 6.0)],
        fine: &[volume(1, 2, 1, 6.0), volume(0, 1, 3, 4.0)],
    },
    Effort { coarse: &[reference(2, 3, 12.0)], fine: &[volume(1, 3, 2, 6.0), volume(0, 3, 1, 4.0)] },
    Effort { coarse: &[reference(2, 2, 12.0)], fine: &[volume(1, 6, 2, 5.0)] },
];

/// Frame to anchor while lost: coarse, with a wider basin.
pub static RELOCALISE: [Stage; 2] = [reference(2, 8, 20.0), reference(1, 4, 8.0)];

/// The best effort.
pub fn best() -> &'static Effort {
    &EFFORTS[0]
}

/// The best effort that fits `fusion.max_cpu_ms_per_frame` beside the integration of `last_blocks` blocks; the cheapest one
/// if none fits. `valid` is the share of the tracking grid with depth.
pub fn choose(config: &FusionConfig, last_blocks: usize, valid: f32) -> &'static Effort {
    let (budget_ms, cost) = (config.max_cpu_ms_per_frame, &config.tuning.tracking_effort);
    let rest_ms = budget_ms - cost.fixed_ms - cost.block_ms * last_blocks as f64;
    let fits = |track_ms: f64| budget_ms <= 0.0 || track_ms * f64::from(valid) <= rest_ms;
    let [full, reduced, cheapest] = &EFFORTS;
    if fits(cost.full_ms) {
        full
    } else if fits(cost.reduced_ms) {
        reduced
    } else {
        cheapest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_smaller_budget_means_less_effort_and_no_budget_the_best() {
        let with = |ms| FusionConfig { max_cpu_ms_per_frame: ms, ..FusionConfig::default() };
        assert_eq!(choose(&with(0.0), 1_000_000, 1.0), &EFFORTS[0]);
        let rank = |ms| EFFORTS.iter().position(|e| e == choose(&with(ms), 5000, 1.0)).unwrap();
        assert_eq!([60.0, 30.0, 20.0, 15.0, 1.0].map(rank), [0, 0, 2, 2, 2]);
        assert_eq!(choose(&with(24.0), 5000, 1.0), &EFFORTS[1]);
    }
}
