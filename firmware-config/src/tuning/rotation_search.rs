//! Thresholds of the search for fast turns.

use crate::settings::section;

section! {
    /// Rotation from image to image, for fast turns.
    RotationSearchTuning = "rotation_search" {
        /// Largest image shift searched, as a share of the image width. Source: tuned by hand on recordings.
        max_shift_share: f64 = 0.3, [0.0..=0.9], "", "";
        /// The residual must fall below this share of the prediction's residual. Source: tuned by hand on recordings.
        max_residual_ratio: f64 = 0.95, [0.0..=1.0], "", "";
        /// The residual must fall by this much: on a bare wall all rotations fit equally well up to noise. Source: noise of the coarsest grey level.
        min_residual_drop: f64 = 0.5, [0.0..=64.0], "grey", "";
    }
}
