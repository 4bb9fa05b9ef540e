//! Vignetting: a lens brings less light to the picture the farther off its axis. A pixel gets c · exp(−v ρ²), with ρ its distance from
//! the principal point in half diagonals of the picture and v one number of the camera. A keyframe's gain is that of the axis.

use recordings::types::Intrinsics;

/// What the corners of all pictures lack.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Vignetting {
    /// v: exp(−v) is left in the corners.
    pub strength: f64,
}

impl Vignetting {
    /// exp(−v ρ²) at a pixel.
    #[must_use]
    pub fn shade(&self, camera: &Intrinsics, u: f64, v: f64) -> f32 {
        // Most cameras have none, and every pixel asks.
        if self.strength == 0.0 {
            return 1.0;
        }
        libm::expf(-(self.strength * off_axis(camera, u, v)) as f32)
    }
}

/// ρ² of a pixel.
#[must_use]
pub fn off_axis(camera: &Intrinsics, u: f64, v: f64) -> f64 {
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    4.0 * ((u - camera.cx).powi(2) + (v - camera.cy).powi(2)) / (width * width + height * height)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_have_what_the_strength_says() {
        let camera = Intrinsics { width: 640, height: 480, fx: 525.0, fy: 525.0, cx: 320.0, cy: 240.0 };
        let vignetting = Vignetting { strength: 0.2 };
        assert_eq!(vignetting.shade(&camera, 320.0, 240.0), 1.0);
        assert!((f64::from(vignetting.shade(&camera, 0.0, 0.0)) - libm::exp(-0.2)).abs() < 1e-6);
    }
}
