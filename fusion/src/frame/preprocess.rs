//! A frame as tracking sees it: grey pyramid of the undistorted colour image, cleaned depth, and a grid of denoised
//! points with normals.

use crate::camera::rig::{DepthCorrection, LEVELS, Pinhole, Rig, Rigid, Undistort, depth_sigma};
use crate::camera::rolling_shutter::Motion;
use crate::isa::{Hot, Isa, dispatch};
use firmware_config::FusionConfig;
use glam::{Vec2, Vec3};
use recordings::types::RgbdFrame;

/// Depth neighbours further apart than this share of their depth lie on different surfaces.
const JUMP: f32 = 0.05;

/// A grey image, row-major, 0 … 255; negative where the distorted image does not reach.
#[derive(Debug, Clone, Default)]
pub struct Grey {
    pub width: usize,
    pub height: usize,
    pub data: Vec<f32>,
}

impl Grey {
    fn new(camera: &Pinhole) -> Self {
        let (width, height) = (camera.width, camera.height);
        Self { width, height, data: vec![0.0; width * height] }
    }

    /// Bilinear value and gradient (per pixel) at a position; `None` outside.
    #[inline(always)]
    pub fn sample(&self, q: Vec2) -> Option<(f32, Vec2)> {
        if !(q.x >= 0.0 && q.y >= 0.0) {
            return None;
        }
        let (x, y) = (q.x as usize, q.y as usize);
        if x + 1 >= self.width || y + 1 >= self.height {
            return None;
        }
        let (fx, fy) = (q.x - x as f32, q.y - y as f32);
        let at = y * self.width + x;
        let (a, b, c, d) =
            (self.data[at], self.data[at + 1], self.data[at + self.width], self.data[at + self.width + 1]);
        if a < 0.0 || b < 0.0 || c < 0.0 || d < 0.0 {
            return None;
        }
        let (top, bottom) = (a + fx * (b - a), c + fx * (d - c));
        let gradient = Vec2::new((1.0 - fy) * (b - a) + fy * (d - c), bottom - top);
        Some((top + fy * (bottom - top), gradient))
    }

    /// Central-difference gradient at a position, from the four neighbours at one pixel's distance.
    #[inline(always)]
    pub fn smooth_gradient(&self, q: Vec2) -> Option<Vec2> {
        let at = |dx: f32, dy: f32| self.sample(q + Vec2::new(dx, dy)).map(|s| s.0);
        Some(0.5 * Vec2::new(at(1.0, 0.0)? - at(-1.0, 0.0)?, at(0.0, 1.0)? - at(0.0, -1.0)?))
    }

    /// Halves a finer image; a pixel is unknown if one of its four is.
    fn halve(&mut self, fine: &Self) {
        for y in 0..self.height {
            let rows = (2 * y).min(fine.height - 1)..(2 * y + 2).min(fine.height);
            for x in 0..self.width {
                let columns = (2 * x).min(fine.width - 1)..(2 * x + 2).min(fine.width);
                let mut sum = 0.0;
                let mut known = true;
                let n = rows.len() * columns.len();
                for r in rows.clone() {
                    for c in columns.clone() {
                        let g = fine.data[r * fine.width + c];
                        known &= g >= 0.0;
                        sum += g;
                    }
                }
                self.data[y * self.width + x] = if known { sum / n as f32 } else { -1.0 };
            }
        }
    }
}

/// A point of the tracking grid, in the colour camera's coordinates.
#[derive(Debug, Clone, Copy, Default)]
pub struct Surfel {
    /// Position in metres; z = 0 where there is none.
    pub p: Vec3,
    /// Unit normal towards the camera; zero where there is none.
    pub n: Vec3,
}

impl Surfel {
    /// True if there is a point with a normal.
    #[inline(always)]
    pub fn is_valid(&self) -> bool {
        self.p.z > 0.0 && self.n != Vec3::ZERO
    }
}

/// The buffers of one frame; filled anew for each, never reallocated.
#[derive(Debug, Clone, Default)]
pub struct Frame {
    /// Grey pyramid, finest first.
    pub grey: [Grey; LEVELS],
    /// Cleaned depth at full resolution in the undistorted depth camera, metres, 0 = none.
    pub depth: Vec<f32>,
    /// The tracking grid, row-major, `rig.grid` samples.
    pub grid: Vec<Surfel>,
    /// Mean of the known grey values.
    pub mean_grey: f32,
    /// Mean squared grey gradient over the variance: falls with motion blur, not with exposure.
    pub sharpness: f32,
    /// How the camera moved while it took the frame.
    pub motion: Motion,
    /// Share of the grid with a point and normal.
    pub valid: f32,
    /// Median depth of the grid, metres; 0 if there is none.
    pub median_depth: f32,
    raw_grey: Grey,
    raw_depth: Vec<f32>,
    /// The grid, each row at the instant it was seen.
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

    /// Fills the buffers from a frame whose sizes were checked.
    pub fn fill(&mut self, frame: &RgbdFrame, rig: &Rig, config: &FusionConfig) {
        self.fill_grey(&frame.rgb.data, rig);
        self.fill_depth(&frame.depth.depth, rig, config);
        self.fill_grid(rig);
    }

    /// Moves the grid from the instants of its rows to the pose's, by the way that the camera is thought to go.
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
        self.sharpness = sharpness(&self.raw_grey, self.mean_grey);
    }

    /// Metres, range limits, flying pixels and grazing samples.
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
        let slope = 2.0 * config.max_slope as f32 / rig.depth.fx.min(rig.depth.fy);
        let hot = RejectSteep { raw: &self.raw_depth, out: &mut self.depth, width, height, slope };
        dispatch(Isa::detect(), hot);
    }

    /// The tracking grid: each sample is the mean of the depths of its cell that lie on one surface.
    fn fill_grid(&mut self, rig: &Rig) {
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
                let gate = 3.0 * depth_sigma(centre);
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
                    normal(p, [i - 1, i + 1, i - grid.width, i + grid.width].map(|j| self.points[j]))
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

/// Normal of a grid point from its left, right, upper and lower neighbours; zero where they are not on one surface.
#[inline(always)]
fn normal(p: Vec3, [left, right, up, down]: [Vec3; 4]) -> Vec3 {
    let jump = JUMP * p.z;
    let near = |q: Vec3| q.z > 0.0 && (q.z - p.z).abs() < jump;
    if p.z <= 0.0 || !near(left) || !near(right) || !near(up) || !near(down) {
        return Vec3::ZERO;
    }
    let n = (down - up).cross(right - left).normalize_or_zero();
    // Grazing samples carry more noise than knowledge.
    if n.dot(p) < -0.15 * p.length() { n } else { Vec3::ZERO }
}

/// Copies depth, leaving out pixels whose neighbours on both sides differ by more than a surface would.
struct RejectSteep<'a> {
    raw: &'a [f32],
    out: &'a mut [f32],
    width: usize,
    height: usize,
    slope: f32,
}

impl Hot for RejectSteep<'_> {
    #[inline(always)]
    fn run(self) {
        reject_steep(self.raw, self.out, self.width, self.height, self.slope);
    }
}

#[inline(always)]
fn reject_steep(raw: &[f32], out: &mut [f32], width: usize, height: usize, slope: f32) {
    for y in 0..height {
        let row = |r: usize| &raw[r * width..(r + 1) * width];
        let (up, here, down) = (row(y.saturating_sub(1)), row(y), row((y + 1).min(height - 1)));
        let target = &mut out[y * width..(y + 1) * width];
        if width < 3 {
            target.copy_from_slice(here);
            continue;
        }
        target[0] = 0.0;
        target[width - 1] = 0.0;
        let n = width - 2;
        let (l, c, r) = (&here[..n], &here[1..=n], &here[2..]);
        let (u, d, target) = (&up[1..=n], &down[1..=n], &mut target[1..=n]);
        for i in 0..n {
            let z = c[i];
            let known = |q: f32| if q > 0.0 { q } else { z };
            let dx = (known(r[i]) - known(l[i])).abs();
            let dy = (known(d[i]) - known(u[i])).abs();
            let e = z - 0.4;
            let limit = slope * z + 3.0 * (0.0012 + 0.0019 * e * e);
            let alone = ((l[i] <= 0.0) & (r[i] <= 0.0)) | ((u[i] <= 0.0) & (d[i] <= 0.0));
            target[i] = if (dx < limit) & (dy < limit) & !alone { z } else { 0.0 };
        }
    }
}

fn sharpness(g: &Grey, mean: f32) -> f32 {
    let mut gradient = 0.0f64;
    let mut variance = 0.0f64;
    for y in 0..g.height.saturating_sub(1) {
        let (row, next) = (&g.data[y * g.width..(y + 1) * g.width], &g.data[(y + 1) * g.width..]);
        let (mut gs, mut vs) = (0.0f32, 0.0f32);
        for x in 0..g.width - 1 {
            let (dx, dy) = (row[x + 1] - row[x], next[x] - row[x]);
            gs += dx * dx + dy * dy;
            vs += (row[x] - mean) * (row[x] - mean);
        }
        gradient += f64::from(gs);
        variance += f64::from(vs);
    }
    (gradient / (variance + 1.0)) as f32
}
