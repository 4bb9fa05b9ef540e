//! Thresholds of the choice of keyframes.

use crate::settings::section;

section! {
    /// Greedy choice of keyframes, Eq. (1).
    KeyframesTuning = "keyframes" {
        /// Largest number of vertices on which coverage is evaluated. Source: tuned by hand on recordings.
        max_vertices: u32 = 30000, [100..=10000000], "vertices", "";
        /// A vertex counts fully from this cosine between its normal and the direction to the camera on. Source: c2 of Eq. (3).
        full_cos: f64 = 0.5, [0.0..=1.0], "", "c2, Eq. (3)";
        /// A frame replaces a candidate near it if it is sharper by this factor. Source: tuned by hand on recordings.
        sharper: f64 = 1.15, [1.0..=100.0], "", "";
        /// Largest number of times that a candidate may be replaced. Source: bounds the number of images written.
        max_replaced: u32 = 3, [0..=1000], "", "";
        /// Mean of the median depths from which a scan counts as a room, with doubled keyframe spacing. Source: c1 of Eq. (1), desk and room scans.
        room_depth_m: f64 = 1.5, [0.0..=100.0], "m", "";
        /// A further keyframe must add this share of the vertices that can be covered. Source: tuned by hand on recordings.
        min_gain_share: f64 = 0.002, [0.0..=1.0], "", "";
    }
}
