//! The sensor as tracking and integration use it: undistorted pinholes, look-up maps, transforms, depth noise.

use crate::camera::depth_correction::DepthCorrection;
use crate::camera::lens::Undistort;
use crate::camera::pinhole::Pinhole;
use crate::error::FusionError;
use firmware_config::FusionConfig;
use firmware_config::tuning::DepthNoise;
use recordings::types::{CameraModel, Pose, RgbdFrame, Sensor};

/// Largest accepted image side, in pixels.
const MAX_SIDE: u32 = 4096;
/// Largest number of pixels of a depth image with a border of one pixel: their indices stay exact in an f32 added to 2²³.
pub const MAX_DEPTH_PIXELS: usize = 1 << 23;

/// Number of grey pyramid levels.
pub const LEVELS: usize = 3;

/// Everything about the sensor that stays the same during a scan.
#[derive(Debug, Clone)]
pub struct Rig {
    /// Grey pyramid cameras (undistorted colour), finest (≤ 320 pixels wide) first.
    pub grey: [Pinhole; LEVELS],
    /// Colour pixels per grey pixel of the finest level, along each side.
    pub grey_step: usize,
    /// Undistortion of the finest grey level.
    pub grey_undistort: Undistort,
    /// The depth camera at full resolution, undistorted.
    pub depth: Pinhole,
    /// Undistortion of the depth image, nearest pixel.
    pub depth_undistort: Undistort,
    /// Correction of systematic depth error.
    pub depth_correction: DepthCorrection,
    /// Depth pixels per sample of the tracking grid, along each side.
    pub grid_step: usize,
    /// The tracking grid's camera (≤ 160 samples wide).
    pub grid: Pinhole,
    pub color_from_depth: Pose,
    pub depth_from_color: Pose,
    /// Noise of the depth camera.
    pub noise: DepthNoise,
    /// Row shift by motion, in pixels, below which all rows count as simultaneous.
    pub min_row_shift_px: f64,
    pub depth_unit_m: f32,
    /// Depth time stamp + this = time of the same instant on the colour clock, nanoseconds.
    pub depth_to_color_offset_ns: i64,
    /// Width and height of the colour image, pixels.
    pub color_size: (u32, u32),
}

impl Rig {
    /// Checks a sensor's description and precomputes its look-up maps.
    ///
    /// # Errors
    /// The description is not usable.
    pub fn new(sensor: &Sensor, config: &FusionConfig) -> Result<Self, FusionError> {
        check(&sensor.color, "colour")?;
        check(&sensor.depth, "depth")?;
        let k = &sensor.depth.intrinsics;
        if (k.width as usize + 2) * (k.height as usize + 2) > MAX_DEPTH_PIXELS {
            return Err(FusionError::BadSensor(format!("a depth image of {} × {} pixels", k.width, k.height)));
        }
        if !(sensor.depth_unit_m.is_finite() && sensor.depth_unit_m > 1e-7 && sensor.depth_unit_m < 1.0) {
            return Err(FusionError::BadSensor(format!("depth unit of {} m", sensor.depth_unit_m)));
        }
        let extrinsic = sensor.color_from_depth;
        if !extrinsic.is_finite() || extrinsic.translation.length() > 1.0 || extrinsic.rotation.length() < 1e-6 {
            return Err(FusionError::BadSensor("transform from depth to colour camera".into()));
        }
        let color = Pinhole::new(&sensor.color);
        let grey_step = color.width.div_ceil(320).max(1);
        let depth = Pinhole::new(&sensor.depth);
        let grid_step = depth.width.div_ceil(160).max(1);
        let grey0 = color.reduced(grey_step);
        let color_from_depth =
            if sensor.depth_registered { Pose::IDENTITY } else { Pose::new(extrinsic.rotation, extrinsic.translation) };
        Ok(Self {
            grey: [grey0, grey0.reduced(2), grey0.reduced(4)],
            grey_step,
            grey_undistort: Undistort::new(&grey0, &sensor.color.distortion),
            depth,
            // Registered depth has the colour camera's pixels, lens distortion included.
            depth_undistort: if sensor.depth_registered && (color.width, color.height) == (depth.width, depth.height) {
                Undistort::new(&depth, &sensor.color.distortion)
            } else {
                Undistort::new(&depth, &sensor.depth.distortion)
            },
            depth_correction: DepthCorrection::new(&depth, config),
            grid_step,
            grid: depth.reduced(grid_step),
            color_from_depth,
            depth_from_color: color_from_depth.inverse(),
            noise: config.tuning.depth_noise.model(),
            min_row_shift_px: config.tuning.timing.min_row_shift_px,
            depth_unit_m: sensor.depth_unit_m as f32,
            depth_to_color_offset_ns: sensor.depth_to_color_offset_ns,
            color_size: (sensor.color.intrinsics.width, sensor.color.intrinsics.height),
        })
    }
    /// Checks that a frame has the sensor's image sizes.
    ///
    /// # Errors
    /// A size differs.
    pub fn check_frame(&self, frame: &RgbdFrame) -> Result<(), FusionError> {
        let depth = (self.depth.width, self.depth.height);
        let (d, c) = (&frame.depth, &frame.rgb);
        if (d.width as usize, d.height as usize) != depth || d.depth.len() != depth.0 * depth.1 {
            let text = format!("a depth frame of {} × {}, not {} × {}", d.width, d.height, depth.0, depth.1);
            return Err(FusionError::BadFrame(text));
        }
        let color = self.color_size;
        if (c.width, c.height) != color || c.data.len() != 3 * color.0 as usize * color.1 as usize {
            let text = format!("a colour frame of {} × {}, not {} × {}", c.width, c.height, color.0, color.1);
            return Err(FusionError::BadFrame(text));
        }
        Ok(())
    }
}

fn check(camera: &CameraModel, name: &str) -> Result<(), FusionError> {
    let k = &camera.intrinsics;
    let bad = |what: String| Err(FusionError::BadSensor(format!("{name} camera: {what}")));
    if k.width == 0 || k.height == 0 || k.width > MAX_SIDE || k.height > MAX_SIDE {
        return bad(format!("an image of {} × {} pixels", k.width, k.height));
    }
    for f in [k.fx, k.fy] {
        if !(f.is_finite() && f > 0.05 * f64::from(k.width.max(k.height)) && f < 1e5) {
            return bad(format!("a focal length of {f} pixels"));
        }
    }
    for (c, size) in [(k.cx, k.width), (k.cy, k.height)] {
        if !(c.is_finite() && c > -f64::from(size) && c < 2.0 * f64::from(size)) {
            return bad(format!("a principal point at {c} pixels"));
        }
    }
    let d = &camera.distortion;
    if [d.k1, d.k2, d.p1, d.p2, d.k3].iter().any(|x| !x.is_finite() || x.abs() > 100.0) {
        return bad("distortion coefficients".into());
    }
    Ok(())
}
