//! Settings of a live Kinect, and of its colour camera by serial number.

use crate::capture::ResponseChoice;
use crate::settings::{Value, section};

section! {
    /// The device.
    KinectConfig = "kinect" {
        /// Serial number of the Kinect to use (`lumiscan list` shows it); empty = the first one found.
        serial: String = String::new(), [64], "", "";
        /// Bits per depth pixel.
        depth_bits: u32 = 11, [10..=11], "bits", "";
        /// Colour images of 1280×1024 pixels at about 10 frames per second instead of 640×480 at 30.
        color_sxga: bool = false, [()], "", "";
        /// Timeout of a command; a command is tried three times.
        command_limit_ms: u32 = 1000, [50..=10000], "ms", "";
        /// Read the exposure register twice per second while streaming; the value appears in status.json only.
        read_exposure: bool = false, [()], "", "";
        /// Accelerometer readings per second while streaming; 0 = none.
        accelerometer_hz: u32 = 5, [0..=50], "1/s", "";
        /// Streams without data for this time are restarted.
        silence_ms: u32 = 2000, [200..=60000], "ms", "";
    } with crate::tuning::KinectTuning
}

section! {
    /// The colour camera; a table `[camera.SERIAL]` overrides these values for one device.
    CameraConfig = "camera" {
        /// Focal length along x at 640×480.
        fx: f64 = 525.0, [100.0..=2000.0], "px", "";
        /// Focal length along y at 640×480.
        fy: f64 = 525.0, [100.0..=2000.0], "px", "";
        /// Principal point along x at 640×480.
        cx: f64 = 319.5, [0.0..=640.0], "px", "";
        /// Principal point along y at 640×480.
        cy: f64 = 239.5, [0.0..=480.0], "px", "";
        /// Radial distortion, coefficient of r² (Brown–Conrady).
        k1: f64 = 0.0, [-10.0..=10.0], "", "";
        /// Radial distortion, coefficient of r⁴.
        k2: f64 = 0.0, [-10.0..=10.0], "", "";
        /// Tangential distortion, first coefficient.
        p1: f64 = 0.0, [-1.0..=1.0], "", "";
        /// Tangential distortion, second coefficient.
        p2: f64 = 0.0, [-1.0..=1.0], "", "";
        /// Radial distortion, coefficient of r⁶.
        k3: f64 = 0.0, [-10.0..=10.0], "", "";
        /// Depth time stamp + this = colour time stamp of the same instant.
        depth_to_color_offset_ms: f64 = 0.0, [-500.0..=500.0], "ms", "";
        /// Response of the camera: srgb, linear, or gamma:x with value = light^(1/x).
        response: ResponseChoice = ResponseChoice::Srgb, [()], "", "";
    }
}

/// A response as text, in the form of the settings.
#[must_use]
pub fn response_text(response: ResponseChoice) -> String {
    response.to_toml().trim_matches('"').to_owned()
}
