//! Settings of fusion.

use crate::settings::section;

section! {
    /// Tracking, TSDF and keyframes.
    FusionConfig = "fusion" {
        /// Edge length of a voxel. Half of it is used while the scene is small and near; it doubles when the pool becomes full.
        voxel_size_m: f64 = 0.005, [0.001..=0.1], "m", "";
        /// Largest number of blocks per frame for which voxels of half the length are used; 0 = never.
        fine_blocks: u32 = 6000, [0..=1048576], "blocks", "";
        /// Largest voxel size after coarsening.
        max_voxel_size_m: f64 = 0.04, [0.001..=0.4], "m", "";
        /// Truncation distance of the TSDF, in voxels.
        truncation_voxels: f64 = 4.0, [2.0..=20.0], "voxels", "";
        /// Number of voxel blocks (8³ voxels, 2 KiB each) in the pool: 65536 blocks take 128 MiB.
        pool_blocks: u32 = 65536, [256..=1048576], "blocks", "";
        /// Share of the pool in use at which the voxel size is doubled in place.
        coarsen_at: f64 = 0.9, [0.5..=1.0], "", "";
        /// Smallest depth that is used.
        min_depth_m: f64 = 0.35, [0.05..=2.0], "m", "";
        /// Largest depth that is used.
        max_depth_m: f64 = 4.0, [0.5..=10.0], "m", "";
        /// Depth correction of this sensor, z ← z · (1 + depth_linear + depth_linear_radial · r²) + z² · (depth_square + depth_square_radial · r²), r = tangent of the angle to the optical axis: linear term.
        depth_linear: f64 = 0.0, [-0.2..=0.2], "", "";
        /// Depth correction: growth of the linear term with r².
        depth_linear_radial: f64 = 0.0, [-0.5..=0.5], "", "";
        /// Depth correction: quadratic term (an error of the disparity).
        depth_square: f64 = 0.0, [-0.1..=0.1], "1/m", "";
        /// Depth correction: growth of the quadratic term with r².
        depth_square_radial: f64 = 0.0, [-0.5..=0.5], "1/m", "";
        /// Largest accepted depth slope, as the tangent of the angle between view ray and normal; steeper pixels are grazing or flying.
        max_slope: f64 = 5.0, [1.0..=100.0], "", "";
        /// Upper bound of the accumulated weight in the average with a new reading, in frames from 1 m.
        max_weight: f64 = 100.0, [4.0..=1000.0], "frames", "";
        /// Smallest weight of a voxel with surface, in frames from 1 m.
        min_weight: f64 = 3.0, [0.0..=64.0], "frames", "";
        /// Smallest weight of a voxel with surface, as a share of the weighted median weight of the surface: rare readings add up in a long scan.
        min_weight_share: f64 = 0.015, [0.0..=0.5], "", "";
        /// Connected components of the mesh with fewer triangles are removed.
        min_component_triangles: u32 = 200, [0..=1000000], "triangles", "";
        /// Budget per frame, in CPU time of the reference machine of fusion/README.md. Tracking is reduced to fit, integration is not. 0 = no limit.
        max_cpu_ms_per_frame: f64 = 0.0, [0.0..=1000.0], "ms", "";
        /// Weight of the photometric term of tracking relative to the geometric term.
        photometric_weight: f64 = 1.0, [0.0..=100.0], "", "";
        /// Standard deviation of a grey value (0 to 255) in the photometric term.
        photometric_sigma: f64 = 6.0, [0.5..=64.0], "", "";
        /// Standard deviation of the constant-velocity prediction: translation.
        prior_sigma_m: f64 = 0.05, [0.001..=1.0], "m", "";
        /// Standard deviation of the constant-velocity prediction: rotation.
        prior_sigma_rad: f64 = 0.05, [0.001..=1.0], "rad", "";
        /// A direction of the pose is unobserved if its eigenvalue is below this share of the largest; the motion prior then determines it.
        unobserved_below: f64 = 0.00002, [0.0..=0.5], "", "";
        /// Largest speed of the camera between two tracked frames.
        max_speed_m_s: f64 = 4.5, [0.1..=20.0], "m/s", "";
        /// Largest angular speed of the camera between two tracked frames.
        max_turn_rad_s: f64 = 7.5, [0.1..=30.0], "rad/s", "";
        /// Largest translation between two tracked frames, independent of the time between them; a larger one counts as a loss of tracking.
        max_step_m: f64 = 0.25, [0.01..=2.0], "m", "";
        /// Largest rotation between two tracked frames; a larger one counts as a loss of tracking.
        max_step_rad: f64 = 0.33, [0.01..=1.5], "rad", "";
        /// Gain of the estimation of two times: the delay of depth against colour beyond the time stamps, and the read-out time of an image (rolling shutter). 0 = time stamps are exact and all rows simultaneous.
        timing_gain: f64 = 1.0, [0.0..=1.0], "", "";
        /// Largest estimated delay of depth.
        max_latency_ms: f64 = 30.0, [0.0..=100.0], "ms", "";
        /// Largest estimated read-out time, from the first row of an image to its last row.
        max_readout_ms: f64 = 35.0, [0.0..=100.0], "ms", "";
        /// Smallest share of the depth samples that must agree with the model or the last frame for a frame to be tracked.
        min_fit: f64 = 0.35, [0.01..=0.9], "", "";
        /// Smallest correlation with the image of an anchor at which a pose is accepted by relocalisation.
        min_likeness: f64 = 0.66, [0.0..=1.0], "", "";
        /// A colour image with a mean grey value (0 to 255) below this counts as black and is not tracked.
        black_below: f64 = 3.0, [0.0..=64.0], "", "";
        /// Largest distance from the anchor frame, as a share of its median depth; beyond it tracking changes to another anchor.
        anchor_distance: f64 = 0.15, [0.01..=1.0], "", "";
        /// Largest angle to the anchor frame; beyond it tracking changes to another anchor.
        anchor_angle_rad: f64 = 0.17, [0.01..=1.0], "rad", "";
        /// Largest number of anchor frames for tracking and relocalisation.
        max_anchors: u32 = 256, [2..=4096], "", "";
        /// Smallest distance between keyframes; doubled for rooms.
        keyframe_spacing_m: f64 = 0.15, [0.01..=2.0], "m", "c1, Eq. (1)";
        /// Largest number of keyframes in a scan.
        max_keyframes: u32 = 120, [1..=1000], "", "";
        /// Number of keyframes that should see each surface point, where the recording allows it.
        keyframe_views: u32 = 4, [1..=16], "", "";
        /// Number of validation frames, which no estimation step uses.
        witnesses: u32 = 3, [0..=32], "", "";
    } with crate::tuning::FusionTuning
}
