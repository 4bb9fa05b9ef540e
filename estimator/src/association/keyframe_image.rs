//! A keyframe's image without lens distortion, and linear samples of it.

use crate::association::vignetting::Vignetting;
use recordings::types::{CameraModel, ColorFrame, Intrinsics};

/// An 8-bit RGB image of an ideal pinhole camera. Pixels outside the distorted image are white and so count as clipped.
pub struct KeyframeImage {
    /// The pinhole camera.
    pub camera: Intrinsics,
    /// Row-major interleaved RGB: `[3 * width * height]`.
    pub data: Vec<u8>,
    /// What samples are freed of.
    pub vignetting: Vignetting,
}

/// A weighted mean over a small window of an image.
#[derive(Debug, Clone, Copy)]
pub struct WindowSample {
    /// Mean linear RGB.
    pub color: [f32; 3],
    /// Brightest 8-bit value of any channel in the window.
    pub brightest: u8,
    /// Effective number of independent pixels, (Σ w)² / Σ w².
    pub pixels: f32,
}

impl KeyframeImage {
    /// Decodes and undistorts a frame. `None` if the frame is damaged or its size differs from the camera's.
    pub fn new(frame: &ColorFrame, camera: &CameraModel) -> Option<Self> {
        let image = frame.decode().ok()?;
        let k = camera.intrinsics;
        let pixels = k.width as usize * k.height as usize;
        if image.width != k.width || image.height != k.height || image.data.len() != 3 * pixels || pixels == 0 {
            return None;
        }
        let finite = [k.fx, k.fy, k.cx, k.cy].iter().all(|x| x.is_finite()) && k.fx.abs() > 0.0 && k.fy.abs() > 0.0;
        if !finite {
            return None;
        }
        let data = if camera.distortion.is_none() { image.data } else { undistort(&image.data, camera) };
        Some(Self { camera: k, data, vignetting: Vignetting::default() })
    }

    /// The 8-bit values at a pixel.
    pub fn bytes(&self, x: usize, y: usize) -> [u8; 3] {
        let i = 3 * (y * self.camera.width as usize + x);
        [self.data[i], self.data[i + 1], self.data[i + 2]]
    }

    /// True if all channels of a pixel have at least the value `clipped`.
    #[must_use]
    pub fn is_clipped(&self, x: usize, y: usize, clipped: u8) -> bool {
        self.bytes(x, y).iter().all(|b| *b >= clipped)
    }

    /// Mean under a tent filter of half width `radius >= 1` pixels about (u, v); radius 1 is bilinear interpolation.
    /// `table` maps 8-bit values to linear light, freed of vignetting. `None` if the window leaves the image.
    pub fn sample(&self, table: &[f32; 256], u: f64, v: f64, radius: f64) -> Option<WindowSample> {
        let (w, h) = (f64::from(self.camera.width), f64::from(self.camera.height));
        let (left, top, right, bottom) = (u - radius, v - radius, u + radius, v + radius);
        // Written so that NaN fails too.
        if !(left > -1.0 && top > -1.0 && right < w && bottom < h) {
            return None;
        }
        let mut window = Window::default();
        if radius == 1.0 {
            // Most windows: four pixels, without loops whose lengths depend on where they are.
            let (x, y) = (u as u32, v as u32);
            let weights = |at: u32, of: f64| [at, at + 1].map(|at| (1.0 - (f64::from(at) - of).abs()).max(0.0));
            let ([left, right], [above, below]) = (weights(x, u), weights(y, v));
            let rows = [y, y + 1].map(|y| (y as usize * self.camera.width as usize + x as usize) * 3);
            for (row, wy) in rows.into_iter().zip([above, below]) {
                // At the last column or row the pixel beyond has no weight.
                for (at, wx) in [(row, left), (row + 3, right)] {
                    if let Some(value) = self.data.get(at..).and_then(|rest| rest.first_chunk::<3>()) {
                        window.add(table, value, (wy * wx) as f32);
                    }
                }
            }
        } else {
            let (first, end) = (least_above(left), right as u32 + 1);
            for y in least_above(top)..=bottom as u32 {
                let wy = (radius - (f64::from(y) - v).abs()).max(0.0);
                let row = &self.data[3 * y as usize * self.camera.width as usize..];
                let (row, _) = row[3 * first as usize..3 * end as usize].as_chunks::<3>();
                for (x, value) in (first..).zip(row) {
                    window.add(table, value, (wy * (radius - (f64::from(x) - u).abs()).max(0.0)) as f32);
                }
            }
        }
        let Window { sum, total, squares, brightest } = window;
        let shade = self.vignetting.shade(&self.camera, u, v);
        (total > 0.0).then(|| WindowSample {
            color: sum.map(|s| s / (total * shade)),
            brightest,
            pixels: total * total / squares,
        })
    }
}

/// Sums over the pixels of a window.
#[derive(Default)]
struct Window {
    sum: [f32; 3],
    total: f32,
    squares: f32,
    brightest: u8,
}

impl Window {
    #[inline]
    fn add(&mut self, table: &[f32; 256], value: &[u8; 3], weight: f32) {
        if weight <= 0.0 {
            return;
        }
        self.brightest = self.brightest.max(value[0]).max(value[1]).max(value[2]);
        (0..3).for_each(|c| self.sum[c] += weight * table[value[c] as usize]);
        self.total += weight;
        self.squares += weight * weight;
    }
}

/// The least whole number that is not below `x`, which is above −1. `f64::ceil` is a call on most processors.
fn least_above(x: f64) -> u32 {
    let below = x as u32;
    below + u32::from(x > f64::from(below))
}

/// Position (u, v) in the distorted image of pixel (x, y) of the ideal pinhole camera; `None` outside the image.
pub fn distorted(camera: &CameraModel, x: usize, y: usize) -> Option<(f64, f64)> {
    let k = camera.intrinsics;
    let (a, b) = camera.distortion.distort((x as f64 - k.cx) / k.fx, (y as f64 - k.cy) / k.fy);
    let (u, v) = (k.fx * a + k.cx, k.fy * b + k.cy);
    let (width, height) = (f64::from(k.width), f64::from(k.height));
    (u >= 0.0 && v >= 0.0 && u < width - 1.0 && v < height - 1.0).then_some((u, v))
}

fn undistort(source: &[u8], camera: &CameraModel) -> Vec<u8> {
    let (w, h) = (camera.intrinsics.width as usize, camera.intrinsics.height as usize);
    let mut out = vec![255; source.len()];
    for y in 0..h {
        for x in 0..w {
            let Some((u, v)) = distorted(camera, x, y) else { continue };
            let (x0, y0) = (u as usize, v as usize);
            let (fu, fv) = (u - x0 as f64, v - y0 as f64);
            for c in 0..3 {
                let at = |dx: usize, dy: usize| f64::from(source[3 * ((y0 + dy) * w + x0 + dx) + c]);
                let corners = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
                let mean = (corners[0] * (1.0 - fu) + corners[1] * fu) * (1.0 - fv)
                    + (corners[2] * (1.0 - fu) + corners[3] * fu) * fv;
                // Interpolating with a clipped value gives a clipped value.
                let clipped = corners.iter().any(|&v| v >= 254.5);
                out[3 * (y * w + x) + c] = if clipped { 255 } else { mean.round() as u8 };
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_least_whole_number_above_is_the_ceiling(x in -0.999_f64..5000.0, whole in 0u32..5000) {
            prop_assert_eq!(f64::from(least_above(x)), x.ceil());
            prop_assert_eq!(least_above(f64::from(whole)), whole);
        }
    }
}
