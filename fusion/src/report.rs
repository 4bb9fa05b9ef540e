//! What fusion reports of a frame, and of a scan.

use recordings::scan::{CaptureStats, FrameId, KeptFrame};
use recordings::types::{Mesh, Pose, TimestampNs};

/// State of tracking after a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tracking {
    /// The pose is known and the frame was integrated.
    Tracked,
    /// The pose is unknown and nothing was integrated.
    Lost,
}

/// How far tracking is from being lost: each part is 0 where a frame would no longer be tracked, 1 where tracking is at ease.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Margin {
    /// Agreement of the depth with the model.
    pub fit: f32,
    /// Correlation of the image with its references.
    pub likeness: f32,
    /// Distance to the largest step between two frames.
    pub motion: f32,
    /// Shape, or else texture, that fixes every direction of the pose.
    pub structure: f32,
    /// Share of the image with depth.
    pub depth: f32,
}

/// Result of one frame.
#[derive(Debug, Clone)]
pub struct FrameReport {
    /// State of tracking.
    pub tracking: Tracking,
    /// Pose of the (undistorted) colour camera; `None` when lost.
    pub world_from_camera: Option<Pose>,
    /// How far tracking is from being lost; `None` for the first frame, a relocalised one, and a lost one.
    pub margin: Option<Margin>,
    /// Median depth, metres; 0 without depth.
    pub median_depth_m: f32,
    /// Set if the frame is a candidate keyframe or validation frame: its colour image must be stored under this id.
    pub keep: Option<FrameId>,
    /// Blocks of the pool in use.
    pub blocks_used: u64,
    /// Edge length of a voxel, metres.
    pub voxel_size_m: f64,
    /// True if the pool became full at this frame and the voxel size was doubled beyond the setting.
    pub coarsened: bool,
}

/// Result of a scan.
#[derive(Debug, Clone)]
pub struct FusionOutput {
    /// The surface in the world frame, metres.
    pub mesh: Mesh,
    /// `(time stamp of the colour image, world_from_camera)` of the tracked frames.
    pub trajectory: Vec<(TimestampNs, Pose)>,
    /// Keyframes in order of time.
    pub keyframes: Vec<KeptFrame>,
    /// Validation frames: kept out of the estimation.
    pub validation_frames: Vec<KeptFrame>,
    /// Fusion's part of the counters.
    pub stats: CaptureStats,
}
