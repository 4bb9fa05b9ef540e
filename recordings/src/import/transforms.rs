//! Cameras in the `transforms.json` convention of NeRF.
//!
//! NeRF's camera looks along −Z with +Y up (OpenGL); pixel centres stand at integer coordinates, so that the middle of
//! a picture 640 pixels wide is `cx = 319.5`.

use crate::error::{Error, Result};
use crate::import::lists::read_text;
use crate::types::{CameraModel, Distortion, Intrinsics, Pose};
use serde::Deserialize;
use std::path::Path;

/// What a user can do about a bad file.
pub(crate) const REMEDY: &str = "see the NeRF convention of transforms.json";

/// Intrinsics, for all frames or for one.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
struct Lens {
    w: Option<f64>,
    h: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

/// A camera with its pose.
#[derive(Debug, Deserialize)]
pub struct Frame {
    /// Its picture, relative to the file; empty if there is none.
    #[serde(default)]
    pub file_path: String,
    transform_matrix: Vec<Vec<f64>>,
    /// Time of the picture in seconds.
    pub time_s: Option<f64>,
    #[serde(flatten)]
    lens: Lens,
}

/// The file.
#[derive(Debug, Deserialize)]
pub struct Transforms {
    camera_model: Option<String>,
    /// Cameras in the order of the file.
    pub frames: Vec<Frame>,
    #[serde(flatten)]
    lens: Lens,
}

impl Transforms {
    /// Reads a file.
    ///
    /// # Errors
    /// Unreadable, not in the convention, or with a camera model that is not supported.
    pub fn read(path: &Path) -> Result<Self> {
        let invalid = |problem: String| Error::invalid(path, problem, REMEDY);
        let transforms: Self = serde_json::from_str(&read_text(path)?).map_err(|e| invalid(e.to_string()))?;
        if let Some(model) = &transforms.camera_model
            && model.to_ascii_lowercase().contains("fisheye")
        {
            return Err(invalid(format!("camera model {model} is not supported: undistort the pictures first")));
        }
        Ok(transforms)
    }

    /// Width and height in pixels that the file gives for a frame.
    #[must_use]
    pub fn size(&self, frame: &Frame) -> Option<(f64, f64)> {
        frame.lens.w.or(self.lens.w).zip(frame.lens.h.or(self.lens.h))
    }

    /// The camera of a frame of `width` × `height` pixels: its own values, else those for all frames, else what size and
    /// field of view give.
    ///
    /// # Errors
    /// The size differs from the file's, there is no focal length, or the camera is not usable.
    pub fn camera(&self, frame: &Frame, width: u32, height: u32) -> std::result::Result<CameraModel, String> {
        let value = |of: fn(&Lens) -> Option<f64>| of(&frame.lens).or(of(&self.lens));
        for (given, actual, what) in [(value(|l| l.w), width, "wide"), (value(|l| l.h), height, "high")] {
            if let Some(given) = given
                && given != f64::from(actual)
            {
                return Err(format!("the picture is {actual} pixels {what}, the intrinsics are for {given}"));
            }
        }
        let from_angle = |angle: f64, side: u32| 0.5 * f64::from(side) / libm::tan(0.5 * angle);
        let fx = value(|l| l.fl_x).or(value(|l| l.camera_angle_x).map(|a| from_angle(a, width)));
        let fx = fx.ok_or("neither fl_x nor camera_angle_x is given")?;
        let fy = value(|l| l.fl_y).or(value(|l| l.camera_angle_y).map(|a| from_angle(a, height))).unwrap_or(fx);
        let center = |side: u32| (f64::from(side) - 1.0) / 2.0;
        let (cx, cy) = (value(|l| l.cx).unwrap_or(center(width)), value(|l| l.cy).unwrap_or(center(height)));
        let coefficient = |of: fn(&Lens) -> Option<f64>| value(of).unwrap_or(0.0);
        if coefficient(|l| l.k4) != 0.0 {
            return Err("k4 is not supported: undistort the pictures first".into());
        }
        let camera = CameraModel {
            intrinsics: Intrinsics { width, height, fx, fy, cx, cy },
            distortion: Distortion {
                k1: coefficient(|l| l.k1),
                k2: coefficient(|l| l.k2),
                p1: coefficient(|l| l.p1),
                p2: coefficient(|l| l.p2),
                k3: coefficient(|l| l.k3),
            },
        };
        camera.problem().map_or(Ok(camera), |problem| Err(problem.into()))
    }
}

impl Frame {
    /// The pose, camera-to-world with OpenCV axes.
    ///
    /// # Errors
    /// The matrix is not a rigid transform.
    pub fn pose(&self) -> std::result::Result<Pose, String> {
        let rows = &self.transform_matrix;
        let mut m = [[0.0, 0.0, 0.0, 1.0]; 4];
        let whole = (3..=4).contains(&rows.len()) && rows.iter().all(|r| r.len() == 4);
        for (to, from) in m.iter_mut().zip(rows).filter(|_| whole) {
            // The camera's y and z axes are the matrix's second and third columns.
            *to = [from[0], -from[1], -from[2], from[3]];
        }
        let last = rows.get(3).is_none_or(|r| r.iter().zip([0.0, 0.0, 0.0, 1.0]).all(|(a, b)| (a - b).abs() < 1e-6));
        let pose = Pose::from_rows(&m).filter(|_| whole && last);
        pose.ok_or_else(|| "transform_matrix is no rigid 4x4 camera-to-world transform".into())
    }
}
