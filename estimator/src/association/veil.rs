//! Veiling glare: the lens scatters a share of the picture's light over the picture, so that black things beside a window turn
//! grey. A pixel gets c + s · V, with V the mean of the picture weighted by 1 / (θ² + θ₀²), θ the angle to the pixel
//! (the small-angle part of the CIE glare function; Vos, "On the cause of disability glare", 1984).

use crate::association::keyframe_image::{KeyframeImage, distorted};
use glam::{DVec3, Vec3};
use recordings::types::{CameraModel, Intrinsics};

/// Cells of a picture: V is smooth.
const COLUMNS: usize = 20;
const ROWS: usize = 15;
/// θ₀, radians.
const CORE_RAD: f64 = 0.06;
/// Every so many pixels are read along each axis.
const STRIDE: usize = 3;
/// A colour keeps this share of itself at least.
const LEAST_LEFT: f32 = 0.05;

/// V of one picture, linear RGB before exposure, in cells.
#[derive(Debug, Clone)]
pub struct Veil {
    cells: Vec<Vec3>,
    /// The undistorted picture's camera.
    pub camera: Intrinsics,
    clipped: f64,
}

impl Veil {
    /// The veil of an undistorted picture. `lens` is its camera, `table` maps 8-bit values to linear light; those
    /// from `clipped_from` on are clipped.
    #[must_use]
    pub fn of(image: &KeyframeImage, lens: &CameraModel, table: &[f32; 256], clipped_from: u8) -> Self {
        let k = image.camera;
        let (width, height) = (k.width as usize, k.height as usize);
        let mut sums = vec![(DVec3::ZERO, 0.0); COLUMNS * ROWS];
        let mut clipped = 0.0;
        for y in (0..height).step_by(STRIDE) {
            for x in (0..width).step_by(STRIDE) {
                // Beyond the lens the undistorted picture is white.
                let is_white = image.bytes(x, y) == [255; 3];
                if is_white && distorted(lens, x, y).is_none() {
                    continue;
                }
                if image.is_clipped(x, y, clipped_from) {
                    clipped += 1.0;
                }
                let color = image.bytes(x, y).map(|b| f64::from(table[b as usize]));
                let sum = &mut sums[y * ROWS / height * COLUMNS + x * COLUMNS / width];
                *sum = (sum.0 + DVec3::from_array(color), sum.1 + 1.0);
            }
        }
        let direction = |cell: usize| {
            let u = ((cell % COLUMNS) as f64 + 0.5) * f64::from(k.width) / COLUMNS as f64;
            let v = ((cell / COLUMNS) as f64 + 0.5) * f64::from(k.height) / ROWS as f64;
            DVec3::new((u - k.cx) / k.fx, (v - k.cy) / k.fy, 1.0)
        };
        let directions: Vec<DVec3> = (0..COLUMNS * ROWS).map(|c| direction(c).normalize()).collect();
        let cell = |to: usize| {
            let (mut color, mut total) = (DVec3::ZERO, 0.0);
            for ((sum, count), from) in sums.iter().zip(&directions) {
                // The solid angle of a cell falls with the cube of the cosine to the axis.
                let square = directions[to].distance_squared(*from) + CORE_RAD * CORE_RAD;
                let weight = from.z.powi(3) / square;
                if *count > 0.0 {
                    color += *sum * (weight / count);
                    total += weight;
                }
            }
            (color / f64::max(total, f64::MIN_POSITIVE)).as_vec3()
        };
        let read: f64 = sums.iter().map(|(_, count)| count).sum();
        Self { cells: (0..COLUMNS * ROWS).map(cell).collect(), camera: k, clipped: clipped / f64::max(read, 1.0) }
    }

    /// Share of the picture that is clipped, 0 to 1: its light is unknown.
    #[must_use]
    pub fn clipped(&self) -> f64 {
        self.clipped
    }

    /// V at a pixel.
    #[must_use]
    pub fn at(&self, u: f64, v: f64) -> Vec3 {
        let place = |x: f64, size: u32, cells: usize| {
            let at = ((x + 0.5) / f64::from(size) * cells as f64 - 0.5).clamp(0.0, cells as f64 - 1.0);
            let low = (at as usize).min(cells - 2);
            (low, (at - low as f64) as f32)
        };
        let (x, fx) = place(u, self.camera.width, COLUMNS);
        let (y, fy) = place(v, self.camera.height, ROWS);
        let row = |y: usize| self.cells[y * COLUMNS + x].lerp(self.cells[y * COLUMNS + x + 1], fx);
        row(y).lerp(row(y + 1), fy)
    }

    /// V over a point of the camera's frame.
    #[must_use]
    pub fn over(&self, p: DVec3) -> Vec3 {
        let (u, v) = self.camera.project(p);
        self.at(u, v)
    }
}

/// A colour without this veil.
#[must_use]
pub fn without(color: Vec3, veil: Vec3) -> Vec3 {
    (color - veil).max(color * LEAST_LEFT)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::association::vignetting::Vignetting;
    use recordings::types::Distortion;

    /// A picture of `width` × `height` pixels; `white` tells which are white.
    fn veil(white: impl Fn(u32, u32) -> bool) -> Veil {
        let (width, height) = (160, 120);
        let camera = Intrinsics { width, height, fx: 130.0, fy: 130.0, cx: 79.5, cy: 59.5 };
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let data = pixels.flat_map(|(x, y)| [if white(x, y) { 255 } else { 0 }; 3]).collect();
        let table = std::array::from_fn(|i| i as f32 / 255.0);
        Veil::of(
            &KeyframeImage { camera, data, vignetting: Vignetting::default() },
            &CameraModel { intrinsics: camera, distortion: Distortion::NONE },
            &table,
            250,
        )
    }

    #[test]
    fn an_even_picture_is_its_own_veil() {
        let veil = veil(|_, _| true);
        for (u, v) in [(0.0, 0.0), (80.0, 60.0), (159.0, 119.0)] {
            assert!((veil.at(u, v) - Vec3::ONE).abs().max_element() < 1e-5, "{}", veil.at(u, v));
        }
    }

    #[test]
    fn a_window_veils_what_is_beside_it_most() {
        let veil = veil(|x, _| x >= 120);
        let [near, middle, far] = [110.0, 70.0, 10.0].map(|u| veil.at(u, 60.0).y);
        assert!(near > 1.5 * middle && middle > 1.2 * far && far > 0.0, "{near} {middle} {far}");
        // The weights are normalised: the mean light is kept within what the borders change.
        assert!(veil.at(140.0, 60.0).y < 1.0);
        assert!((veil.clipped() - 0.25).abs() < 0.01, "{}", veil.clipped());
    }

    #[test]
    fn no_colour_gets_black_or_negative() {
        let left = without(Vec3::new(0.1, 0.02, 0.0), Vec3::splat(0.05));
        assert!((left - Vec3::new(0.05, 0.001, 0.0)).abs().max_element() < 1e-6, "{left}");
    }
}
