//! Reference frames: what later frames are aligned to.

use crate::camera::pinhole::Rigid;
use crate::camera::rig::{LEVELS, Rig};
use crate::frame::preprocess::{Frame, Surfel};
use glam::Vec3;
use recordings::types::Pose;

/// A point of a reference frame with its grey value.
#[derive(Debug, Clone, Copy, Default)]
pub struct PhotoPoint {
    /// Position, axes of the reference's colour camera, metres.
    pub p: Vec3,
    /// Grey value.
    pub grey: f32,
}

/// A frame to which later frames are aligned.
#[derive(Debug, Clone, Default)]
pub struct Reference {
    pub world_from_camera: Pose,
    /// Textured points, `[level]`.
    pub photo: [Vec<PhotoPoint>; LEVELS],
    /// Every second point of the tracking grid, row-major.
    pub coarse: Vec<Surfel>,
    pub median_depth: f32,
    /// Mean grey value of the frame.
    pub mean_grey: f32,
}

impl Reference {
    /// Refills from a tracked frame, with photometric points (of at least `min_gradient` grey values per pixel) on `levels`.
    pub fn fill(
        &mut self,
        frame: &Frame,
        rig: &Rig,
        world_from_camera: &Pose,
        levels: std::ops::Range<usize>,
        min_gradient: f32,
    ) {
        self.world_from_camera = *world_from_camera;
        self.median_depth = frame.median_depth;
        self.mean_grey = frame.mean_grey;
        self.coarse.clear();
        for y in (0..rig.grid.height).step_by(2) {
            for x in (0..rig.grid.width).step_by(2) {
                self.coarse.push(frame.grid[y * rig.grid.width + x]);
            }
        }
        for level in 0..LEVELS {
            self.photo[level].clear();
            if levels.contains(&level) {
                photo_points(frame, rig, level, min_gradient * min_gradient, &mut self.photo[level]);
            }
        }
    }
}

/// From each cell of an 80 × 60 grid over the depth image, the point with the strongest grey gradient at `level`.
fn photo_points(frame: &Frame, rig: &Rig, level: usize, min_gradient2: f32, out: &mut Vec<PhotoPoint>) {
    let shutter = frame.motion.of_color(rig);
    let step = (rig.grid_step << level).div_ceil(2).max(1);
    let per_cell = (1usize << (LEVELS - 1 - level)).max(1);
    let (columns, rows) = (rig.depth.width / (step * per_cell), rig.depth.height / (step * per_cell));
    for cy in 0..rows {
        let row = ((cy as f64 + 0.5) / rows as f64) - 0.5;
        let to_color = Rigid::from(&frame.motion.color_from_row(row).compose(&rig.color_from_depth));
        for cx in 0..columns {
            let mut best = (min_gradient2, PhotoPoint::default());
            for k in 0..per_cell * per_cell {
                let u = (cx * per_cell + k % per_cell) * step + step / 2;
                let v = (cy * per_cell + k / per_cell) * step + step / 2;
                let z = frame.depth[v * rig.depth.width + u];
                if z <= 0.0 {
                    continue;
                }
                let p = to_color.apply(rig.depth.ray(u as f32, v as f32) * z);
                let (_, q) = shutter.project(&rig.grey[level], p);
                let Some(gradient) = frame.grey[level].smooth_gradient(q) else { continue };
                let strength = gradient.length_squared();
                if strength > best.0
                    && let Some((grey, _)) = frame.grey[level].sample(q)
                {
                    best = (strength, PhotoPoint { p, grey });
                }
            }
            if best.0 > min_gradient2 {
                out.push(best.1);
            }
        }
    }
}
