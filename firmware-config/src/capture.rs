//! Settings of capture and replay.

use crate::settings::{Value, section};

/// Colour response of a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ResponseChoice {
    /// IEC 61966-2-1.
    Srgb,
    /// value = light.
    Linear,
    /// value = light^(1/gamma).
    Gamma(f64),
}

impl Value for ResponseChoice {
    type Range = ();
    fn from_toml(value: &toml::Value, (): &()) -> Result<Self, String> {
        match value.as_str() {
            Some("srgb") => Ok(Self::Srgb),
            Some("linear") => Ok(Self::Linear),
            other => other
                .and_then(|text| text.strip_prefix("gamma:")?.parse().ok())
                .filter(|gamma| (0.2..=5.0).contains(gamma))
                .map(Self::Gamma)
                .ok_or_else(|| format!("one of {}", Self::describe(&()))),
        }
    }
    fn to_toml(&self) -> String {
        match self {
            Self::Srgb => "\"srgb\"".into(),
            Self::Linear => "\"linear\"".into(),
            Self::Gamma(gamma) => format!("\"gamma:{gamma}\""),
        }
    }
    fn describe((): &()) -> String {
        "srgb, linear, gamma:x with x from 0.2 to 5".into()
    }
}

section! {
    /// Sources, pairing, device folder.
    CaptureConfig = "capture" {
        /// Largest time between the colour frame and the depth frame of a pair.
        max_pair_gap_ms: f64 = 20.0, [0.1..=500.0], "ms", "";
        /// Depth time stamp + this = colour time stamp of the same instant, for sources that do not specify it.
        depth_to_color_offset_ms: f64 = 0.0, [-500.0..=500.0], "ms", "";
        /// Colour response for sources that do not specify it.
        response: ResponseChoice = ResponseChoice::Srgb, [()], "", "";
    } with crate::tuning::CaptureTuning
}
