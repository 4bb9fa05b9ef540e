//! Noise model of the depth sensor: the only one of the program.

use crate::settings::section;

section! {
    /// Noise of the depth sensor, σ_z = floor_m + quadratic · (z − nearest_m)²; the default is the Kinect V1 (Nguyen, Izadi, Lovell 2012). A table `[depth_noise.SERIAL]` overrides these values for one sensor.
    DepthNoiseTuning = "depth_noise" {
        /// Standard deviation at the distance of least noise; a table [depth_noise.SERIAL] overrides this section for one sensor. Source: Nguyen, Izadi, Lovell 2012.
        floor_m: f64 = 0.0012, [0.000001..=1.0], "m", "σ_z";
        /// Growth of the standard deviation with the squared distance. Source: Nguyen, Izadi, Lovell 2012.
        quadratic: f64 = 0.0019, [0.0..=1.0], "1/m", "σ_z";
        /// Distance of least noise. Source: Nguyen, Izadi, Lovell 2012.
        nearest_m: f64 = 0.4, [0.0..=10.0], "m", "σ_z";
    }
}

impl DepthNoiseTuning {
    /// The model in single precision, for inner loops.
    #[must_use]
    pub fn model(&self) -> DepthNoise {
        let far = 1.0 - self.nearest_m;
        DepthNoise {
            floor_m: self.floor_m as f32,
            quadratic: self.quadratic as f32,
            nearest_m: self.nearest_m as f32,
            at_1m: (self.floor_m + self.quadratic * far * far) as f32,
        }
    }
}

/// Standard deviation of depth as a function of depth, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthNoise {
    floor_m: f32,
    quadratic: f32,
    nearest_m: f32,
    /// Standard deviation at 1 m, metres.
    pub at_1m: f32,
}

impl DepthNoise {
    /// σ_z at `z_m`, in metres.
    #[inline(always)]
    #[must_use]
    pub fn sigma_m(&self, z_m: f32) -> f32 {
        let d = z_m - self.nearest_m;
        self.floor_m + self.quadratic * d * d
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_the_kinects_model() {
        let noise = DepthNoiseTuning::default().model();
        assert_eq!(noise.at_1m, 0.001884);
        for z in [0.4f32, 0.7, 1.0, 2.5, 4.0] {
            let d = z - 0.4;
            assert_eq!(noise.sigma_m(z), 0.0012 + 0.0019 * d * d);
        }
    }
}
