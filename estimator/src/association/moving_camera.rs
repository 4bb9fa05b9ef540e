//! A camera that moves while the rows of its picture are read (rolling shutter).

use crate::association::alignment::{Motion, pose_of};
use glam::{DVec3, Vec3};
use recordings::types::{Intrinsics, Mesh, Pose};

/// Times that the row of a point is looked up: the row moves the point, which changes the row by far less.
const LOOKUPS: usize = 2;

/// Pose of the camera at every row of a picture.
#[derive(Debug, Clone, Copy)]
pub struct MovingCamera {
    /// `camera_from_world` at the middle row.
    pub camera_from_world: Pose,
    /// Motion of points in the camera's frame from the first row to the last one: rotation vector, translation.
    pub sweep: Motion,
    /// Pinhole camera.
    pub intrinsics: Intrinsics,
}

impl MovingCamera {
    /// A camera that stands still.
    #[must_use]
    pub fn still(world_from_camera: &Pose, intrinsics: &Intrinsics) -> Self {
        Self { camera_from_world: world_from_camera.inverse(), sweep: Motion::zeros(), intrinsics: *intrinsics }
    }

    /// A point of the world in the camera's frame (X right, Y down, Z forward) when the row that shows it is read. Points behind
    /// the camera are left where the middle row has them.
    #[must_use]
    pub fn point(&self, world: Vec3) -> DVec3 {
        let middle = self.camera_from_world.transform(world.as_dvec3());
        let (turn, shift) = (self.sweep.fixed_rows::<3>(0), self.sweep.fixed_rows::<3>(3));
        let velocity = DVec3::new(turn[0], turn[1], turn[2]).cross(middle) + DVec3::new(shift[0], shift[1], shift[2]);
        let mut at = middle;
        for _ in 0..LOOKUPS {
            if at.z <= 0.0 {
                return middle;
            }
            at = middle + velocity * self.time(at);
        }
        at
    }

    /// When the row that shows a point in the camera's frame is read: -1/2 at the first row, 1/2 at the last one.
    #[must_use]
    pub fn time(&self, point: DVec3) -> f64 {
        let k = &self.intrinsics;
        ((k.fy * point.y / point.z + k.cy) / f64::from(k.height) - 0.5).clamp(-0.5, 0.5)
    }

    /// The pixel (u, v) of a point in the camera's frame.
    #[must_use]
    pub fn pixel(&self, point: DVec3) -> (f64, f64) {
        self.intrinsics.project(point)
    }

    /// The vertices as [`MovingCamera::point`] has them, `[vertex]`.
    #[must_use]
    pub fn points(&self, mesh: &Mesh) -> Vec<DVec3> {
        mesh.positions.iter().map(|p| self.point(*p)).collect()
    }

    /// The camera after a step: of the pose at the middle row, and of the sweep.
    #[must_use]
    pub fn moved(&self, step: &Motion, sweep: &Motion) -> Self {
        Self { camera_from_world: pose_of(step).compose(&self.camera_from_world), sweep: self.sweep + sweep, ..*self }
    }
}
