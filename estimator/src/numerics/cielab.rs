//! CIELAB (D65 white) of linear RGB with Rec. 709 primaries.

use glam::Vec3;

/// Weights of R, G and B in the relative luminance (Rec. 709).
const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Relative luminance Y.
#[must_use]
pub fn luminance(c: Vec3) -> f32 {
    c.dot(Vec3::from(LUMINANCE.map(|x| x as f32)))
}

/// Relative luminance Y, of what is not in single precision.
#[must_use]
pub fn luminance_f64(rgb: &[f64; 3]) -> f64 {
    (0..3).map(|c| LUMINANCE[c] * rgb[c]).sum()
}

/// L*, 0 … 100, of a relative luminance.
#[must_use]
pub fn lightness(y: f32) -> f32 {
    116.0 * curve(y) - 16.0
}

/// (L*, a*, b*).
#[must_use]
pub fn lab(c: Vec3) -> Vec3 {
    let x = c.dot(Vec3::new(0.4124, 0.3576, 0.1805)) / 0.9505;
    let y = luminance(c);
    let z = c.dot(Vec3::new(0.0193, 0.1192, 0.9505)) / 1.089;
    let (fx, fy, fz) = (curve(x), curve(y), curve(z));
    Vec3::new(116.0 * fy - 16.0, 500.0 * (fx - fy), 200.0 * (fy - fz))
}

fn curve(t: f32) -> f32 {
    if t > 0.008_856 { libm::cbrtf(t) } else { 7.787 * t + 16.0 / 116.0 }
}
