//! Grey images of the pyramid: sampling, gradients, halving, sharpness.

use crate::camera::pinhole::Pinhole;
use glam::Vec2;

/// A grey image, row-major, 0 … 255; negative where the distorted image has no pixel.
#[derive(Debug, Clone, Default)]
pub struct Grey {
    pub width: usize,
    pub height: usize,
    pub data: Vec<f32>,
}

impl Grey {
    /// A black image of the camera's size.
    pub fn new(camera: &Pinhole) -> Self {
        let (width, height) = (camera.width, camera.height);
        Self { width, height, data: vec![0.0; width * height] }
    }

    /// Bilinear value and gradient (per pixel) at a pixel position; `None` outside.
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

    /// Central-difference gradient (per pixel) at a pixel position; `None` next to the border.
    #[inline(always)]
    pub fn smooth_gradient(&self, q: Vec2) -> Option<Vec2> {
        let at = |dx: f32, dy: f32| self.sample(q + Vec2::new(dx, dy)).map(|s| s.0);
        Some(0.5 * Vec2::new(at(1.0, 0.0)? - at(-1.0, 0.0)?, at(0.0, 1.0)? - at(0.0, -1.0)?))
    }

    /// Fills the image with 2 × 2 means of a finer one; a pixel is unknown if one of its four pixels is.
    pub fn halve(&mut self, fine: &Self) {
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

    /// Mean squared gradient over the variance about `mean`: falls with motion blur, not with exposure.
    pub fn sharpness(&self, mean: f32) -> f32 {
        let mut gradient = 0.0f64;
        let mut variance = 0.0f64;
        for y in 0..self.height.saturating_sub(1) {
            let (row, next) = (&self.data[y * self.width..(y + 1) * self.width], &self.data[(y + 1) * self.width..]);
            let (mut gs, mut vs) = (0.0f32, 0.0f32);
            for x in 0..self.width - 1 {
                let (dx, dy) = (row[x + 1] - row[x], next[x] - row[x]);
                gs += dx * dx + dy * dy;
                vs += (row[x] - mean) * (row[x] - mean);
            }
            gradient += f64::from(gs);
            variance += f64::from(vs);
        }
        (gradient / (variance + 1.0)) as f32
    }
}
