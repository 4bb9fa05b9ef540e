//! Thresholds of the check of the distant-light assumption.

use crate::settings::section;

section! {
    /// Check of the distant-light assumption: do residuals depend on position at equal normals?
    DistanceCheckTuning = "distance_check" {
        /// Light is not distant if position explains at least this share of the residual variance on held-out vertices. Source: measured on the rendered scenes.
        explained_share: f64 = 0.2, [0.0..=1.0], "", "";
        /// Light is not distant only if position changes it by at least this much (standard deviation of its logarithm). Source: measured on the rendered scenes.
        changed_log: f64 = 0.08, [0.0..=10.0], "ln", "";
    }
}
