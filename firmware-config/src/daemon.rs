//! Settings of the daemon and its device folder.

use crate::settings::section;

section! {
    /// Scanning without a keyboard, limits of disk and memory.
    DaemonConfig = "daemon" {
        /// Mean relative change between images from which the sensor counts as moving.
        motion: f64 = 0.02, [0.001..=1.0], "", "";
        /// With --auto: motion after this time of stillness starts a scan.
        start_still_s: f64 = 2.0, [0.2..=60.0], "s", "";
        /// With --auto: this time of stillness ends a scan.
        end_still_s: f64 = 3.0, [0.2..=60.0], "s", "";
        /// Largest duration of a scan.
        max_scan_s: f64 = 300.0, [1.0..=3600.0], "s", "";
        /// Time budget from the start of the estimator to the result on disk.
        budget_s: f64 = 120.0, [1.0..=86400.0], "s", "";
        /// Largest total size of the scans in the device folder; the oldest finished scans are deleted first.
        max_folder_mb: u32 = 16000, [1..=100000000], "MB", "";
        /// Free disk space below which the current scan ends and old scans are deleted.
        min_free_mb: u32 = 512, [1..=1000000], "MB", "";
        /// Largest number of partial scans in the folder `aside`.
        max_aside: u32 = 3, [0..=100], "", "";
        /// Upper bound of the memory plan of the capture process.
        memory_limit_mb: u32 = 1400, [64..=1000000], "MB", "";
        /// Memory that the estimator process plans to fit; only this process ends if it needs more. 0 = no limit.
        estimator_limit_mb: u32 = 2000, [0..=1000000], "MB", "";
    } with crate::tuning::DaemonTuning
}
