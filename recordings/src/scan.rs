//! Scans (`.lscan`): what fusion hands to the estimator.

use crate::error::Result;
use crate::types::{ColorFrame, Keyframe, Mesh, Pose, Sensor};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Where a scan's mesh came from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum ScanSource {
    /// Fused from depth frames: noisy, fused from several sides, open at the back.
    Fusion,
    /// Imported with posed photos: the mesh is taken as it is.
    Photos,
}

/// Counters of the capture that made the scan; every drop by cause.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct CaptureStats {
    /// Depth frames read.
    pub depth_frames: u64,
    /// Colour frames read.
    pub color_frames: u64,
    /// Pairs handed to fusion.
    pub pairs: u64,
    /// Colour frames without a depth frame near in time.
    pub unpaired_color: u64,
    /// Depth frames without a colour frame near in time.
    pub unpaired_depth: u64,
    /// Frames with missing packets.
    pub incomplete_frames: u64,
    /// Packets missing.
    pub missing_packets: u64,
    /// Pairs dropped because fusion was busy (live only).
    pub dropped_pairs: u64,
    /// Pairs tracked.
    pub tracked_pairs: u64,
    /// Pairs while tracking was lost.
    pub lost_pairs: u64,
    /// Times tracking was lost.
    pub losses: u64,
    /// Times the camera was found again.
    pub relocalisations: u64,
    /// Times the volume was coarsened to twice the voxel size.
    pub coarsenings: u32,
    /// Voxel size at the end, in metres.
    pub voxel_size_m: f64,
    /// Voxel blocks in use at the end.
    pub blocks_used: u64,
    /// Voxel blocks in the pool.
    pub blocks_total: u64,
    /// Block allocations refused because the pool was full.
    pub blocks_refused: u64,
    /// Length of the capture on the recording's clock, in seconds.
    pub duration_s: f64,
    /// Share of the mesh's vertices that a keyframe sees.
    pub keyframe_coverage: f64,
}

/// Everything the estimator needs: one mesh, posed pictures, settings. The mesh's frame is the world of the poses.
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    /// Name of the scan (source folder or recording stem).
    pub name: String,
    /// Where the mesh came from.
    pub source: ScanSource,
    /// The sensor.
    pub sensor: Sensor,
    /// The mesh, normals filled.
    pub mesh: Mesh,
    /// Keyframes in order of time, or as imported.
    pub keyframes: Vec<Keyframe>,
    /// Frames kept aside that no estimation step may use.
    pub witnesses: Vec<Keyframe>,
    /// The effective configuration as TOML.
    pub config: String,
    /// Counters of the capture.
    pub stats: CaptureStats,
}

/// A frame handed to [`ScanWriter::add_frame`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FrameId(pub u32);

/// A frame that made it into the scan, by its id.
#[derive(Debug, Clone, PartialEq)]
pub struct KeptFrame {
    /// The frame.
    pub id: FrameId,
    /// Its pose.
    pub world_from_camera: Pose,
}

/// What is known of a scan only at its end.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanTail {
    /// Name of the scan.
    pub name: String,
    /// The sensor.
    pub sensor: Sensor,
    /// Camera of the colour frames.
    pub mesh: Mesh,
    /// Keyframes in order of time.
    pub keyframes: Vec<KeptFrame>,
    /// Witness frames.
    pub witnesses: Vec<KeptFrame>,
    /// The effective configuration as TOML.
    pub config: String,
    /// Counters.
    pub stats: CaptureStats,
}

/// Writes a scan while it is captured: colour frames go to disk as they are chosen, the rest at the end. A candidate
/// that does not become a keyframe is left out of the finished file.
pub struct ScanWriter {}

impl ScanWriter {
    /// Starts a scan beside `path`; nothing is visible under that name before [`ScanWriter::finish`].
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn create(_path: &Path) -> Result<Self> {
        unimplemented!()
    }
    /// Appends a candidate's colour frame under the id that fusion gave it.
    ///
    /// # Errors
    /// The disk is full or gone.
    pub fn add_frame(&mut self, _id: FrameId, _color: &ColorFrame) -> Result<()> {
        unimplemented!()
    }
    /// Writes the finished file (only frames that `tail` names), syncs and renames it into place.
    ///
    /// # Errors
    /// The disk is full or gone, or `tail` names a frame that was never added.
    pub fn finish(self, _tail: &ScanTail) -> Result<()> {
        unimplemented!()
    }
}

impl Scan {
    /// Reads a scan file.
    ///
    /// # Errors
    /// Unreadable, damaged, no scan, or of a newer version.
    pub fn read(_path: &Path) -> Result<Self> {
        unimplemented!()
    }
    /// Writes a scan file (by fsync and rename).
    ///
    /// # Errors
    /// The disk is full or gone.
    pub fn write(&self, _path: &Path) -> Result<()> {
        unimplemented!()
    }
}
