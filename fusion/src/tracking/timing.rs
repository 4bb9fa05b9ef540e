//! Estimation of two delays while the camera moves: that of depth against colour beyond the time stamps (geometry and image
//! disagree along the motion), and the read-out time of an image (the rows disagree with each other).

use crate::tracking::timing_system::TimingSystem;
use firmware_config::FusionConfig;
use nalgebra::{SMatrix, Vector2};

/// Speed of an estimate.
struct Pace {
    /// Gain of the first frame.
    gain: f64,
    /// Weighted frames after which the gain has halved.
    settling_frames: f64,
    /// Largest change by one frame, seconds.
    max_step_s: f64,
}

/// The current estimate.
#[derive(Debug, Default, Clone, Copy)]
pub struct Timing {
    /// Time by which depth was taken earlier than its stamp, against colour, seconds.
    pub delay_s: f64,
    /// Time from the first row of an image to its last row, seconds; negative for images stored upside down or played backwards.
    pub readout_s: f64,
    /// Sum of the weights of the frames so far, `[delay, read-out]`.
    followed: [f64; 2],
}

impl Timing {
    /// Updates the estimate by a frame that was aligned while the camera moved.
    pub fn update(&mut self, system: &TimingSystem, config: &FusionConfig) {
        // Two equations are left after elimination of the pose.
        let pose = system.h.fixed_view::<6, 6>(0, 0).into_owned();
        let coupling = system.h.fixed_view::<6, 2>(0, 6).into_owned();
        let Some(pose) = pose.cholesky() else { return };
        let h = system.h.fixed_view::<2, 2>(6, 6) - coupling.transpose() * pose.solve(&coupling);
        let rhs = system.b.fixed_rows::<6>(0).into_owned();
        let b = system.b.fixed_rows::<2>(6) - coupling.transpose() * pose.solve(&rhs);
        let Some(inverse) = (h + SMatrix::<f64, 2, 2>::identity()).try_inverse() else { return };
        let asked: Vector2<f64> = inverse * b;
        if !(asked.iter().all(|s| s.is_finite()) && inverse.diagonal().min() > 0.0) {
            return;
        }
        tracing::trace!(?asked, ?inverse, ?self, "timing");
        let tuning = &config.tuning.timing;
        let delay_pace = Pace {
            gain: tuning.delay_gain,
            settling_frames: tuning.delay_settling_frames,
            max_step_s: tuning.delay_max_step_s,
        };
        let readout_pace = Pace {
            gain: tuning.readout_gain,
            settling_frames: tuning.readout_settling_frames,
            max_step_s: tuning.readout_max_step_s,
        };
        let mut step = |i: usize, pace: &Pace| {
            let information = 1.0 / inverse[(i, i)];
            let weight = information / (information + tuning.half_information);
            let gain =
                config.timing_gain * pace.gain * pace.settling_frames / (pace.settling_frames + self.followed[i]);
            self.followed[i] += weight;
            gain * weight * asked[i].clamp(-pace.max_step_s, pace.max_step_s)
        };
        let (delay, readout) = (step(0, &delay_pace), step(1, &readout_pace));
        let (max_delay, max_readout) = (config.max_latency_ms * 1e-3, config.max_readout_ms * 1e-3);
        self.delay_s = (self.delay_s + delay).clamp(-max_delay, max_delay);
        self.readout_s = (self.readout_s + readout).clamp(-max_readout, max_readout);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::SVector;

    /// Random residuals of pose, delay and read-out time, without noise: both are found, and nothing changes where they cannot
    /// be distinguished from the pose.
    #[test]
    fn delay_and_readout_are_found_where_they_are_observable() {
        let mut state = 1u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1 << 30) - 1.0
        };
        let config = FusionConfig::default();
        for observable in [true, false] {
            let mut timing = Timing::default();
            for _ in 0..200 {
                let truth = [0.012 - timing.delay_s, 0.025 - timing.readout_s];
                let mut system = TimingSystem { h: SMatrix::zeros(), b: SVector::zeros() };
                for _ in 0..100 {
                    let mut j = SVector::<f64, 8>::from_fn(|_, _| 1e3 * random());
                    if !observable {
                        (j[6], j[7]) = (j[0], j[1]);
                    }
                    let residual = -(j[6] * truth[0] + j[7] * truth[1] + 0.002 * j[3]);
                    system.h += j * j.transpose();
                    system.b -= j * residual;
                }
                timing.update(&system, &config);
            }
            let found = [timing.delay_s, timing.readout_s];
            let expected = if observable { [0.012, 0.025] } else { [0.0, 0.0] };
            assert!(found.iter().zip(expected).all(|(f, e)| (f - e).abs() < 1e-3), "{found:?}");
        }
    }
}
