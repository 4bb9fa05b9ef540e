//! The pipeline of a scan, KinectFusion's loop: preprocess, track, integrate, predict, choose keyframes.

use crate::camera::rig::Rig;
use crate::camera::world_frame;
use crate::error::FusionError;
use crate::frame::preprocess::Frame;
use crate::keyframes::Candidates;
use crate::report::{FrameReport, FusionOutput, Tracking};
use crate::tracking::effort;
use crate::tracking::pose_tracker::PoseTracker;
use crate::tracking::problem::AlignmentContext;
use crate::tsdf::components::drop_small_components;
use crate::tsdf::marching_cubes::{SurfaceThreshold, extract};
use crate::tsdf::model::Model;
use crate::tsdf::surfels::{BlockSurface, SurfaceReader};
use crate::tsdf::visibility::drop_unseen;
use firmware_config::FusionConfig;
use glam::DVec3;
use recordings::scan::{CaptureStats, FrameId};
use recordings::types::{Pose, RgbdFrame, Sensor, TimestampNs};
use tracing::debug_span;

/// Fuses RGB-D frames into a surface.
pub struct Fusion {
    config: FusionConfig,
    rig: Rig,
    frame: Frame,
    poses: PoseTracker,
    model: Model,
    candidates: Candidates,
    up: Option<DVec3>,
    first_stamp: Option<TimestampNs>,
    stats: CaptureStats,
    paused: bool,
}

impl Fusion {
    /// Allocates the block pool and all other buffers of fixed size.
    ///
    /// # Errors
    /// The sensor's description is not usable.
    pub fn new(sensor: &Sensor, config: &FusionConfig) -> Result<Self, FusionError> {
        let rig = Rig::new(sensor, config)?;
        Ok(Self {
            config: config.clone(),
            frame: Frame::new(&rig),
            poses: PoseTracker::new(config),
            model: Model::new(config),
            candidates: Candidates::new(config),
            up: None,
            first_stamp: None,
            stats: CaptureStats::default(),
            paused: false,
            rig,
        })
    }

    /// Sets the upward direction, in the colour camera's axes at the first frame (an accelerometer at rest measures it).
    /// Without it, image-up of the first camera is +Z of the world. No effect after the first tracked frame.
    pub fn set_gravity(&mut self, up: DVec3) {
        if up.is_finite() && up.length() > 1e-3 {
            self.up = Some(up);
        }
    }

    /// While paused, frames are tracked, and neither integrated nor kept. There has to be a surface to track by: a pause begins after it.
    pub fn set_paused(&mut self, paused: bool) {
        self.paused = paused;
    }

    /// Appends at most `limit` blocks of surface that changed since `reader` read them. Has no effect on the scan.
    pub fn read_surface(&self, reader: &mut SurfaceReader, limit: usize, out: &mut Vec<BlockSurface>) {
        self.model.read_surface(reader, limit, out);
    }

    /// Tracks and integrates one frame.
    ///
    /// # Errors
    /// The frame does not have the sensor's image sizes.
    pub fn push(&mut self, frame: &RgbdFrame) -> Result<FrameReport, FusionError> {
        self.rig.check_frame(frame)?;
        let stamp = frame.color.timestamp_ns;
        self.count_pair(stamp);
        // Measurement: depth to points and normals, colour to a grey pyramid, all rows to one instant.
        debug_span!("preprocess").in_scope(|| self.frame.fill(frame, &self.rig, &self.config));
        let motion = self.poses.predict_motion(frame, &self.rig, &self.config);
        self.frame.synchronise(&motion, &self.rig);
        // Pose: frame to model, or relocalisation.
        let found = debug_span!("track").in_scope(|| self.locate(stamp));
        let Some(pose) = found else {
            self.mark_lost();
            return Ok(self.report(None, None, false));
        };
        self.accept_pose(&pose, stamp);
        let paused = self.paused && self.model.volume.used() > 0;
        // Surface: depth into the TSDF.
        let coarsened = !paused && self.model.fuse(&self.frame, &pose, &self.rig, &self.config);
        // Prediction: the references of the next frame.
        debug_span!("predict").in_scope(|| self.poses.update_references(&self.frame, &pose, &self.rig, &self.config));
        // Eq. (1): candidate keyframes; an image with missing packets is none.
        let wanted = frame.color.missing_packets == 0 && !paused;
        let offer = || wanted.then(|| self.candidates.offer(&self.frame, &pose, &self.config)).flatten();
        let keep = debug_span!("keyframes").in_scope(offer);
        Ok(self.report(Some(pose), keep, coarsened))
    }

    /// Extracts the mesh and chooses the keyframes.
    #[must_use]
    pub fn finish(self) -> FusionOutput {
        let threshold = SurfaceThreshold {
            min_weight: self.config.min_weight as f32,
            share: self.config.min_weight_share as f32,
            min_triangles: self.config.min_component_triangles as usize,
        };
        let stats = CaptureStats {
            voxel_size_m: f64::from(self.model.volume.voxel_m()),
            blocks_used: self.model.volume.used() as u64,
            blocks_total: self.model.volume.capacity() as u64,
            blocks_refused: self.model.refused_blocks,
            coarsenings: self.model.coarsenings,
            ..self.stats
        };
        // Buffers are freed before the next ones are allocated.
        let trajectory = self.poses.into_trajectory();
        let volume = self.model.into_volume();
        let mut mesh = extract(&volume, &threshold);
        drop(volume);
        let tuning = &self.config.tuning.surface_coverage;
        drop_unseen(&mut mesh, self.candidates.poses(), &self.rig.grey[0], tuning);
        drop_small_components(&mut mesh, threshold.min_triangles);
        // Eq. (1)
        let chosen = self.candidates.choose(&mesh, &self.rig, &self.config);
        FusionOutput {
            mesh,
            trajectory,
            keyframes: chosen.keyframes,
            validation_frames: chosen.validation_frames,
            stats: CaptureStats { keyframe_coverage: chosen.coverage, ..stats },
        }
    }

    fn count_pair(&mut self, stamp: TimestampNs) {
        self.stats.pairs += 1;
        let first_stamp = *self.first_stamp.get_or_insert(stamp);
        self.stats.duration_s = stamp.saturating_sub(first_stamp) as f64 * 1e-9;
    }

    /// Pose of the current frame: that of the first frame, tracked from the last one, or relocalised.
    fn locate(&mut self, stamp: TimestampNs) -> Option<Pose> {
        let Self { config, rig, model, .. } = self;
        if self.frame.valid < config.tuning.tracking.min_valid_share as f32
            || self.frame.mean_grey < config.black_below as f32
        {
            return None;
        }
        let context = AlignmentContext { rig, volume: &model.volume, config };
        let max_gap_s = config.tuning.tracking.max_prediction_s;
        match self.poses.state() {
            None => Some(self.up.map_or_else(world_frame::world_from_first_camera, world_frame::level_world)),
            Some(Tracking::Tracked) if self.poses.age_s(stamp) <= max_gap_s => {
                let effort = effort::choose(config, model.updated_blocks, self.frame.valid);
                self.poses.track(&mut self.frame, context, stamp, effort)
            }
            Some(_) => self.poses.relocalise(&self.frame, context, stamp),
        }
    }

    fn accept_pose(&mut self, pose: &Pose, stamp: TimestampNs) {
        self.stats.tracked_pairs += 1;
        self.stats.relocalisations += u64::from(self.poses.state() == Some(Tracking::Lost));
        self.poses.accept_pose(pose, stamp);
    }

    fn mark_lost(&mut self) {
        self.stats.lost_pairs += 1;
        self.stats.losses += u64::from(self.poses.state() == Some(Tracking::Tracked));
        self.poses.mark_lost();
    }

    fn report(&self, world_from_camera: Option<Pose>, keep: Option<FrameId>, coarsened: bool) -> FrameReport {
        FrameReport {
            tracking: if world_from_camera.is_some() { Tracking::Tracked } else { Tracking::Lost },
            world_from_camera,
            margin: world_from_camera.and(self.poses.margin()),
            median_depth_m: self.frame.median_depth,
            keep,
            blocks_used: self.model.volume.used() as u64,
            voxel_size_m: f64::from(self.model.volume.voxel_m()),
            coarsened,
        }
    }
}
