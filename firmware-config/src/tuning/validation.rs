//! Thresholds of the prediction of validation frames.

use crate::settings::section;

section! {
    /// Prediction of frames that no estimation step used.
    ValidationTuning = "validation" {
        /// Every n-th pixel of a frame is compared, along each side.
        pixel_stride: u32 = 2, [1..=64], "px", "";
        /// Rounds of gain and pose refinement.
        rounds: u32 = 2, [1..=50], "rounds", "";
        /// Samples along each side of a pixel that is predicted: pixels on outlines show both sides.
        supersampling: u32 = 1, [1..=8], "samples", "";
    }
}
