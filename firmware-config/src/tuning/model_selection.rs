//! Thresholds of model selection.

use crate::settings::section;

section! {
    /// Selection of transfer, bands and rays by evidence from the scene.
    ModelSelectionTuning = "model_selection" {
        /// A level is better if its gain on held-out vertices exceeds this many standard errors of the gain.
        min_significance: f64 = 1.0, [0.0..=100.0], "σ", "";
        /// A level is better only if it lowers the held-out relative error by more. Source: a tenth of `color_error`.
        min_gain: f64 = 0.001, [0.0..=1.0], "", "";
        /// Levels without a gain after which no more bands are tried.
        patience: u32 = 2, [1..=9], "levels", "";
        /// Largest relative error of a vertex that is counted.
        max_error: f64 = 0.5, [0.01..=100.0], "", "";
        /// Vertices of the pilot that measures the share of blocked rays.
        pilot_vertices: u32 = 1024, [16..=1000000], "vertices", "";
        /// Rays per vertex of the pilot, and of the first transfer.
        pilot_rays: u32 = 64, [8..=65536], "rays", "";
        /// Error of the transfer that is allowed, as a share of the held-out error. Source: a sixteenth of the variance.
        transfer_error_share: f64 = 0.25, [0.001..=10.0], "", "";
        /// Largest number of rays per vertex that is chosen. Source: more bring nothing that shows, on rendered scenes and on the generated ones.
        max_rays: u32 = 128, [8..=65536], "rays", "N";
        /// Relative error of a lit colour, however often it was seen: visibility and bounces below it are not modelled. Source: measured on the rendered scenes.
        color_error: f64 = 0.01, [0.0..=1.0], "", "";
        /// A coefficient of the linear band is undetermined if its deviation exceeds this share of the mean light's coefficient.
        undetermined_share: f64 = 0.25, [0.0..=100.0], "", "";
    }
}
