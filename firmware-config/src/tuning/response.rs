//! Thresholds of the test of the camera's response.

use crate::settings::section;

section! {
    /// Test of the camera's response.
    ResponseTuning = "response" {
        /// Smallest ratio of the exposures that are compared. Source: smaller ratios do not separate responses.
        min_exposure_ratio: f64 = 1.5, [1.0..=1000.0], "", "";
        /// Smallest number of points that two keyframes must share. Source: measured on the rendered scenes.
        min_shared: u32 = 200, [1..=1000000], "points", "";
        /// Levels from dark to bright at which the factor between two exposures is measured. Source: measured on the rendered scenes.
        levels: u32 = 6, [2..=64], "levels", "";
        /// Smallest encoded value that is compared: darker ones are noise. Source: measured on the rendered scenes.
        min_value: f64 = 0.06, [0.0..=1.0], "", "";
        /// Encoded value below which values are compared: brighter ones are nearly clipped. Source: measured on the rendered scenes.
        max_value: f64 = 0.95, [0.0..=1.0], "", "";
        /// Largest change of the factor from dark to bright that may be chance. Source: measured on the rendered scenes.
        max_change: f64 = 0.03, [0.0..=1.0], "", "";
        /// Another response fits better if its factor changes less by this ratio. Source: measured on the rendered scenes.
        clear_ratio: f64 = 2.0, [1.0..=100.0], "", "";
    }
}
