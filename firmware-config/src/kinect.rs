//! Settings of a live Kinect, and of its colour camera by serial number.

use crate::capture::ResponseChoice;
use crate::settings::{Value, section};

section! {
    /// The device.
    KinectConfig = "kinect" {
        /// Serial number of the Kinect to use; empty takes the first (`lumiscan list` shows them).
        serial: String = String::new(), [64], "", "";
        /// Bits of a depth pixel.
        depth_bits: u32 = 11, [10..=11], "bits", "";
        /// Colour with 1280×1024 pixels at about 10 frames a second instead of 640×480 at 30.
        color_sxga: bool = false, [()], "", "";
        /// Longest wait for the reply to one command, of three attempts.
        command_limit_ms: u32 = 1000, [50..=10000], "ms", "";
        /// Read the exposure register twice a second while streaming; a hint in status.json, nothing more.
        read_exposure: bool = false, [()], "", "";
        /// Accelerometer readings a second while streaming; 0 = none.
        accelerometer_hz: u32 = 5, [0..=50], "1/s", "";
        /// Silence of the streams after which they are started anew.
        silence_ms: u32 = 2000, [200..=60000], "ms", "";
    } with crate::tuning::KinectTuning
}

section! {
    /// The colour camera; a table `[camera.SERIAL]` overrides these for one device.
    CameraConfig = "camera" {
        /// Focal length along x at 640×480.
        fx: f64 = 525.0, [100.0..=2000.0], "px", "";
        /// Focal length along y.
        fy: f64 = 525.0, [100.0..=2000.0], "px", "";
        /// Principal point, x.
        cx: f64 = 319.5, [0.0..=640.0], "px", "";
        /// Principal point, y.
        cy: f64 = 239.5, [0.0..=480.0], "px", "";
        /// Radial distortion, r².
        k1: f64 = 0.0, [-10.0..=10.0], "", "";
        /// Radial distortion, r⁴.
        k2: f64 = 0.0, [-10.0..=10.0], "", "";
        /// Tangential distortion.
        p1: f64 = 0.0, [-1.0..=1.0], "", "";
        /// Tangential distortion.
        p2: f64 = 0.0, [-1.0..=1.0], "", "";
        /// Radial distortion, r⁶.
        k3: f64 = 0.0, [-10.0..=10.0], "", "";
        /// Depth stamp + this = colour time of the same instant.
        depth_to_color_offset_ms: f64 = 0.0, [-500.0..=500.0], "ms", "";
        /// How the camera turns light into values: srgb, linear, or gamma:x with value = light^(1/x).
        response: ResponseChoice = ResponseChoice::Srgb, [()], "", "";
    }
}

/// A response as the settings have it.
#[must_use]
pub fn response_text(response: ResponseChoice) -> String {
    response.to_toml().trim_matches('"').to_owned()
}
