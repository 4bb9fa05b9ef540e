//! Undistortion by look-up: from pixels of the undistorted pinhole to positions in the image as read.

use crate::camera::pinhole::Pinhole;
use glam::Vec2;
use recordings::types::Distortion;

/// Look-up from undistorted pixels to positions in the distorted image.
#[derive(Debug, Clone)]
pub enum Undistort {
    /// The lens does not distort.
    None,
    /// `[pixel]`, row-major: position in the distorted image; (−1, −1) outside, never NaN.
    Map(Vec<Vec2>),
}

impl Undistort {
    /// The map of an image of `camera` (undistorted, possibly reduced).
    pub fn new(camera: &Pinhole, distortion: &Distortion) -> Self {
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
