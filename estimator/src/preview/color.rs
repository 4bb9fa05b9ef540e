//! Colours of the preview: screen values, segments, heat.

use glam::Vec3;
use recordings::types::Response;

/// Linear to screen values.
pub fn display(linear: Vec3) -> [f32; 3] {
    linear.to_array().map(|c| f32::from(Response::Srgb.encode(c)) / 255.0)
}

/// Colours of segments: hues a golden angle apart, so that neighbours in number differ most.
pub fn segment_color(segment: usize) -> Vec3 {
    let hue = (segment as f32 * 0.618_034).fract() * 6.0;
    let lightness = [1.0, 0.78, 0.6][segment % 3];
    let ramp = |offset: f32| (((hue + offset) % 6.0 - 3.0).abs() - 1.0).clamp(0.0, 1.0);
    (Vec3::new(ramp(0.0), ramp(4.0), ramp(2.0)) * 0.7 + 0.3) * lightness
}

/// Dark blue over red to yellow.
pub fn heat(value: f32) -> Vec3 {
    const STOPS: [Vec3; 4] = [
        Vec3::new(0.16, 0.18, 0.38),
        Vec3::new(0.55, 0.16, 0.50),
        Vec3::new(0.93, 0.37, 0.25),
        Vec3::new(1.0, 0.92, 0.5),
    ];
    let x = value.clamp(0.0, 1.0) * 3.0;
    let i = (x as usize).min(2);
    STOPS[i].lerp(STOPS[i + 1], x - i as f32)
}
