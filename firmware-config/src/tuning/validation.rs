//! Thresholds of the prediction of validation frames.

use crate::settings::section;

section! {
    /// Prediction of frames that no estimation step used.
    ValidationTuning = "validation" {
        /// Every n-th pixel of a frame is compared, along each side.
        pixel_stride: u32 = 2, [1..=64], "px", "";
        /// Rounds of gain and pose refinement.
        rounds: u32 = 2, [1..=50], "rounds", "";
    }
}
