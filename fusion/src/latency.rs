//! How late depth is against colour beyond its stamps, found while the camera moves: geometry then pulls the pose back
//! along the motion, the picture does not.

use crate::track::Terms;
use firmware_config::FusionConfig;
use nalgebra::Vector6;

/// Frames after which corrections have halved.
const SETTLING_FRAMES: f64 = 150.0;
/// Information about the delay (1/s²) at which a frame counts half: what is not modelled outweighs what is.
const HALF_INFORMATION: f64 = 5e6;
/// Most that one frame may say, seconds.
const MOST_PER_FRAME_S: f64 = 0.005;

/// The running estimate.
#[derive(Debug, Default)]
pub struct Latency {
    frames: f64,
    seconds: f64,
}

impl Latency {
    /// Seconds by which depth was taken earlier than its stamp says, against colour.
    pub fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Learns from a frame that was aligned while the camera moved by `velocity` (twist per second, camera axes).
    ///
    /// Depth that is τ too late has its points moved by −τ·velocity too little: geometry's residuals are r + J (δ − τ v),
    /// the picture's r + J δ. With the pose δ eliminated, one equation for τ is left.
    pub fn learn(&mut self, terms: &Terms, velocity: &Vector6<f64>, config: &FusionConfig) {
        let v = velocity.component_div(&terms.scale.map(|s| s.max(1e-9)));
        let ((geo, b_geo), (photo, b_photo)) = (terms.geometric, terms.photometric);
        let Some(joint) = (geo + photo).cholesky() else { return };
        let pulled = geo * v;
        let pose = joint.solve(&pulled);
        let information = v.dot(&pulled) - pose.dot(&pulled);
        let evidence = pose.dot(&(b_geo + b_photo)) - v.dot(&b_geo);
        if !(information > 1.0 && evidence.is_finite()) {
            return;
        }
        let said = (evidence / information).clamp(-MOST_PER_FRAME_S, MOST_PER_FRAME_S);
        let trust = information / (information + HALF_INFORMATION);
        let gain = config.latency_gain * SETTLING_FRAMES / (SETTLING_FRAMES + self.frames);
        let limit = config.max_latency_ms * 1e-3;
        self.seconds = (self.seconds + gain * trust * said).clamp(-limit, limit);
        self.frames += 1.0;
    }
}
