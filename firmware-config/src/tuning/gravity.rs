//! Thresholds of the accelerometer.

use crate::settings::section;

section! {
    /// Which accelerometer readings give the up direction.
    GravityTuning = "gravity" {
        /// Smallest specific force that is taken for gravity; a moving sensor measures more or less. Source: 9.81 m/s² with the tolerance of the sensor.
        min_m_s2: f64 = 8.5, [0.0..=9.8], "m/s²", "";
        /// Largest specific force that is taken for gravity. Source: as above.
        max_m_s2: f64 = 11.1, [9.8..=100.0], "m/s²", "";
    }
}
