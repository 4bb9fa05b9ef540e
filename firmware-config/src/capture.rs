//! Settings of capture and replay.

use crate::settings::{choices, section};

choices! {
    /// Colour response assumed where the recording does not state one.
    ResponseChoice {
        /// IEC 61966-2-1.
        Srgb = "srgb",
        /// Proportional.
        Linear = "linear",
    }
}

section! {
    /// Sources, pairing, device folder.
    CaptureConfig = "capture" {
        /// Largest time between the colour and depth frame of a pair.
        max_pair_gap_ms: f64 = 20.0, [0.1..=500.0], "ms", "";
        /// Depth stamp + this = colour time of the same instant, for sources that do not say.
        depth_to_color_offset_ms: f64 = 0.0, [-500.0..=500.0], "ms", "";
        /// Colour response for sources that do not say.
        response: ResponseChoice = ResponseChoice::Srgb, [()], "", "";
    }
}
