//! Thresholds of the estimation of delay and read-out time.

use crate::settings::section;

section! {
    /// Delay of depth against colour, and rolling shutter.
    TimingTuning = "timing" {
        /// Frames over which the velocity is averaged that moves depth to the colour image's instant. Source: tuned by hand on recordings.
        velocity_frames: u32 = 4, [1..=60], "frames", "";
        /// Slowest motion from which delay and read-out time are estimated. Source: tuned by hand on recordings.
        min_speed_m_s: f64 = 0.03, [0.0..=10.0], "m/s", "";
        /// Longest time between the images of a pair that motion compensates; 0 is taken beyond it. Source: three frame times.
        max_stamp_gap_s: f64 = 0.1, [0.0..=1.0], "s", "";
        /// All rows count as simultaneous while motion shifts them by less than this between the middle and the last row. Source: tuned by hand on recordings.
        min_row_shift_px: f64 = 0.2, [0.0..=10.0], "px", "";
        /// Information at which a frame has half of its full weight: model errors exceed noise beyond it. Source: tuned by hand on recordings.
        half_information: f64 = 5e6, [1.0..=1e12], "1/s²", "";
        /// Gain of the delay estimate at the first frame. Source: tuned by hand on recordings.
        delay_gain: f64 = 0.2, [0.0..=1.0], "", "";
        /// Weighted frames after which the gain of the delay estimate has halved. Source: tuned by hand on recordings.
        delay_settling_frames: f64 = 150.0, [1.0..=10000.0], "frames", "";
        /// Largest change of the delay that one frame may ask for. Source: tuned by hand on recordings.
        delay_max_step_s: f64 = 0.005, [0.0..=0.1], "s", "";
        /// Gain of the read-out estimate at the first frame; high because sheared rows already fused stay in the surface. Source: tuned by hand on recordings.
        readout_gain: f64 = 1.0, [0.0..=1.0], "", "";
        /// Weighted frames after which the gain of the read-out estimate has halved. Source: tuned by hand on recordings.
        readout_settling_frames: f64 = 30.0, [1.0..=10000.0], "frames", "";
        /// Largest change of the read-out time that one frame may ask for. Source: tuned by hand on recordings.
        readout_max_step_s: f64 = 0.015, [0.0..=0.1], "s", "";
    }
}
