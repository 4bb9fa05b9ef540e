//! Intervals of the daemon's reports.

use crate::settings::section;

section! {
    /// Reports of the daemon.
    SupervisionTuning = "supervision" {
        /// Time between two frames that are compared to detect motion of the sensor. Source: measured on recordings.
        motion_step_s: f64 = 0.15, [0.03..=2.0], "s", "";
        /// Time between two versions of status.json while the state stays the same. Source: chosen.
        status_interval_s: f64 = 1.0, [0.1..=60.0], "s", "";
        /// Longest time without progress before the watchdog of the service manager is no longer fed; below WatchdogSec of the unit. Source: chosen.
        watchdog_s: f64 = 45.0, [1.0..=3600.0], "s", "";
    }
}
