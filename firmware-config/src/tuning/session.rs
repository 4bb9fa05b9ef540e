//! Thresholds of a streaming session.

use crate::settings::section;

section! {
    /// A streaming session of the Kinect.
    SessionTuning = "session" {
        /// Restarts of silent streams in a row, without a depth frame, before the session fails. Source: chosen.
        max_restarts: u32 = 3, [0..=100], "", "";
    }
}
