//! How late depth is against colour beyond its stamps, and how long an image's rows take from the first to the last, found
//! while the camera moves: geometry then pulls the pose back along the motion and the picture does not, and the rows
//! disagree with each other.

use crate::tracking::align::TimingSystem;
use firmware_config::FusionConfig;
use nalgebra::{SMatrix, Vector2};

/// Information (1/s²) at which a frame counts half: what is not modelled outweighs what is.
const HALF_INFORMATION: f64 = 5e6;

/// How fast an estimate follows what the frames say.
struct Pace {
    /// Share of it that the first frame is followed by.
    first: f64,
    /// Frames, as much as they are trusted, after which that share has halved.
    settling: f64,
    /// Most that one frame may say, seconds.
    most_s: f64,
}

const DELAY: Pace = Pace { first: 0.2, settling: 150.0, most_s: 0.005 };
/// What rows sheared by a fast turn have done to the surface is not undone: its first frames tell most.
const READOUT: Pace = Pace { first: 1.0, settling: 30.0, most_s: 0.015 };

/// The running estimate.
#[derive(Debug, Default, Clone, Copy)]
pub struct Timing {
    /// Seconds by which depth was taken earlier than its stamp says, against colour.
    pub delay_s: f64,
    /// Seconds from the first row of an image to its last; negative where images are stored upside down or played backwards.
    pub readout_s: f64,
    /// Frames followed so far, as much as they were trusted, for either.
    followed: [f64; 2],
}

impl Timing {
    /// Learns from a frame that was aligned while the camera moved.
    pub fn learn(&mut self, system: &TimingSystem, config: &FusionConfig) {
        // The pose eliminated, two equations are left.
        let pose = system.h.fixed_view::<6, 6>(0, 0).into_owned();
        let coupling = system.h.fixed_view::<6, 2>(0, 6).into_owned();
        let Some(pose) = pose.cholesky() else { return };
        let h = system.h.fixed_view::<2, 2>(6, 6) - coupling.transpose() * pose.solve(&coupling);
        let rhs = system.b.fixed_rows::<6>(0).into_owned();
        let b = system.b.fixed_rows::<2>(6) - coupling.transpose() * pose.solve(&rhs);
        let Some(inverse) = (h + SMatrix::<f64, 2, 2>::identity()).try_inverse() else { return };
        let said: Vector2<f64> = inverse * b;
        if !(said.iter().all(|s| s.is_finite()) && inverse.diagonal().min() > 0.0) {
            return;
        }
        tracing::trace!(?said, ?inverse, ?self, "instants");
        let mut step = |i: usize, pace: &Pace| {
            let information = 1.0 / inverse[(i, i)];
            let trust = information / (information + HALF_INFORMATION);
            let gain = config.timing_gain * pace.first * pace.settling / (pace.settling + self.followed[i]);
            self.followed[i] += trust;
            gain * trust * said[i].clamp(-pace.most_s, pace.most_s)
        };
        let (delay, readout) = (step(0, &DELAY), step(1, &READOUT));
        let (late, longest) = (config.max_latency_ms * 1e-3, config.max_readout_ms * 1e-3);
        self.delay_s = (self.delay_s + delay).clamp(-late, late);
        self.readout_s = (self.readout_s + readout).clamp(-longest, longest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::SVector;

    /// Residuals by pose, delay and read-out time drawn at random, without noise: both are found, and nothing is learnt where
    /// they cannot be told from the pose.
    #[test]
    fn delay_and_readout_are_found_where_they_show() {
        let mut state = 1u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1 << 30) - 1.0
        };
        let config = FusionConfig::default();
        for shows in [true, false] {
            let mut timing = Timing::default();
            for _ in 0..200 {
                let truth = [0.012 - timing.delay_s, 0.025 - timing.readout_s];
                let mut system = TimingSystem { h: SMatrix::zeros(), b: SVector::zeros() };
                for _ in 0..100 {
                    let mut j = SVector::<f64, 8>::from_fn(|_, _| 1e3 * random());
                    if !shows {
                        (j[6], j[7]) = (j[0], j[1]);
                    }
                    let residual = -(j[6] * truth[0] + j[7] * truth[1] + 0.002 * j[3]);
                    system.h += j * j.transpose();
                    system.b -= j * residual;
                }
                timing.learn(&system, &config);
            }
            let found = [timing.delay_s, timing.readout_s];
            let expected = if shows { [0.012, 0.025] } else { [0.0, 0.0] };
            assert!(found.iter().zip(expected).all(|(f, e)| (f - e).abs() < 1e-3), "{found:?}");
        }
    }
}
