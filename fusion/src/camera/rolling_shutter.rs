//! Images are read out row by row while the camera moves: when each row was seen, and from where.
//!
//! A pose stands for the instant of the colour image's middle row. Rows are numbered −½ (first) … ½ (last).

use crate::camera::rig::{Pinhole, Rig};
use crate::tracking::align::exp;
use glam::{DVec3, Vec2, Vec3};
use nalgebra::Vector6;
use recordings::types::Pose;

/// Shift by the motion between the middle row and the last, in pixels, under which all rows count as seen at once.
const NOTICEABLE_PX: f64 = 0.2;

/// How the camera moves while it takes a frame.
#[derive(Debug, Clone, Copy, Default)]
pub struct Motion {
    /// Twist (translation, rotation) per second, axes of the colour camera.
    pub velocity: Vector6<f64>,
    /// From the middle of the depth image's read-out to that of the colour image's, seconds.
    pub gap_s: f64,
    /// From the first row of an image to its last, seconds.
    pub readout_s: f64,
}

impl Motion {
    /// Takes a point from the colour camera at the instant of a row of depth to the same camera at the pose's instant.
    pub fn color_from_row(&self, row: f64) -> Pose {
        exp(&(self.velocity * (row * self.readout_s - self.gap_s)))
    }

    /// Metres per second, turns taken at so many metres.
    pub fn speed(&self, depth_m: f32) -> f64 {
        let (v, w) = parts(&self.velocity);
        v.length() + w.length() * f64::from(depth_m)
    }

    /// How the depth camera moves while it is read out.
    pub fn of_depth(&self, rig: &Rig) -> Sweep {
        let back = rig.depth_from_color.rotation;
        let (v, w) = parts(&self.velocity);
        let at = rig.color_from_depth.translation;
        Sweep::new(back * (v + w.cross(at)), back * w, self.readout_s, &rig.depth)
    }

    /// How the colour camera moves while it is read out.
    pub fn of_color(&self, rig: &Rig) -> Sweep {
        let (v, w) = parts(&self.velocity);
        Sweep::new(v, w, self.readout_s, &rig.grey[0])
    }
}

fn parts(twist: &Vector6<f64>) -> (DVec3, DVec3) {
    (DVec3::new(twist[0], twist[1], twist[2]), DVec3::new(twist[3], twist[4], twist[5]))
}

/// What a camera goes through from its first row to its last: axes of that camera in its middle, zero if that does not
/// show in the image.
#[derive(Debug, Clone, Copy)]
pub struct Sweep {
    pub way: Vec3,
    pub turn: Vec3,
}

impl Sweep {
    fn new(velocity: DVec3, turn: DVec3, readout_s: f64, camera: &Pinhole) -> Self {
        // Of points at 1 m.
        let shift = 0.5 * readout_s * f64::from(camera.fx) * (velocity.length() + turn.length());
        let shows = if shift.abs() < NOTICEABLE_PX { 0.0 } else { readout_s };
        Self { way: (velocity * shows).as_vec3(), turn: (turn * shows).as_vec3() }
    }

    /// True if all rows are seen at once.
    pub fn is_still(&self) -> bool {
        self.way == Vec3::ZERO && self.turn == Vec3::ZERO
    }

    /// How a point moves against the camera from the first row to the last, with the sign turned: at row s it is seen at
    /// p − s · shift.
    #[inline(always)]
    pub fn shift(&self, p: Vec3) -> Vec3 {
        self.way + self.turn.cross(p)
    }

    /// Takes a point from the camera at the instant of a row to the same camera at the middle's.
    pub fn middle_from_row(&self, row: f32) -> Pose {
        let [translation, rotation] = [self.way, self.turn].map(|d| (d * row).as_dvec3());
        Pose::exp(rotation, translation)
    }

    /// The point as it is seen in its own row, with its pixel there; the point must lie in front of the camera.
    #[inline(always)]
    pub fn project(&self, camera: &Pinhole, p: Vec3) -> (Vec3, Vec2) {
        if self.is_still() {
            return (p, camera.project(p));
        }
        // The pixel row y depends on the instant s, which is a y + b: with s in the small z term taken from where the
        // point would be without motion, that is linear in y.
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

    /// A point's pixel in a moving camera lies in the row at whose instant the point is seen there.
    #[test]
    fn a_point_is_seen_when_its_row_is_read() {
        let camera = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };
        let (velocity, turn) = (DVec3::new(0.4, -0.6, 0.3), DVec3::new(2.0, -1.0, 1.5));
        let sweep = Sweep::new(velocity, turn, 0.03, &camera);
        assert!(!sweep.is_still() && Sweep::new(velocity * 0.01, turn * 0.01, 0.03, &camera).is_still());
        for i in 0..200 {
            let q = Vec2::new((i * 37 % 320) as f32, (i * 91 % 240) as f32);
            let p = camera.ray(q.x, q.y) * (0.5 + 0.02 * i as f32);
            let (seen, pixel) = sweep.project(&camera, p);
            let row = camera.row(pixel.y);
            let expected = sweep.middle_from_row(row).inverse().transform(p.as_dvec3()).as_vec3();
            assert!((pixel - camera.project(seen)).length() < 1e-3);
            // But for the second order of a turn by 2.6° in half a read-out.
            assert!((pixel - camera.project(expected)).length() < 0.5, "{pixel} {}", camera.project(expected));
        }
    }
}
