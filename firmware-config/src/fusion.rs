//! Settings of fusion.

use crate::settings::section;

section! {
    /// Tracking, TSDF and keyframes.
    FusionConfig = "fusion" {
        /// Edge length of a voxel at start; coarsened by factors of two when the pool fills.
        voxel_size_m: f64 = 0.005, [0.001..=0.1], "m", "";
        /// Truncation distance of the signed distance, in voxels.
        truncation_voxels: f64 = 4.0, [2.0..=20.0], "voxels", "";
        /// Voxel blocks (8³ voxels, 2 KiB each) in the pool: 65536 = 128 MiB.
        pool_blocks: u32 = 65536, [256..=1048576], "blocks", "";
        /// Share of the pool at which the volume is coarsened in place.
        coarsen_at: f64 = 0.9, [0.5..=1.0], "", "";
        /// Nearest depth used.
        min_depth_m: f64 = 0.35, [0.05..=2.0], "m", "";
        /// Farthest depth used.
        max_depth_m: f64 = 4.0, [0.5..=10.0], "m", "";
        /// Voxels with a lower weight give no surface.
        min_weight: f64 = 3.0, [0.0..=64.0], "", "";
        /// Least distance between keyframes; doubled for rooms.
        keyframe_spacing_m: f64 = 0.15, [0.01..=2.0], "m", "c1, Eq. (1)";
        /// Most keyframes a scan may hold.
        max_keyframes: u32 = 120, [1..=1000], "", "";
        /// Witness frames kept aside.
        witnesses: u32 = 3, [0..=32], "", "";
    }
}
