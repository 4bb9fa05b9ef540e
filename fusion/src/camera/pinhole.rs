//! Pinhole projection and rigid transforms in single precision, for inner loops.

use glam::{Mat3, Vec2, Vec3};
use recordings::types::{CameraModel, Pose};

/// An undistorted pinhole camera; pixel centres are at integers.
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
    /// The pinhole of a camera model, without its distortion.
    pub fn new(camera: &CameraModel) -> Self {
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

    /// The camera of the image whose pixels are means of `step × step` pixels (incomplete cells are left out).
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

    /// Projects a point (camera axes, metres) to a pixel position; the point must lie in front of the camera.
    #[inline(always)]
    pub fn project(&self, p: Vec3) -> Vec2 {
        let w = 1.0 / p.z;
        Vec2::new(self.fx * p.x * w + self.cx, self.fy * p.y * w + self.cy)
    }

    /// Ray of a pixel position, scaled to z = 1.
    #[inline(always)]
    pub fn ray(&self, u: f32, v: f32) -> Vec3 {
        Vec3::new((u - self.cx) / self.fx, (v - self.cy) / self.fy, 1.0)
    }

    /// Row of a pixel position as a share of the image height: −½ at the upper edge, ½ at the lower edge.
    #[inline(always)]
    pub fn row(&self, v: f32) -> f32 {
        (v + 0.5) / self.height as f32 - 0.5
    }

    /// Index (row-major) of the pixel onto which a point projects; `None` outside the image and behind the camera.
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

/// A rigid transform x ↦ r x + t in single precision.
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
