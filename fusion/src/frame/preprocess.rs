//! A frame as tracking uses it: grey pyramid, filtered depth, grid of points with normals.

use crate::camera::depth_correction::DepthCorrection;
use crate::camera::lens::Undistort;
use crate::camera::pinhole::Rigid;
use crate::camera::rig::{LEVELS, Rig};
use crate::camera::rolling_shutter::Motion;
use crate::frame::depth_filter::RejectSteep;
use crate::frame::grey::Grey;
use firmware_config::FusionConfig;
use firmware_config::tuning::PreprocessingTuning;
use glam::Vec3;
use isa::{Isa, dispatch};
use recordings::types::RgbdFrame;

/// A point of the tracking grid, axes of the colour camera.
#[derive(Debug, Clone, Copy, Default)]
pub struct Surfel {
    /// Position, metres; z = 0 where there is no depth.
    pub p: Vec3,
    /// Unit normal towards the camera; zero where it is unknown.
    pub n: Vec3,
}

impl Surfel {
    /// True if there is a point with a normal.
    #[inline(always)]
    pub fn is_valid(&self) -> bool {
        self.p.z > 0.0 && self.n != Vec3::ZERO
    }
}

/// The buffers of one frame; refilled for each frame, never reallocated.
#[derive(Debug, Clone, Default)]
pub struct Frame {
    /// Grey pyramid, finest first.
    pub grey: [Grey; LEVELS],
    /// Filtered depth of the undistorted depth camera, row-major, metres, 0 = none.
    pub depth: Vec<f32>,
    /// The tracking grid, row-major, `rig.grid` samples.
    pub grid: Vec<Surfel>,
    /// Mean of the known grey values.
    pub mean_grey: f32,
    /// See [`Grey::sharpness`].
    pub sharpness: f32,
    /// Motion of the camera while the frame was taken.
    pub motion: Motion,
    /// Share of the grid with a point and normal.
    pub valid: f32,
    /// Median depth of the grid, metres; 0 if there is none.
    pub median_depth: f32,
    raw_grey: Grey,
    raw_depth: Vec<f32>,
    /// The grid, each row at the instant of its read-out.
    raw_grid: Vec<Surfel>,
    points: Vec<Vec3>,
    depths: Vec<f32>,
}

impl Frame {
    /// Buffers for a sensor.
    pub fn new(rig: &Rig) -> Self {
        let grid = rig.grid.width * rig.grid.height;
        let pixels = rig.depth.width * rig.depth.height;
        Self {
            grey: std::array::from_fn(|l| Grey::new(&rig.grey[l])),
            depth: vec![0.0; pixels],
            grid: vec![Surfel::default(); grid],
            raw_grey: Grey::new(&rig.grey[0]),
            raw_depth: vec![0.0; pixels],
            raw_grid: vec![Surfel::default(); grid],
            points: vec![Vec3::ZERO; grid],
            depths: Vec::with_capacity(grid),
            ..Self::default()
        }
    }

    /// Fills the buffers from a frame whose sizes were checked (`Rig::check_frame`).
    pub fn fill(&mut self, frame: &RgbdFrame, rig: &Rig, config: &FusionConfig) {
        self.fill_grey(&frame.rgb.data, rig);
        self.fill_depth(&frame.depth.depth, rig, config);
        self.fill_grid(rig, &config.tuning.preprocessing);
    }

    /// Moves the grid from the instants of its rows to the instant of the pose, by the camera's motion.
    pub fn synchronise(&mut self, motion: &Motion, rig: &Rig) {
        self.motion = *motion;
        let rows = rig.grid.height as f64;
        let width = rig.grid.width;
        for (y, (grid, raw)) in self.grid.chunks_exact_mut(width).zip(self.raw_grid.chunks_exact(width)).enumerate() {
            let t = Rigid::from(&motion.color_from_row((y as f64 + 0.5) / rows - 0.5));
            for (s, raw) in grid.iter_mut().zip(raw) {
                *s = if raw.p.z > 0.0 { Surfel { p: t.apply(raw.p), n: t.r * raw.n } } else { *raw };
            }
        }
    }

    fn fill_grey(&mut self, rgb: &[u8], rig: &Rig) {
        let step = rig.grey_step;
        let width = rig.color_size.0 as usize;
        let out = &mut self.raw_grey;
        let scale = 1.0 / (256 * step * step) as f32;
        let mut row_sums = vec![0u32; out.width];
        for y in 0..out.height {
            row_sums.fill(0);
            for r in 0..step {
                let row = &rgb[3 * (y * step + r) * width..][..3 * out.width * step];
                if step == 2 {
                    for (sum, p) in row_sums.iter_mut().zip(row.chunks_exact(6)) {
                        *sum += 77 * (u32::from(p[0]) + u32::from(p[3]))
                            + 150 * (u32::from(p[1]) + u32::from(p[4]))
                            + 29 * (u32::from(p[2]) + u32::from(p[5]));
                    }
                } else {
                    for (sum, p) in row_sums.iter_mut().zip(row.chunks_exact(3 * step)) {
                        for q in p.chunks_exact(3) {
                            *sum += 77 * u32::from(q[0]) + 150 * u32::from(q[1]) + 29 * u32::from(q[2]);
                        }
                    }
                }
            }
            for (g, sum) in out.data[y * out.width..].iter_mut().zip(&row_sums) {
                *g = *sum as f32 * scale;
            }
        }
        match &rig.grey_undistort {
            Undistort::None => self.grey[0].data.copy_from_slice(&self.raw_grey.data),
            Undistort::Map(map) => {
                for (g, q) in self.grey[0].data.iter_mut().zip(map) {
                    *g = self.raw_grey.sample(*q).map_or(-1.0, |s| s.0);
                }
            }
        }
        let (fine, rest) = self.grey.split_at_mut(1);
        rest[0].halve(&fine[0]);
        let (middle, coarse) = rest.split_at_mut(1);
        coarse[0].halve(&middle[0]);
        self.mean_grey = self.raw_grey.data.iter().sum::<f32>() / self.raw_grey.data.len() as f32;
        self.sharpness = self.raw_grey.sharpness(self.mean_grey);
    }

    /// Depth in metres, undistorted and corrected, within the range limits, without grazing and flying pixels.
    fn fill_depth(&mut self, raw: &[u16], rig: &Rig, config: &FusionConfig) {
        let (unit, near, far) = (rig.depth_unit_m, config.min_depth_m as f32, config.max_depth_m as f32);
        let metres = |d: u16| {
            let z = f32::from(d) * unit;
            if (z >= near) & (z <= far) { z } else { 0.0 }
        };
        match &rig.depth_undistort {
            Undistort::None => {
                for (z, d) in self.raw_depth.iter_mut().zip(raw) {
                    *z = metres(*d);
                }
            }
            Undistort::Map(map) => {
                let width = rig.depth.width;
                for (z, q) in self.raw_depth.iter_mut().zip(map) {
                    let at = (q.y + 0.5) as usize * width + (q.x + 0.5) as usize;
                    *z = if q.x < 0.0 { 0.0 } else { metres(raw[at]) };
                }
            }
        }
        if let DepthCorrection::Map(map) = &rig.depth_correction {
            for (z, c) in self.raw_depth.iter_mut().zip(map) {
                *z = (*z * (c.x + *z * c.y)).max(0.0);
            }
        }
        let (width, height) = (rig.depth.width, rig.depth.height);
        let slope = config.max_slope as f32 / rig.depth.fx.min(rig.depth.fy);
        let sigmas = config.tuning.preprocessing.slope_sigmas as f32;
        let (raw, out) = (&self.raw_depth, &mut self.depth);
        dispatch(Isa::detect(), RejectSteep { raw, out, width, height, slope, sigmas, noise: rig.noise });
    }

    /// The tracking grid: each point is the mean of those pixels of its cell that lie on one surface.
    fn fill_grid(&mut self, rig: &Rig, tuning: &PreprocessingTuning) {
        let (sigmas, jump, min_cos) =
            (tuning.cell_sigmas as f32, tuning.max_depth_jump_share as f32, tuning.min_normal_cos as f32);
        let (grid, step, width) = (&rig.grid, rig.grid_step, rig.depth.width);
        let to_color = Rigid::from(&rig.color_from_depth);
        let (rows, columns) = (rig.depth.height.min(step), rig.depth.width.min(step));
        for y in 0..grid.height {
            for x in 0..grid.width {
                let cell = |r: usize, c: usize| self.depth[(y * step + r) * width + x * step + c];
                let mut centre = cell(rows / 2, columns / 2);
                for r in 0..rows {
                    for c in 0..columns {
                        centre = if centre > 0.0 { centre } else { cell(r, c) };
                    }
                }
                let gate = sigmas * rig.noise.sigma_m(centre);
                let (mut n, mut z, mut u, mut v) = (0.0f32, 0.0, 0.0, 0.0);
                for r in 0..rows {
                    for c in 0..columns {
                        let d = cell(r, c);
                        let one = if (d > 0.0) & ((d - centre).abs() < gate) { 1.0 } else { 0.0 };
                        n += one;
                        z += one * d;
                        u += one * c as f32;
                        v += one * r as f32;
                    }
                }
                let p = if centre > 0.0 && n > 0.0 {
                    let w = 1.0 / n;
                    let ray = rig.depth.ray((x * step) as f32 + u * w, (y * step) as f32 + v * w);
                    to_color.apply(ray * (z * w))
                } else {
                    Vec3::ZERO
                };
                self.points[y * grid.width + x] = p;
            }
        }
        self.depths.clear();
        for y in 0..grid.height {
            for x in 0..grid.width {
                let i = y * grid.width + x;
                let p = self.points[i];
                let n = if x > 0 && y > 0 && x + 1 < grid.width && y + 1 < grid.height {
                    let neighbours = [i - 1, i + 1, i - grid.width, i + grid.width].map(|j| self.points[j]);
                    normal(p, neighbours, jump, min_cos)
                } else {
                    Vec3::ZERO
                };
                self.raw_grid[i] = Surfel { p, n };
                if n != Vec3::ZERO {
                    self.depths.push(p.z);
                }
            }
        }
        self.valid = self.depths.len() as f32 / self.grid.len() as f32;
        let middle = self.depths.len() / 2;
        self.median_depth =
            if self.depths.is_empty() { 0.0 } else { *self.depths.select_nth_unstable_by(middle, f32::total_cmp).1 };
    }
}

/// Normal of a grid point from its left, right, upper and lower neighbours; zero where they do not lie on one surface, and
/// where the view is grazing, since noise dominates there.
#[inline(always)]
fn normal(p: Vec3, [left, right, up, down]: [Vec3; 4], jump: f32, min_cos: f32) -> Vec3 {
    let jump = jump * p.z;
    let near = |q: Vec3| q.z > 0.0 && (q.z - p.z).abs() < jump;
    if p.z <= 0.0 || !near(left) || !near(right) || !near(up) || !near(down) {
        return Vec3::ZERO;
    }
    let n = (down - up).cross(right - left).normalize_or_zero();
    if n.dot(p) < -min_cos * p.length() { n } else { Vec3::ZERO }
}
