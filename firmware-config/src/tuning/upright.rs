//! Thresholds of the search for the upward direction.

use crate::settings::section;

section! {
    /// Which plane of the surface is taken for horizontal where no accelerometer told what is.
    UprightTuning = "upright" {
        /// Largest angle between its normal and up in the first picture. Source: people hold cameras less steeply.
        max_tilt_rad: f64 = 0.873, [0.0..=1.5], "rad", "";
        /// Smallest share of the surface that lies in it. Source: tuned by hand on recordings of desks and rooms.
        min_share: f64 = 0.06, [0.0..=1.0], "", "";
        /// Surface within this angle of a direction counts as parallel to it. Source: noise of the normals of fused surfaces.
        normal_rad: f64 = 0.17, [0.01..=0.7], "rad", "";
        /// Surface within this distance of a plane lies in it. Source: depth noise and drift over a desk.
        thickness_m: f64 = 0.02, [0.001..=0.5], "m", "";
    }
}
