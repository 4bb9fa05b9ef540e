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

/// Result of one frame.
#[derive(Debug, Clone)]
pub struct FrameReport {
    /// State of tracking.
    pub tracking: Tracking,
    /// Pose of the (undistorted) colour camera; `None` when lost.
    pub world_from_camera: Option<Pose>,
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
