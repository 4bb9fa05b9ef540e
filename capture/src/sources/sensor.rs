//! The Kinect that a command uses, and its description in recordings and scans.

use crate::failure::Failure;
use crate::kinect::driver::Kinect;
use crate::kinect::protocol::KinectError;
use crate::kinect::transport::{Bus, UsbError};
use crate::kinect::usb::UsbBus;
use crate::simulator::bus::SimBus;
use crate::simulator::plan::SimPlan;
use firmware_config::kinect_models::StreamFormat;
use firmware_config::{CameraConfig, Config, ResponseChoice};
use recordings::types::{CameraModel, Distortion, Intrinsics, Pose, Response, Sensor};

/// The machine's USB, or a simulated one.
///
/// # Errors
/// The plan of the simulation is invalid.
pub fn bus(simulate: Option<&String>) -> Result<Box<dyn Bus>, Failure> {
    match simulate {
        None => Ok(Box::new(UsbBus::default())),
        Some(text) => {
            let plan = SimPlan::parse(text).map_err(|e| Failure::Usage(format!("--simulate {text}: {e}")))?;
            Ok(Box::new(SimBus::new(plan)))
        }
    }
}

/// The failure of a command whose Kinect is missing or unusable.
pub fn failure(e: impl Into<KinectError>) -> Failure {
    Failure::Input(e.into().to_string())
}

/// The description of an opened Kinect.
#[must_use]
pub fn describe(kinect: &Kinect, config: &Config) -> Sensor {
    let found = kinect.found();
    let (camera, _) = config.camera_of(&found.serial);
    let color = color_camera(camera, kinect.color_format());
    Sensor {
        name: found.model.name().into(),
        serial: found.serial.clone(),
        color,
        // Registered depth has the colour camera's pixels at 640×480.
        depth: CameraModel { distortion: Distortion::default(), ..color_camera(camera, kinect.depth_format()) },
        color_from_depth: Pose::IDENTITY,
        depth_registered: true,
        depth_unit_m: 0.001,
        response: response(camera.response),
        depth_to_color_offset_ns: (camera.depth_to_color_offset_ms * 1e6).round() as i64,
    }
}

/// The setting in the form that recordings store.
#[must_use]
pub fn response(choice: ResponseChoice) -> Response {
    match choice {
        ResponseChoice::Srgb => Response::Srgb,
        ResponseChoice::Linear => Response::Linear,
        ResponseChoice::Gamma(gamma) => Response::Gamma(gamma),
    }
}

/// The settings are for 640×480. Larger images show the same columns, with more rows around the same centre.
fn color_camera(camera: &CameraConfig, format: &StreamFormat) -> CameraModel {
    let scale = f64::from(format.width) / 640.0;
    let margin = (f64::from(format.height) - 480.0 * scale) / 2.0;
    CameraModel {
        intrinsics: Intrinsics {
            width: format.width,
            height: format.height,
            fx: camera.fx * scale,
            fy: camera.fy * scale,
            // Pixel centres are at integer coordinates.
            cx: (camera.cx + 0.5) * scale - 0.5,
            cy: (camera.cy + 0.5) * scale - 0.5 + margin,
        },
        distortion: Distortion { k1: camera.k1, k2: camera.k2, p1: camera.p1, p2: camera.p2, k3: camera.k3 },
    }
}

impl From<UsbError> for Failure {
    fn from(e: UsbError) -> Self {
        failure(e)
    }
}
