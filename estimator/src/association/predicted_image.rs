//! A keyframe as the lit colours predict it, beside the picture, at a chosen resolution. Both hold square roots of
//! linear light: photon noise is the same at every brightness there.

use crate::association::keyframe_image::KeyframeImage;
use crate::association::{Setting, View};
use crate::mesh::raster::{MISS, Raster, camera_positions, scaled};
use glam::Vec3;
use recordings::types::Intrinsics;

/// Pixels around the mesh's outline that may still show the mesh: the background is continued into them from outside.
const OUTLINE_PX: usize = 4;

/// A picture at a chosen resolution, smoothed; NaN where clipped.
pub struct Plate {
    /// Pinhole camera at this resolution.
    pub camera: Intrinsics,
    /// Square roots of linear light.
    pub color: Vec<Vec3>,
    linear: Vec<Vec3>,
}

impl Plate {
    /// Averages `1/level × 1/level` pixels into one (`level` 1, 1/2 or 1/4).
    pub fn new(picture: &KeyframeImage, setting: &Setting, level: f64) -> Self {
        let camera = scaled(&picture.camera, level);
        let step = (1.0 / level).round() as usize;
        let (w, h) = (camera.width as usize, camera.height as usize);
        let (fw, fh) = (picture.camera.width as usize, picture.camera.height as usize);
        let mut linear = vec![Vec3::NAN; w * h];
        for y in 0..h.min(fh / step) {
            for x in 0..w.min(fw / step) {
                let mut sum = Vec3::ZERO;
                for dy in 0..step {
                    for dx in 0..step {
                        let b = picture.bytes(x * step + dx, y * step + dy);
                        let clipped = b.iter().any(|&v| v >= setting.clipped);
                        sum += if clipped { Vec3::NAN } else { Vec3::from_array(b.map(|v| setting.table[v as usize])) };
                    }
                }
                linear[y * w + x] = sum / (step * step) as f32;
            }
        }
        let mut color = smoothed(&linear, w, h);
        color.iter_mut().for_each(|c| *c = c.map(f32::sqrt));
        Self { camera, color, linear }
    }

    /// Bilinear sample; NaN where a neighbour is clipped, `None` outside.
    pub fn sample(&self, u: f64, v: f64) -> Option<Vec3> {
        let (w, h) = (self.camera.width as usize, self.camera.height as usize);
        if !(u >= 0.0 && v >= 0.0 && u < (w - 1) as f64 && v < (h - 1) as f64) {
            return None;
        }
        let (x, y) = (u as usize, v as usize);
        let (fx, fy) = ((u - x as f64) as f32, (v - y as f64) as f32);
        let i = y * w + x;
        let top = self.color[i] * (1.0 - fx) + self.color[i + 1] * fx;
        let bottom = self.color[i + w] * (1.0 - fx) + self.color[i + w + 1] * fx;
        Some(top * (1.0 - fy) + bottom * fy)
    }
}

/// The predicted picture.
pub struct Template {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Pinhole camera.
    pub camera: Intrinsics,
    /// Square roots of linear light; NaN where not known.
    pub color: Vec<Vec3>,
    /// Nearest depth within a pixel: an outline moves with the surface in front. Infinite far from the mesh.
    pub depth: Vec<f32>,
}

impl Template {
    /// Renders lit `colors` (NaN = unknown) through the view's pose and gain; behind the mesh stands the picture's own
    /// background, continued inwards from beyond the outline.
    pub fn new(setting: &Setting, plate: &Plate, colors: &[Vec3], view: &View) -> Self {
        let camera = plate.camera;
        let (w, h) = (camera.width as usize, camera.height as usize);
        let points = camera_positions(setting.mesh, &view.world_from_camera);
        let raster = Raster::new(&points, &setting.mesh.triangles, &camera, setting.near);
        let gain = Vec3::from_array(view.gain.map(|g| g as f32));
        let background = background(plate, &raster);
        let mut linear = Vec::with_capacity(w * h);
        for y in 0..h {
            for x in 0..w {
                let i = y * w + x;
                let t = raster.triangle[i];
                linear.push(if t == MISS {
                    background[i]
                } else {
                    let corners = setting.mesh.triangles[t as usize];
                    let weights = raster.weights(x, y, corners.map(|c| points[c as usize]));
                    let color = (0..3).map(|k| colors[corners[k] as usize] * weights[k]).sum::<Vec3>();
                    color * gain
                });
            }
        }
        // Once for the lens and the pixel's area, once because the picture was smoothed.
        let mut color = smoothed(&smoothed(&linear, w, h), w, h);
        color.iter_mut().for_each(|c| *c = c.map(f32::sqrt));
        let depth = nearest(&raster.depth, w, h);
        Self { width: w, height: h, camera, color, depth }
    }
}

/// The picture beyond the mesh's outline, continued over all pixels by averaging in ever coarser grids.
fn background(plate: &Plate, raster: &Raster) -> Vec<Vec3> {
    let (w, h) = (plate.camera.width as usize, plate.camera.height as usize);
    let hit: Vec<bool> = raster.triangle.iter().map(|&t| t != MISS).collect();
    let near = dilate(&hit, w, h, OUTLINE_PX);
    let mut levels = vec![Grid {
        w,
        h,
        cells: (0..w * h)
            .map(|i| if near[i] || plate.linear[i].is_nan() { (Vec3::ZERO, 0.0) } else { (plate.linear[i], 1.0) })
            .collect(),
    }];
    while let Some(last) = levels.last().filter(|l| l.w > 1 || l.h > 1) {
        levels.push(last.halved());
    }
    // From coarse to fine: where a cell knows little, the coarser one speaks.
    let Some(mut current) = levels.pop() else { return Vec::new() };
    while let Some(mut finer) = levels.pop() {
        for y in 0..finer.h {
            for x in 0..finer.w {
                let (coarse, known) = current.cells[(y / 2) * current.w + x / 2];
                let cell = &mut finer.cells[y * finer.w + x];
                if cell.1 < 1.0 && known > 0.0 {
                    *cell = ((cell.0 * cell.1 + coarse * (1.0 - cell.1)), 1.0);
                }
            }
        }
        current = finer;
    }
    current.cells.iter().map(|&(c, known)| if known > 0.0 { c } else { Vec3::NAN }).collect()
}

/// Mean colours and how well they are known (0 to 1).
struct Grid {
    w: usize,
    h: usize,
    cells: Vec<(Vec3, f32)>,
}

impl Grid {
    fn halved(&self) -> Self {
        let (w, h) = (self.w.div_ceil(2), self.h.div_ceil(2));
        let mut cells = Vec::with_capacity(w * h);
        for y in 0..h {
            for x in 0..w {
                let (mut sum, mut known) = (Vec3::ZERO, 0.0);
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let (px, py) = (2 * x + dx, 2 * y + dy);
                    if px < self.w && py < self.h {
                        let (c, k) = self.cells[py * self.w + px];
                        sum += c * k;
                        known += k;
                    }
                }
                cells.push(if known > 0.0 { (sum / known, known.min(1.0)) } else { (Vec3::ZERO, 0.0) });
            }
        }
        Self { w, h, cells }
    }
}

/// Grows a mask by `radius` pixels along both axes.
fn dilate(mask: &[bool], w: usize, h: usize, radius: usize) -> Vec<bool> {
    let mut rows = vec![false; w * h];
    for y in 0..h {
        let mut reach = 0;
        for x in 0..w {
            reach = if mask[y * w + x] { radius + 1 } else { reach.saturating_sub(1) };
            rows[y * w + x] = reach > 0;
        }
        reach = 0;
        for x in (0..w).rev() {
            reach = if mask[y * w + x] { radius + 1 } else { reach.saturating_sub(1) };
            rows[y * w + x] |= reach > 0;
        }
    }
    let mut out = vec![false; w * h];
    for x in 0..w {
        let mut reach = 0;
        for y in 0..h {
            reach = if rows[y * w + x] { radius + 1 } else { reach.saturating_sub(1) };
            out[y * w + x] = reach > 0;
        }
        reach = 0;
        for y in (0..h).rev() {
            reach = if rows[y * w + x] { radius + 1 } else { reach.saturating_sub(1) };
            out[y * w + x] |= reach > 0;
        }
    }
    out
}

/// Binomial 3 × 3 mean; NaN spreads, and stands along the border.
fn smoothed(image: &[Vec3], w: usize, h: usize) -> Vec<Vec3> {
    let mut rows = vec![Vec3::NAN; w * h];
    for y in 0..h {
        for x in 1..w.saturating_sub(1) {
            let i = y * w + x;
            rows[i] = 0.25 * (image[i - 1] + image[i + 1]) + 0.5 * image[i];
        }
    }
    let mut out = vec![Vec3::NAN; w * h];
    for y in 1..h.saturating_sub(1) {
        for x in 0..w {
            let i = y * w + x;
            out[i] = 0.25 * (rows[i - w] + rows[i + w]) + 0.5 * rows[i];
        }
    }
    out
}

/// Least value within 2 pixels along both axes.
fn nearest(depth: &[f32], w: usize, h: usize) -> Vec<f32> {
    let mut rows = depth.to_vec();
    for y in 0..h {
        for x in 0..w {
            for k in x.saturating_sub(2)..(x + 3).min(w) {
                rows[y * w + x] = rows[y * w + x].min(depth[y * w + k]);
            }
        }
    }
    let mut out = rows.clone();
    for y in 0..h {
        for k in y.saturating_sub(2)..(y + 3).min(h) {
            for x in 0..w {
                out[y * w + x] = out[y * w + x].min(rows[k * w + x]);
            }
        }
    }
    out
}
