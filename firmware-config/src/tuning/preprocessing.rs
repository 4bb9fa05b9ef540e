//! Thresholds of depth preprocessing.

use crate::settings::section;

section! {
    /// Depth preprocessing: grazing and flying pixels, tracking grid.
    PreprocessingTuning = "preprocessing" {
        /// Standard deviations of depth added to what `fusion.max_slope` lets two neighbours differ by. Source: noise of neighbours is alike.
        slope_sigmas: f64 = 1.5, [0.0..=100.0], "σ", "";
        /// Depths of a grid cell within this many standard deviations of its centre lie on the same surface. Source: 3 σ.
        cell_sigmas: f64 = 3.0, [0.0..=100.0], "σ", "";
        /// Grid neighbours farther apart than this share of their depth lie on different surfaces. Source: tuned by hand on recordings.
        max_depth_jump_share: f64 = 0.05, [0.0..=1.0], "", "";
        /// Smallest cosine between the normal and the direction to the camera of a grid point. Source: tuned by hand on recordings.
        min_normal_cos: f64 = 0.15, [0.0..=1.0], "", "";
    }
}
