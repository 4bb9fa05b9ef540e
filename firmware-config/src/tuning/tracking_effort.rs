//! The cost model behind `fusion.max_cpu_ms_per_frame`.

use crate::settings::section;

section! {
    /// CPU time of fusion's parts on the reference machine of fusion/README.md, for `fusion.max_cpu_ms_per_frame`.
    TrackingEffortTuning = "tracking_effort" {
        /// Cost of a frame without tracking and integration. Source: cargo bench -p fusion.
        fixed_ms: f64 = 5.0, [0.0..=1000.0], "ms", "";
        /// Cost of an integrated block. Source: cargo bench -p fusion.
        block_ms: f64 = 0.002, [0.0..=1.0], "ms", "";
        /// Cost of the full tracking schedule for a frame full of depth. Source: cargo bench -p fusion.
        full_ms: f64 = 14.0, [0.0..=1000.0], "ms", "";
        /// Cost of the reduced tracking schedule. Source: cargo bench -p fusion.
        reduced_ms: f64 = 8.0, [0.0..=1000.0], "ms", "";
        /// Cost of the cheapest tracking schedule. Source: cargo bench -p fusion.
        cheapest_ms: f64 = 4.5, [0.0..=1000.0], "ms", "";
    }
}
