//! Colours of the preview: screen values, segments, heat.

use crate::numerics::cielab::luminance;
use crate::numerics::robust::quantile;
use glam::Vec3;
use recordings::types::Response;

/// Linear value of the median of light.
const MID_GREY: f32 = 0.22;

/// Linear to screen values.
pub fn display(linear: Vec3) -> [f32; 3] {
    linear.to_array().map(|c| f32::from(Response::Srgb.encode(c)) / 255.0)
}

/// How light itself is shown: lamps and dim walls differ by more than a screen does, so bright light is compressed, its colour kept.
#[derive(Debug, Clone, Copy)]
pub struct LightExposure {
    gain: f32,
    /// Luminance after the gain that is shown white.
    white: f32,
}

impl LightExposure {
    /// For radiance over all directions: its median is shown as mid-grey, its 99.5 % quantile as white.
    #[must_use]
    pub fn of(radiance: &[Vec3]) -> Self {
        let level =
            |share: f64| quantile(radiance.iter().map(|r| luminance(*r)), share).unwrap_or(0.0).max(f32::MIN_POSITIVE);
        let gain = MID_GREY / level(0.5);
        Self { gain, white: (level(0.995) * gain).max(1.0) }
    }

    /// Display value of radiance: Reinhard's operator with a white point (Reinhard et al., "Photographic Tone Reproduction for
    /// Digital Images", SIGGRAPH 2002), on luminance.
    #[must_use]
    pub fn display(&self, radiance: Vec3) -> [f32; 3] {
        let exposed = radiance.max(Vec3::ZERO) * self.gain;
        let level = luminance(exposed);
        let shown = exposed * ((1.0 + level / (self.white * self.white)) / (1.0 + level));
        display(shown.min(Vec3::ONE))
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lamps_and_dim_walls_are_both_seen() {
        // A room of luminance 5 with a window forty times and a lamp a thousand times as bright.
        let mut light = vec![Vec3::splat(5.0); 950];
        light.extend([Vec3::splat(200.0); 40]);
        light.extend([Vec3::splat(5000.0); 10]);
        let exposure = LightExposure::of(&light);
        let [wall, window, lamp] = [5.0, 200.0, 5000.0].map(|l| exposure.display(Vec3::splat(l))[0]);
        assert!(wall > 0.35 && wall < 0.6 && window > 0.85 && window < lamp && lamp >= 0.99, "{wall} {window} {lamp}");
        let orange = exposure.display(Vec3::new(100.0, 50.0, 10.0));
        assert!(orange[0] > orange[1] && orange[1] > 2.0 * orange[2], "{orange:?}");
    }
}
