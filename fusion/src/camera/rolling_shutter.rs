//! Rolling shutter: images are read out row by row while the camera moves.
//!
//! A pose belongs to the instant of the colour image's middle row. Rows are numbered s = −½ (first) … ½ (last).

use crate::camera::pinhole::Pinhole;
use crate::camera::rig::Rig;
use crate::camera::twist::exp;
use glam::{DVec3, Vec2, Vec3};
use nalgebra::Vector6;
use recordings::types::Pose;

/// Motion of the camera while a frame is taken.
#[derive(Debug, Clone, Copy, Default)]
pub struct Motion {
    /// Twist (translation in metres, rotation in radians) per second, axes of the colour camera.
    pub velocity: Vector6<f64>,
    /// Time from the middle of the depth image's read-out to the middle of the colour image's read-out, seconds.
    pub gap_s: f64,
    /// Time from the first row of an image to its last row, seconds.
    pub readout_s: f64,
}

impl Motion {
    /// Transform of the colour camera from the instant of a depth row to the instant of the pose.
    pub fn color_from_row(&self, row: f64) -> Pose {
        exp(&(self.velocity * (row * self.readout_s - self.gap_s)))
    }

    /// Speed of points at `depth_m`, metres per second: translation plus rotation.
    pub fn speed(&self, depth_m: f32) -> f64 {
        let (v, w) = parts(&self.velocity);
        v.length() + w.length() * f64::from(depth_m)
    }

    /// The rolling shutter of the depth camera.
    pub fn of_depth(&self, rig: &Rig) -> RollingShutter {
        let back = rig.depth_from_color.rotation;
        let (v, w) = parts(&self.velocity);
        let at = rig.color_from_depth.translation;
        RollingShutter::new(back * (v + w.cross(at)), back * w, self.readout_s, &rig.depth, rig.min_row_shift_px)
    }

    /// The rolling shutter of the colour camera.
    pub fn of_color(&self, rig: &Rig) -> RollingShutter {
        let (v, w) = parts(&self.velocity);
        RollingShutter::new(v, w, self.readout_s, &rig.grey[0], rig.min_row_shift_px)
    }
}

fn parts(twist: &Vector6<f64>) -> (DVec3, DVec3) {
    (DVec3::new(twist[0], twist[1], twist[2]), DVec3::new(twist[3], twist[4], twist[5]))
}

/// Motion of a camera from its first row to its last row, in its axes at the middle row; zero if the image does not show it
/// (`timing.min_row_shift_px`).
#[derive(Debug, Clone, Copy)]
pub struct RollingShutter {
    /// Translation, metres.
    pub translation: Vec3,
    /// Rotation vector, radians.
    pub rotation: Vec3,
}

impl RollingShutter {
    fn new(velocity: DVec3, turn: DVec3, readout_s: f64, camera: &Pinhole, min_row_shift_px: f64) -> Self {
        // Of points at 1 m, between the middle row and the last row.
        let shift = 0.5 * readout_s * f64::from(camera.fx) * (velocity.length() + turn.length());
        let shows = if shift.abs() < min_row_shift_px { 0.0 } else { readout_s };
        Self { translation: (velocity * shows).as_vec3(), rotation: (turn * shows).as_vec3() }
    }

    /// True if all rows count as simultaneous.
    pub fn is_still(&self) -> bool {
        self.translation == Vec3::ZERO && self.rotation == Vec3::ZERO
    }

    /// Motion of the camera relative to a point, from the first row to the last row: row s sees the point at p − s · shift.
    #[inline(always)]
    pub fn shift(&self, p: Vec3) -> Vec3 {
        self.translation + self.rotation.cross(p)
    }

    /// Transform of the camera from the instant of a row to the instant of the middle row.
    pub fn middle_from_row(&self, row: f32) -> Pose {
        let [translation, rotation] = [self.translation, self.rotation].map(|d| (d * row).as_dvec3());
        Pose::exp(rotation, translation)
    }

    /// The point as its own row sees it, and its pixel there; the point must lie in front of the camera.
    #[inline(always)]
    pub fn project(&self, camera: &Pinhole, p: Vec3) -> (Vec3, Vec2) {
        if self.is_still() {
            return (p, camera.project(p));
        }
        // The pixel row y depends on the instant s = a y + b. With s of the point without motion in the small z term, the
        // equation is linear in y.
        let a = 1.0 / camera.height as f32;
        let b = 0.5 * a - 0.5;
        let shift = self.shift(p);
        let (y, dy) = (camera.fy * p.y + camera.cy * p.z, camera.fy * shift.y + camera.cy * shift.z);
        let row = (y - b * dy) / (p.z - (a * y / p.z + b) * shift.z + a * dy);
        let seen = p - shift * (a * row + b).clamp(-0.6, 0.6);
        (seen, camera.project(seen))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The pixel of a point in a moving camera lies in the row that sees the point there.
    #[test]
    fn a_point_is_seen_when_its_row_is_read() {
        let camera = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };
        let (velocity, turn) = (DVec3::new(0.4, -0.6, 0.3), DVec3::new(2.0, -1.0, 1.5));
        let shutter = RollingShutter::new(velocity, turn, 0.03, &camera, 0.2);
        assert!(
            !shutter.is_still() && RollingShutter::new(velocity * 0.01, turn * 0.01, 0.03, &camera, 0.2).is_still()
        );
        for i in 0..200 {
            let q = Vec2::new((i * 37 % 320) as f32, (i * 91 % 240) as f32);
            let p = camera.ray(q.x, q.y) * (0.5 + 0.02 * i as f32);
            let (seen, pixel) = shutter.project(&camera, p);
            let row = camera.row(pixel.y);
            let expected = shutter.middle_from_row(row).inverse().transform(p.as_dvec3()).as_vec3();
            assert!((pixel - camera.project(seen)).length() < 1e-3);
            // Up to the second order of a rotation by 2.6° in half a read-out.
            assert!((pixel - camera.project(expected)).length() < 0.5, "{pixel} {}", camera.project(expected));
        }
    }
}
