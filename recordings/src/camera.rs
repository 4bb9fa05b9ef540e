//! Camera mathematics: Brown–Conrady distortion there and back, and the response curve.

use crate::shoulder::{compressed, expanded};
use crate::types::{CameraModel, Distortion, Intrinsics, Response};
use glam::DVec3;
use std::sync::LazyLock;

/// Newton steps at most; three do for real lenses.
const UNDISTORT_STEPS: usize = 20;
/// Normalised image units (times the focal length: pixels) at which the iteration stops.
const UNDISTORT_TOLERANCE: f64 = 1e-13;

impl Distortion {
    /// No distortion.
    pub const NONE: Self = Self { k1: 0.0, k2: 0.0, p1: 0.0, p2: 0.0, k3: 0.0 };

    /// True where nothing is distorted.
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Self::NONE
    }

    /// Where an ideal normalised image point (X/Z, Y/Z) comes to lie through the lens.
    #[must_use]
    pub fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        (
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// The inverse of [`Distortion::distort`], by Newton's method. Where the polynomial has no inverse (far outside
    /// the picture it was fitted to) the answer is finite but means nothing.
    #[must_use]
    pub fn undistort(&self, xd: f64, yd: f64) -> (f64, f64) {
        if self.is_none() {
            return (xd, yd);
        }
        let (mut x, mut y) = (xd, yd);
        for _ in 0..UNDISTORT_STEPS {
            let (fx, fy) = self.distort(x, y);
            let (ex, ey) = (fx - xd, fy - yd);
            let r2 = x * x + y * y;
            let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
            let slope = 2.0 * (self.k1 + r2 * (2.0 * self.k2 + 3.0 * r2 * self.k3));
            let jxx = radial + slope * x * x + 2.0 * self.p1 * y + 6.0 * self.p2 * x;
            let jxy = slope * x * y + 2.0 * self.p1 * x + 2.0 * self.p2 * y;
            let jyy = radial + slope * y * y + 6.0 * self.p1 * y + 2.0 * self.p2 * x;
            let determinant = jxx * jyy - jxy * jxy;
            let (dx, dy) = ((jyy * ex - jxy * ey) / determinant, (jxx * ey - jxy * ex) / determinant);
            if !(x - dx).is_finite() || !(y - dy).is_finite() {
                break;
            }
            (x, y) = (x - dx, y - dy);
            if dx.abs().max(dy.abs()) < UNDISTORT_TOLERANCE {
                break;
            }
        }
        (x, y)
    }

    /// True if the radial polynomial rises all the way from the centre to squared radius `r2`; beyond that it folds
    /// back and would draw points into the picture that the lens never showed.
    fn is_monotone_to(&self, r2: f64) -> bool {
        // d(r radial)/dr as a polynomial in s = r².
        let rise = |s: f64| 1.0 + s * (3.0 * self.k1 + s * (5.0 * self.k2 + s * 7.0 * self.k3));
        let (a, b, c) = (21.0 * self.k3, 10.0 * self.k2, 3.0 * self.k1);
        let discriminant = b * b - 4.0 * a * c;
        let extrema = if a != 0.0 && discriminant > 0.0 {
            let root = discriminant.sqrt();
            [(-b - root) / (2.0 * a), (-b + root) / (2.0 * a)]
        } else if a == 0.0 && b != 0.0 {
            [-c / b; 2]
        } else {
            [0.0; 2]
        };
        rise(r2) > 0.0 && extrema.iter().all(|&s| s <= 0.0 || s >= r2 || rise(s) > 0.0)
    }
}

impl Intrinsics {
    /// Pixel (u, v) of a point in the frame of a camera without distortion, whether in front of it and inside the picture or not.
    #[must_use]
    pub fn project(&self, point: DVec3) -> (f64, f64) {
        (self.fx * point.x / point.z + self.cx, self.fy * point.y / point.z + self.cy)
    }

    /// Mean focal length of both axes in pixels, not negative.
    #[must_use]
    pub fn focal(&self) -> f64 {
        0.5 * (self.fx.abs() + self.fy.abs())
    }
}

impl CameraModel {
    /// A pinhole of the same intrinsics without distortion.
    #[must_use]
    pub fn undistorted(&self) -> Self {
        Self { intrinsics: self.intrinsics, distortion: Distortion::NONE }
    }

    /// Pixel (u, v) of a point in the camera's frame, whether inside the picture or not. `None` if the point is not
    /// in front of the camera, or so far to the side that the lens model folds back.
    #[must_use]
    pub fn project(&self, point: DVec3) -> Option<(f64, f64)> {
        if !(point.z > 0.0 && point.is_finite()) {
            return None;
        }
        let (mut x, mut y) = (point.x / point.z, point.y / point.z);
        if !self.distortion.is_none() {
            if !self.distortion.is_monotone_to(x * x + y * y) {
                return None;
            }
            (x, y) = self.distortion.distort(x, y);
        }
        let i = &self.intrinsics;
        Some((i.fx * x + i.cx, i.fy * y + i.cy))
    }

    /// The ray through pixel (u, v) in the camera's frame, scaled to z = 1.
    #[must_use]
    pub fn unproject(&self, u: f64, v: f64) -> DVec3 {
        let i = &self.intrinsics;
        let (x, y) = self.distortion.undistort((u - i.cx) / i.fx, (v - i.cy) / i.fy);
        DVec3::new(x, y, 1.0)
    }

    /// What makes this camera unusable, if anything.
    pub(crate) fn problem(&self) -> Option<&'static str> {
        let (i, d) = (&self.intrinsics, &self.distortion);
        if i.width == 0 || i.height == 0 || i.width > MAX_SIDE || i.height > MAX_SIDE {
            Some("image size outside 1 … 16384 pixels")
        } else if ![i.fx, i.fy, i.cx, i.cy, d.k1, d.k2, d.p1, d.p2, d.k3].iter().all(|x| x.is_finite()) {
            Some("a value is not finite")
        } else if i.fx <= 0.0 || i.fy <= 0.0 {
            Some("focal length not positive")
        } else {
            None
        }
    }
}

/// Longest image side that is accepted, in pixels.
pub(crate) const MAX_SIDE: u32 = 16_384;

impl Response {
    /// Linear light of the largest value.
    #[must_use]
    pub fn full_scale(&self) -> f64 {
        if let Self::Shoulder(strength) = *self { expanded(1.0, strength) } else { 1.0 }
    }

    /// Linear light of an encoded value, whose full scale is 1; `value` must not be negative.
    #[must_use]
    pub fn linear_from_value(&self, value: f64) -> f64 {
        match *self {
            Self::Srgb if value <= 0.04045 => value / 12.92,
            Self::Srgb => libm::pow((value + 0.055) / 1.055, 2.4),
            Self::Linear => value,
            Self::Gamma(gamma) => libm::pow(value, gamma),
            Self::Shoulder(strength) => expanded(Self::Srgb.linear_from_value(value), strength),
        }
    }

    /// Encoded value, of full scale 1, of linear light; `linear` must not be negative.
    #[must_use]
    pub fn value_from_linear(&self, linear: f64) -> f64 {
        match *self {
            Self::Srgb if linear <= 0.003_130_8 => 12.92 * linear,
            Self::Srgb => 1.055 * libm::pow(linear, 1.0 / 2.4) - 0.055,
            Self::Linear => linear,
            Self::Gamma(gamma) => libm::pow(linear, 1.0 / gamma),
            Self::Shoulder(strength) => Self::Srgb.value_from_linear(compressed(linear, strength)),
        }
    }

    /// Linear light (0 to [`full_scale`](Self::full_scale)) of an 8-bit value.
    #[must_use]
    pub fn linearise(&self, value: u8) -> f32 {
        self.linear_from_value(f64::from(value) / 255.0) as f32
    }

    /// [`Response::linearise`] of every 8-bit value.
    #[must_use]
    pub fn linear_table(&self) -> [f32; 256] {
        std::array::from_fn(|value| self.linearise(value as u8))
    }

    /// The nearest 8-bit value of linear light, clipped to 0 and the full scale; NaN becomes 0.
    #[must_use]
    pub fn encode(&self, linear: f32) -> u8 {
        match *self {
            Self::Srgb => SRGB_STEPS.value(linear),
            Self::Shoulder(strength) => {
                let linear = f64::from(linear).clamp(0.0, self.full_scale());
                SRGB_STEPS.value(compressed(linear, strength) as f32)
            }
            Self::Linear | Self::Gamma(_) => self.rounded(linear),
        }
    }

    /// [`Response::encode`] by its definition.
    fn rounded(&self, linear: f32) -> u8 {
        (255.0 * self.value_from_linear(f64::from(linear).clamp(0.0, 1.0))).round() as u8
    }
}

/// 8-bit sRGB of linear light by comparison: pictures and textures have millions of values, and a power costs 50 ns.
static SRGB_STEPS: LazyLock<Steps> = LazyLock::new(|| Steps::new(&Response::Srgb));

/// Parts of 0..1 whose first value is looked up.
const CELLS: usize = 4096;

struct Steps {
    /// The least linear light of each 8-bit value; nothing reaches the last one.
    least: [f32; 257],
    /// The 8-bit value at the beginning of each cell.
    first: [u8; CELLS + 1],
}

impl Steps {
    fn new(response: &Response) -> Self {
        let mut least = [f32::INFINITY; 257];
        for (value, least) in least.iter_mut().take(256).enumerate() {
            // Light is not negative, so its bits are in its order.
            let (mut low, mut high) = (0, 1.0f32.to_bits());
            while low < high {
                let middle = low.midpoint(high);
                if usize::from(response.rounded(f32::from_bits(middle))) >= value {
                    high = middle
                } else {
                    low = middle + 1
                }
            }
            *least = f32::from_bits(low);
        }
        Self { least, first: std::array::from_fn(|cell| response.rounded(cell as f32 / CELLS as f32)) }
    }

    fn value(&self, linear: f32) -> u8 {
        let linear = linear.clamp(0.0, 1.0);
        // NaN is cell 0, and reaches nothing.
        let mut value = self.first[(linear * CELLS as f32) as usize];
        while linear >= self.least[usize::from(value) + 1] {
            value += 1;
        }
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn srgb_by_comparison_is_srgb_by_its_formula() {
        let limits = SRGB_STEPS.least.iter().take(256).flat_map(|x| [x.next_down(), *x, x.next_up()]);
        let between = (0..=100_000).map(|i| i as f32 / 100_000.0);
        for x in limits.chain(between).chain([f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, 2.0, -0.0]) {
            assert_eq!(Response::Srgb.encode(x), Response::Srgb.rounded(x), "{x}");
        }
    }

    fn fr1() -> CameraModel {
        CameraModel {
            intrinsics: Intrinsics { width: 640, height: 480, fx: 517.3, fy: 516.5, cx: 318.6, cy: 255.3 },
            distortion: Distortion { k1: 0.2624, k2: -0.9531, p1: -0.0054, p2: 0.0026, k3: 1.1633 },
        }
    }

    #[test]
    fn distortion_agrees_with_a_value_worked_by_hand() {
        // x = 0.3, y = -0.2: r² = 0.13, radial = 1 + 0.13·0.2624 − 0.0169·0.9531 + 0.002197·1.1633.
        let (x, y) = fr1().distortion.distort(0.3, -0.2);
        assert!((x - 0.307_622_114_03).abs() < 1e-9, "{x}");
        assert!((y + 0.205_558_076_02).abs() < 1e-9, "{y}");
    }

    #[test]
    fn every_corner_comes_back() {
        let camera = fr1();
        for (u, v) in [(0.0, 0.0), (639.0, 0.0), (0.0, 479.0), (639.0, 479.0), (318.6, 255.3)] {
            let (u2, v2) = camera.project(camera.unproject(u, v) * 2.5).unwrap();
            assert!((u - u2).abs() < 1e-9 && (v - v2).abs() < 1e-9, "{u} {v} → {u2} {v2}");
        }
    }

    #[test]
    fn points_behind_or_beyond_the_fold_are_not_projected() {
        let mut camera = fr1();
        assert_eq!(camera.project(DVec3::new(0.0, 0.0, -1.0)), None);
        assert_eq!(camera.project(DVec3::new(0.0, 0.0, 0.0)), None);
        assert_eq!(camera.project(DVec3::new(f64::NAN, 0.0, 1.0)), None);
        camera.distortion = Distortion { k1: -0.3, ..Distortion::NONE };
        assert!(camera.project(DVec3::new(0.9, 0.0, 1.0)).is_some());
        assert_eq!(camera.project(DVec3::new(1.2, 0.0, 1.0)), None);
    }

    #[test]
    fn srgb_and_gamma_come_back() {
        for response in [Response::Srgb, Response::Linear, Response::Gamma(2.2), Response::Shoulder(0.9)] {
            let table = response.linear_table();
            assert_eq!((table[0], table[255]), (0.0, response.full_scale() as f32));
            for v in 0..=255u8 {
                assert_eq!(response.encode(table[v as usize]), v, "{response:?}");
            }
            assert_eq!((response.encode(-1.0), response.encode(9.0), response.encode(f32::NAN)), (0, 255, 0));
        }
        assert!((Response::Srgb.linearise(128) - 0.215_860_5).abs() < 1e-6);
    }

    proptest! {
        #[test]
        fn undistort_inverts_distort(
            x in -0.7f64..0.7, y in -0.55f64..0.55, k1 in -0.2f64..0.3, k2 in -0.1f64..0.1, p1 in -0.01f64..0.01, p2 in -0.01f64..0.01,
        ) {
            let d = Distortion { k1, k2, p1, p2, k3: 0.0 };
            let (xd, yd) = d.distort(x, y);
            let (x2, y2) = d.undistort(xd, yd);
            prop_assert!((x - x2).abs() < 1e-9 && (y - y2).abs() < 1e-9);
        }
    }
}
