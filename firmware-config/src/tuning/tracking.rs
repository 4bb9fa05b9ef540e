//! Thresholds of tracking.

use crate::settings::section;

section! {
    /// Frame-to-model tracking and relocalisation.
    TrackingTuning = "tracking" {
        /// Smallest share of the tracking grid that must hold valid depth for a frame to be tracked. Source: measured on recordings.
        min_valid_share: f64 = 0.03, [0.0..=1.0], "", "";
        /// Anchors tried per frame while tracking is lost. Source: measured on recordings.
        relocalisation_tries: u32 = 4, [1..=64], "anchors", "";
    }
}
