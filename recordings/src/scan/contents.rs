//! A scan and its parts.

use crate::types::{Keyframe, Mesh, Pose, Sensor};
use serde::{Deserialize, Serialize};

/// Bytes of the largest mesh array.
pub(crate) const MESH_BYTES: u32 = 1 << 30;

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
    /// Share of the mesh's vertices, of those that any candidate frame saw well, that a keyframe sees.
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

/// A frame handed to `ScanWriter::add_frame`.
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

/// Checks that picture, camera and pose fit each other and are finite.
pub(crate) fn check_frame(frame: &Keyframe) -> std::result::Result<(), String> {
    let (i, c) = (&frame.camera.intrinsics, &frame.color);
    if (i.width, i.height) != (c.width, c.height) {
        let sizes = format!("is {}x{}, its camera {}x{}", c.width, c.height, i.width, i.height);
        return Err(format!("frame {} {sizes}", frame.name));
    }
    let sound = frame.world_from_camera.is_finite() && frame.camera.problem().is_none();
    if sound { Ok(()) } else { Err(format!("frame {} has a pose or camera that makes no sense", frame.name)) }
}

/// Checks that a mesh can be stored: finite numbers, indices in range, a limited size.
pub(crate) fn check_mesh(mesh: &Mesh) -> std::result::Result<(), String> {
    let n = mesh.positions.len();
    if n > MESH_BYTES as usize / 12 || mesh.triangles.len() > MESH_BYTES as usize / 12 {
        Err(format!("a mesh of {n} vertices and {} triangles is too large", mesh.triangles.len()))
    } else if !mesh.normals.is_empty() && mesh.normals.len() != n {
        Err(format!("{} normals for {n} vertices", mesh.normals.len()))
    } else if !mesh.positions.iter().chain(&mesh.normals).all(|v| v.is_finite()) {
        Err("the mesh holds NaN or infinity".into())
    } else if mesh.triangles.iter().flatten().any(|i| *i as usize >= n) {
        Err(format!("a triangle refers to a vertex beyond the {n} there are"))
    } else {
        Ok(())
    }
}
