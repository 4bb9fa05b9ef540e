//! Tracking, bounded TSDF fusion, meshing and greedy keyframes (§3.1, first half).

use firmware_config::FusionConfig;
use recordings::scan::{CaptureStats, FrameId, KeptFrame};
use recordings::types::{Mesh, Pose, RgbdFrame, Sensor, TimestampNs};

/// Why fusion could not go on.
#[derive(Debug, thiserror::Error)]
pub enum FusionError {
    /// The sensor's description makes no sense.
    #[error("{0}")]
    BadSensor(String),
    /// The frame is not what the sensor's description says.
    #[error("{0}")]
    BadFrame(String),
}

/// State of the tracker after a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tracking {
    /// The pose is known, the frame was integrated.
    Tracked,
    /// The pose is unknown, nothing was integrated.
    Lost,
}

/// What came of one frame.
#[derive(Debug, Clone)]
pub struct FrameReport {
    /// State.
    pub tracking: Tracking,
    /// Pose of the (undistorted) colour camera; `None` when lost.
    pub world_from_camera: Option<Pose>,
    /// Set if this frame is a candidate keyframe or witness: its colour must be kept under this id.
    pub keep: Option<FrameId>,
    /// Blocks of the pool in use.
    pub blocks_used: u64,
    /// True if the volume was coarsened at this frame.
    pub coarsened: bool,
}

/// What a scan amounts to.
#[derive(Debug, Clone)]
pub struct FusionOutput {
    /// The surface in the world frame.
    pub mesh: Mesh,
    /// Colour-camera poses with the colour frames' own time stamps; lost frames left out.
    pub trajectory: Vec<(TimestampNs, Pose)>,
    /// Keyframes in order of time.
    pub keyframes: Vec<KeptFrame>,
    /// Witness frames.
    pub witnesses: Vec<KeptFrame>,
    /// The fusion part of the counters.
    pub stats: CaptureStats,
}

/// Fuses RGB-D frames into a surface.
pub struct Fusion {}

impl Fusion {
    /// Allocates the block pool and everything else whose size is fixed.
    ///
    /// # Errors
    /// The sensor's description makes no sense.
    pub fn new(_sensor: &Sensor, _config: &FusionConfig) -> Result<Self, FusionError> {
        unimplemented!()
    }

    /// Tracks and integrates one frame.
    ///
    /// # Errors
    /// The frame's sizes are not the sensor's.
    pub fn push(&mut self, _frame: &RgbdFrame) -> Result<FrameReport, FusionError> {
        unimplemented!()
    }

    /// Extracts the mesh and chooses the keyframes.
    #[must_use]
    pub fn finish(self) -> FusionOutput {
        unimplemented!()
    }
}
