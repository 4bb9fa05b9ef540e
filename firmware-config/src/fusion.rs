//! Settings of fusion.

use crate::settings::section;

section! {
    /// Tracking, TSDF and keyframes.
    FusionConfig = "fusion" {
        /// Edge length of a voxel; half of it while the scene is small and near, and doubled when the pool fills.
        voxel_size_m: f64 = 0.005, [0.001..=0.1], "m", "";
        /// Most blocks that a frame may reach while voxels are half as long; 0: they never are.
        fine_blocks: u32 = 6000, [0..=1048576], "blocks", "";
        /// Largest voxel size that coarsening may reach.
        max_voxel_size_m: f64 = 0.04, [0.001..=0.4], "m", "";
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
        /// Depth correction of this very sensor, z ← z · (1 + linear + linear_radial · r²) + z² · (square + square_radial · r²), r = tangent of the angle to the optical axis: share of the depth on the axis …
        depth_linear: f64 = 0.0, [-0.2..=0.2], "", "";
        /// … and how it grows with r².
        depth_linear_radial: f64 = 0.0, [-0.5..=0.5], "", "";
        /// Share of the squared depth on the axis (an error of disparity) …
        depth_square: f64 = 0.0, [-0.1..=0.1], "1/m", "";
        /// … and how it grows with r².
        depth_square_radial: f64 = 0.0, [-0.5..=0.5], "1/m", "";
        /// Steepest depth slope accepted, as the tangent of the angle between view ray and normal; steeper pixels are grazing or flying.
        max_slope: f64 = 5.0, [1.0..=100.0], "", "";
        /// Largest weight of what was seen before against what is new, in frames seen from 1 m.
        max_weight: f64 = 100.0, [4.0..=1000.0], "frames", "";
        /// Voxels with a lower weight give no surface.
        min_weight: f64 = 3.0, [0.0..=64.0], "frames", "";
        /// Nor do voxels of a lower weight than this share of the surface's typical one: the longer a scan, the more rare readings add up.
        min_weight_share: f64 = 0.015, [0.0..=0.5], "", "";
        /// Connected pieces of the mesh with fewer triangles are dropped.
        min_component_triangles: u32 = 200, [0..=1000000], "triangles", "";
        /// Work that a frame may cost, in CPU time of the reference machine of fusion/README.md: tracking is coarsened to fit, integration never. 0 = no limit.
        max_cpu_ms_per_frame: f64 = 0.0, [0.0..=1000.0], "ms", "";
        /// Weight of the photometric term of tracking against the geometric one.
        photometric_weight: f64 = 1.0, [0.0..=100.0], "", "";
        /// Standard deviation of a grey value, of 255, for the photometric term.
        photometric_sigma: f64 = 6.0, [0.5..=64.0], "", "";
        /// Standard deviation of the constant-velocity prediction, translation.
        prior_sigma_m: f64 = 0.05, [0.001..=1.0], "m", "";
        /// Standard deviation of the constant-velocity prediction, rotation.
        prior_sigma_rad: f64 = 0.05, [0.001..=1.0], "rad", "";
        /// A direction whose eigenvalue is below this share of the largest is unobserved: the motion prior holds it.
        unobserved_below: f64 = 0.00002, [0.0..=0.5], "", "";
        /// Fastest motion that is believed.
        max_speed_m_s: f64 = 4.5, [0.1..=20.0], "m/s", "";
        /// Fastest turn that is believed.
        max_turn_rad_s: f64 = 7.5, [0.1..=30.0], "rad/s", "";
        /// Longest way between two frames that is believed without looking for the camera anew, however long the time between them.
        max_step_m: f64 = 0.25, [0.01..=2.0], "m", "";
        /// Largest turn between two frames that is believed without looking for the camera anew.
        max_step_rad: f64 = 0.33, [0.01..=1.5], "rad", "";
        /// How fast the delay of depth against colour beyond what the stamps say is learnt, and the time that an image is read out in. 0 = the stamps are believed, and all rows are taken to be seen at once.
        timing_gain: f64 = 1.0, [0.0..=1.0], "", "";
        /// Largest delay that is learnt.
        max_latency_ms: f64 = 30.0, [0.0..=100.0], "ms", "";
        /// Longest time from an image's first row to its last that is learnt.
        max_readout_ms: f64 = 35.0, [0.0..=100.0], "ms", "";
        /// Least share of the depth samples that must agree with the surface or the last frame for tracking to hold.
        min_fit: f64 = 0.35, [0.01..=0.9], "", "";
        /// Least correlation with the anchor's picture at which a lost camera counts as found.
        min_likeness: f64 = 0.66, [0.0..=1.0], "", "";
        /// Mean grey value (of 255) under which a colour frame counts as black.
        black_below: f64 = 3.0, [0.0..=64.0], "", "";
        /// Distance from the anchor frame at which tracking changes to another anchor, as a share of the median depth.
        anchor_distance: f64 = 0.15, [0.01..=1.0], "", "";
        /// Angle to the anchor frame at which tracking changes to another anchor.
        anchor_angle_rad: f64 = 0.17, [0.01..=1.0], "rad", "";
        /// Most anchor frames kept for tracking and relocalisation.
        max_anchors: u32 = 256, [2..=4096], "", "";
        /// Least distance between keyframes; doubled for rooms.
        keyframe_spacing_m: f64 = 0.15, [0.01..=2.0], "m", "c1, Eq. (1)";
        /// Most keyframes a scan may hold.
        max_keyframes: u32 = 120, [1..=1000], "", "";
        /// Views a surface point should get from the keyframes where the recording has them.
        keyframe_views: u32 = 4, [1..=16], "", "";
        /// Witness frames kept aside.
        witnesses: u32 = 3, [0..=32], "", "";
    } with crate::tuning::FusionTuning
}
