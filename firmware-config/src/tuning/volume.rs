//! Thresholds of the TSDF volume.

use crate::settings::section;

section! {
    /// TSDF integration, block recycling, fine voxels.
    VolumeTuning = "volume" {
        /// Fine voxels need a truncation distance of at least this many standard deviations of depth. Source: tuned by hand on recordings.
        fine_sigmas: f64 = 6.0, [0.0..=100.0], "σ", "";
        /// Fine voxels need depth pixels of at most this size: the band around a slanted surface would have gaps. Source: tuned by hand on rendered scenes.
        fine_pixel_voxels: f64 = 1.25, [0.1..=10.0], "voxels", "";
        /// Weights fall from this many standard deviations behind the surface on, so that thin objects stay thin. Source: tuned by hand on rendered scenes.
        fade_sigmas: f64 = 3.0, [0.0..=100.0], "σ", "";
        /// Loss of weight per truncation distance beyond `fade_sigmas`. Source: tuned by hand on rendered scenes.
        fade_slope: f64 = 1.25, [0.0..=100.0], "1/truncation", "";
        /// How far behind the surface a reading on the rim of what was seen counts: where the next ray passes by, all of it would become a wall behind the rim. Source: measured on recordings and rendered scenes.
        rim_behind: f64 = 0.75, [0.0..=1.0], "truncation", "";
        /// Blocks outside the truncation band are tested for free space every n-th frame. Source: tuned by hand on recordings.
        carve_period: u32 = 8, [1..=1000], "frames", "";
        /// Blocks are tested for recycling every n-th frame. Source: tuned by hand on recordings.
        recycle_period: u32 = 64, [1..=10000], "frames", "";
        /// A block in which no surface was measured for this many frames returns to the pool, … Source: tuned by hand on recordings.
        recycle_after_frames: u32 = 300, [1..=1000000], "frames", "";
        /// … unless a voxel near the surface has at least this weight, in frames from 1 m. Source: tuned by hand on recordings.
        recycle_below_weight: f64 = 0.5, [0.0..=64.0], "frames", "";
    }
}
