//! Settings of the daemon and its device folder.

use crate::settings::section;

section! {
    /// Scanning without a keyboard, limits of disk and memory.
    DaemonConfig = "daemon" {
        /// Mean relative change between views that counts as motion of the sensor.
        motion: f64 = 0.02, [0.001..=1.0], "", "";
        /// With --auto: still for so long, and then moving, starts a scan.
        start_still_s: f64 = 2.0, [0.2..=60.0], "s", "";
        /// With --auto: stillness that ends a scan.
        end_still_s: f64 = 3.0, [0.2..=60.0], "s", "";
        /// Longest scan.
        max_scan_s: f64 = 300.0, [1.0..=3600.0], "s", "";
        /// Seconds from the estimator's start to the result on disk.
        budget_s: f64 = 120.0, [1.0..=86400.0], "s", "";
        /// Largest size of the device folder's scans; the oldest finished ones go first.
        max_folder_mb: u32 = 16000, [1..=100000000], "MB", "";
        /// Free space at which a scan ends and old ones go.
        min_free_mb: u32 = 512, [1..=1000000], "MB", "";
        /// Partial scans that are kept aside.
        max_aside: u32 = 3, [0..=100], "", "";
        /// Memory that the capture process may plan with.
        memory_limit_mb: u32 = 1400, [64..=1000000], "MB", "";
        /// Address space of the estimator; it ends alone when it wants more. 0 = no limit.
        estimator_limit_mb: u32 = 2000, [0..=1000000], "MB", "";
    } with crate::tuning::DaemonTuning
}
