//! Thresholds of the check of the distant-light assumption.

use crate::settings::section;

section! {
    /// Check of the distant-light assumption: do residuals depend on position at equal normals?
    DistanceCheckTuning = "distance_check" {
        /// Light is not distant if position explains at least this share of the residual variance on held-out vertices. Source: measured on the rendered scenes.
        explained_share: f64 = 0.2, [0.0..=1.0], "", "";
        /// Light is not distant only if position changes it by at least this much (standard deviation of its logarithm). Source: measured on the rendered scenes.
        changed_log: f64 = 0.08, [0.0..=10.0], "ln", "";
        /// Largest number of vertices looked at.
        max_vertices: u32 = 20000, [100..=10000000], "vertices", "";
        /// Segments with fewer fitted vertices are ignored.
        min_segment_vertices: u32 = 60, [20..=100000], "vertices", "";
        /// Log residuals are clamped to this.
        max_log_residual: f64 = 1.0, [0.01..=100.0], "ln", "";
        /// Vertices whose lit colour has a smaller weight are ignored.
        min_lit_weight: f64 = 0.2, [0.0..=10.0], "", "";
        /// Vertices with less irradiance than this share of the median are ignored.
        min_relative_light: f64 = 0.1, [0.0..=1.0], "", "";
    }
}
