//! The sensor's geometry as tracking and integration use it: undistorted pinholes and look-up maps.

use crate::pipeline::FusionError;
use crate::tsdf::integrate::MOST_PIXELS;
use firmware_config::FusionConfig;
use glam::{DVec3, Mat3, Vec2, Vec3};
use recordings::types::{CameraModel, Distortion, Pose, Sensor};

/// Largest image side that is accepted, in pixels.
const MAX_SIDE: u32 = 4096;

/// An undistorted pinhole camera; pixel centres stand at integers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pinhole {
    pub width: usize,
    pub height: usize,
    pub fx: f32,
    pub fy: f32,
    pub cx: f32,
    pub cy: f32,
}

impl Pinhole {
    fn new(camera: &CameraModel) -> Self {
        let k = &camera.intrinsics;
        Self {
            width: k.width as usize,
            height: k.height as usize,
            fx: k.fx as f32,
            fy: k.fy as f32,
            cx: k.cx as f32,
            cy: k.cy as f32,
        }
    }

    /// The camera of an image whose pixels are the means of `step × step` of ours (incomplete ones left out).
    pub fn reduced(&self, step: usize) -> Self {
        let s = 1.0 / step as f32;
        Self {
            width: (self.width / step).max(1),
            height: (self.height / step).max(1),
            fx: self.fx * s,
            fy: self.fy * s,
            cx: (self.cx + 0.5) * s - 0.5,
            cy: (self.cy + 0.5) * s - 0.5,
        }
    }

    /// Pixel of a point in camera coordinates, metres; the point must lie in front of the camera.
    #[inline(always)]
    pub fn project(&self, p: Vec3) -> Vec2 {
        let w = 1.0 / p.z;
        Vec2::new(self.fx * p.x * w + self.cx, self.fy * p.y * w + self.cy)
    }

    /// Direction of a pixel with z = 1.
    #[inline(always)]
    pub fn ray(&self, u: f32, v: f32) -> Vec3 {
        Vec3::new((u - self.cx) / self.fx, (v - self.cy) / self.fy, 1.0)
    }

    /// A pixel's row as a share of the image's height: −½ at the upper edge, ½ at the lower.
    #[inline(always)]
    pub fn row(&self, v: f32) -> f32 {
        (v + 0.5) / self.height as f32 - 0.5
    }

    /// Index of the pixel a point falls on, if it falls on one.
    #[inline(always)]
    pub fn pixel(&self, p: Vec3) -> Option<usize> {
        if p.z <= 1e-6 {
            return None;
        }
        let q = self.project(p) + 0.5;
        if q.x >= 0.0 && q.y >= 0.0 && q.x < self.width as f32 && q.y < self.height as f32 {
            Some(q.y as usize * self.width + q.x as usize)
        } else {
            None
        }
    }
}

/// A rigid transform in f32 for inner loops.
#[derive(Debug, Clone, Copy)]
pub struct Rigid {
    pub r: Mat3,
    pub t: Vec3,
}

impl From<&Pose> for Rigid {
    fn from(p: &Pose) -> Self {
        Self { r: Mat3::from_quat(p.rotation.as_quat()), t: p.translation.as_vec3() }
    }
}

impl Rigid {
    /// Transforms a point.
    #[inline(always)]
    pub fn apply(&self, p: Vec3) -> Vec3 {
        self.r * p + self.t
    }
}

/// Where to look up an undistorted pixel in the distorted image.
#[derive(Debug, Clone)]
pub enum Undistort {
    /// The lens does not distort.
    None,
    /// Per undistorted pixel: position in the distorted image; NaN-free, (−1, −1) outside.
    Map(Vec<Vec2>),
}

impl Undistort {
    /// The map for an image of `camera` (the undistorted pinhole, possibly reduced by `step`).
    fn new(camera: &Pinhole, distortion: &Distortion) -> Self {
        if *distortion == Distortion::default() {
            return Self::None;
        }
        let mut map = Vec::with_capacity(camera.width * camera.height);
        for v in 0..camera.height {
            for u in 0..camera.width {
                let ray = camera.ray(u as f32, v as f32);
                let d = distortion.distort(f64::from(ray.x), f64::from(ray.y));
                let q = Vec2::new(d.0 as f32 * camera.fx + camera.cx, d.1 as f32 * camera.fy + camera.cy);
                let inside =
                    q.x >= 0.0 && q.y >= 0.0 && q.x <= (camera.width - 1) as f32 && q.y <= (camera.height - 1) as f32;
                map.push(if inside { q } else { Vec2::splat(-1.0) });
            }
        }
        Self::Map(map)
    }
}

/// What the depth camera misreads, per pixel, from the configuration's radial polynomial.
#[derive(Debug, Clone)]
pub enum DepthCorrection {
    /// Nothing.
    None,
    /// Per pixel of the undistorted depth camera (a, b): z ← a z + b z².
    Map(Vec<Vec2>),
}

impl DepthCorrection {
    fn new(camera: &Pinhole, config: &FusionConfig) -> Self {
        let (linear, square) = (
            [config.depth_linear as f32, config.depth_linear_radial as f32],
            [config.depth_square as f32, config.depth_square_radial as f32],
        );
        if [linear, square] == [[0.0; 2]; 2] {
            return Self::None;
        }
        let pixel = |i: usize| {
            let ray = camera.ray((i % camera.width) as f32, (i / camera.width) as f32);
            let r2 = ray.x * ray.x + ray.y * ray.y;
            Vec2::new(1.0 + linear[0] + linear[1] * r2, square[0] + square[1] * r2)
        };
        Self::Map((0..camera.width * camera.height).map(pixel).collect())
    }
}

/// Number of grey pyramid levels.
pub const LEVELS: usize = 3;

/// Everything about the sensor that does not change during a scan.
#[derive(Debug, Clone)]
pub struct Rig {
    /// Grey pyramid cameras (undistorted colour), finest (≤ 320 pixels wide) first.
    pub grey: [Pinhole; LEVELS],
    /// Colour pixels per grey pixel of the finest level, along each side.
    pub grey_step: usize,
    /// Look-up of the finest grey level.
    pub grey_undistort: Undistort,
    /// The depth camera at full resolution, undistorted.
    pub depth: Pinhole,
    /// Look-up of the depth image, nearest pixel.
    pub depth_undistort: Undistort,
    /// What is added to the depths read.
    pub depth_correction: DepthCorrection,
    /// Depth pixels per sample of the tracking grid, along each side.
    pub grid_step: usize,
    /// The tracking grid's camera (≤ 160 samples wide).
    pub grid: Pinhole,
    pub color_from_depth: Pose,
    pub depth_from_color: Pose,
    pub depth_unit_m: f32,
    /// Depth stamp + this = the colour clock's time of the same instant, in nanoseconds.
    pub depth_to_color_offset_ns: i64,
    /// Pixels per row and rows of the colour image.
    pub color_size: (u32, u32),
}

impl Rig {
    /// Checks a sensor's description and precomputes its maps.
    pub fn new(sensor: &Sensor, config: &FusionConfig) -> Result<Self, FusionError> {
        check(&sensor.color, "colour")?;
        check(&sensor.depth, "depth")?;
        let k = &sensor.depth.intrinsics;
        if (k.width as usize + 2) * (k.height as usize + 2) > MOST_PIXELS {
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
            // Registered depth stands on the colour camera's own pixels, lens included.
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
            depth_unit_m: sensor.depth_unit_m as f32,
            depth_to_color_offset_ns: sensor.depth_to_color_offset_ns,
            color_size: (sensor.color.intrinsics.width, sensor.color.intrinsics.height),
        })
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

/// Standard deviation of the Kinect's depth at `z` metres (Nguyen, Izadi, Lovell 2012), in metres.
#[inline(always)]
pub fn depth_sigma(z: f32) -> f32 {
    let d = z - 0.4;
    0.0012 + 0.0019 * d * d
}

/// The world frame of a scan without gravity: the first camera's image-up is +Z, its view direction +Y.
pub fn world_from_first_camera() -> Pose {
    level_world(DVec3::NEG_Y)
}

/// The world frame in which `up` (in camera axes) is +Z and the camera looks towards +Y as far as it can.
pub fn level_world(up: DVec3) -> Pose {
    let z = up.normalize_or(DVec3::NEG_Y);
    // Looking straight up or down leaves no horizontal view direction: the image's up (or down) takes its place.
    let forward = [DVec3::Z, DVec3::NEG_Y].into_iter().map(|f| f - z * z.dot(f)).find(|f| f.length() > 0.1);
    let y = forward.unwrap_or(DVec3::X).normalize();
    let x = y.cross(z);
    let rows = [[x.x, x.y, x.z, 0.0], [y.x, y.y, y.z, 0.0], [z.x, z.y, z.z, 0.0], [0.0, 0.0, 0.0, 1.0]];
    Pose::from_rows(&rows).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_camera_stands_upright() {
        let w = world_from_first_camera();
        assert!((w.transform(DVec3::NEG_Y) - DVec3::Z).length() < 1e-12);
        assert!((w.transform(DVec3::Z) - DVec3::Y).length() < 1e-12);
        assert!((w.transform(DVec3::X) - DVec3::X).length() < 1e-12);
    }

    #[test]
    fn gravity_is_levelled_also_looking_down() {
        for up in [DVec3::new(0.1, -0.9, -0.4), DVec3::NEG_Z, DVec3::Z] {
            let w = level_world(up);
            assert!((w.transform(up.normalize()) - DVec3::Z).length() < 1e-9, "{up}");
        }
    }
}
