//! The state machine of fusion.

use crate::camera::rig::{self as camera, Rig};
use crate::camera::rolling_shutter::Motion;
use crate::frame::preprocess::Frame;
use crate::keyframes::Candidates;
use crate::tracking::align::{self as tracking, Alignment, Reference, Scene, Tracker};
use crate::tracking::anchors::Anchors;
use crate::tracking::timing::Timing;
use crate::tracking::{effort, rotate};
use crate::tsdf::integrate::Integrator;
use crate::tsdf::marching_cubes as extract;
use crate::tsdf::visibility as visible;
use crate::tsdf::volume::Volume;
use firmware_config::FusionConfig;
use glam::{DQuat, DVec3};
use nalgebra::Vector6;
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

/// Voxels are fine while the truncation distance holds this many standard deviations of depth, …
const FINE_SIGMAS: f32 = 6.0;
/// … and while a depth pixel covers no more of them than this: between the pixels of a slanted surface the band around it
/// would have gaps.
const FINE_PIXELS: f32 = 1.25;

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
    /// Edge length of a voxel, metres.
    pub voxel_size_m: f64,
    /// True if the pool ran full and voxels are longer since this frame than was asked for.
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

/// Longest gap between frames over which the last velocity is believed, seconds.
const MAX_PREDICTION_S: f64 = 0.2;
/// Frames over which the velocity is averaged that takes depth to the colour image's instant.
const VELOCITY_FRAMES: usize = 4;
/// Slowest motion from which instants are learnt, metres per second.
const LEAST_SPEED: f64 = 0.03;
/// Longest time between the images of a pair that is made up for by the motion, seconds.
const MAX_STAMP_GAP_S: f64 = 0.1;

/// Longest time over which the last velocity is tried to find the camera again, seconds.
const MAX_COASTING_S: f64 = 1.0;
/// Share of `min_likeness` that a tracked frame must have.
const DOUBTFUL: f32 = 0.6;
/// Steps in which it is carried on.
const COASTING_STEPS: usize = 16;
/// Most times that a found place is aligned again.
const POLISHING_ROUNDS: usize = 4;
/// Least gain in fit and likeness for which it is.
const LEAST_GAIN: f32 = 0.01;

/// Where a lost camera may be.
#[derive(Debug, Clone, Copy)]
struct Found {
    alignment: Alignment,
    /// Correlation with the anchor's picture.
    likeness: f32,
    anchor: usize,
}

impl Found {
    fn score(&self) -> f32 {
        self.alignment.fit + self.likeness
    }
}

fn better(a: Option<Found>, b: Option<Found>) -> Option<Found> {
    [a, b].into_iter().flatten().reduce(|a, b| if b.score() > a.score() { b } else { a })
}

/// Fuses RGB-D frames into a surface.
pub struct Fusion {
    config: FusionConfig,
    rig: Rig,
    volume: Volume,
    integrator: Integrator,
    tracker: Tracker,
    frame: Frame,
    /// The last tracked frame, its pose and what tracking needs of it.
    last: Frame,
    reference: Reference,
    last_stamp: TimestampNs,
    /// Blocks that the last tracked frame was integrated into.
    last_blocks: usize,
    /// Twist of the camera (translation, rotation) per second, camera axes.
    velocity: Vector6<f64>,
    timing: Timing,
    /// Frames tracked one after another since the start or the last loss.
    streak: usize,
    anchors: Anchors,
    anchor: usize,
    candidates: Candidates,
    up: Option<DVec3>,
    state: Option<Tracking>,
    trajectory: Vec<(TimestampNs, Pose)>,
    stats: CaptureStats,
    first_stamp: Option<TimestampNs>,
}

impl Fusion {
    /// Allocates the block pool and everything else whose size is fixed.
    ///
    /// # Errors
    /// The sensor's description makes no sense.
    pub fn new(sensor: &Sensor, config: &FusionConfig) -> Result<Self, FusionError> {
        let rig = Rig::new(sensor, config)?;
        Ok(Self {
            config: config.clone(),
            volume: Volume::new(config),
            integrator: Integrator::new(config),
            tracker: Tracker::default(),
            frame: Frame::new(&rig),
            last: Frame::new(&rig),
            reference: Reference::default(),
            last_stamp: 0,
            last_blocks: 0,
            velocity: Vector6::zeros(),
            timing: Timing::default(),
            streak: 0,
            anchors: Anchors::new(config.max_anchors as usize),
            anchor: 0,
            candidates: Candidates::new(config),
            up: None,
            state: None,
            trajectory: Vec::new(),
            stats: CaptureStats::default(),
            first_stamp: None,
            rig,
        })
    }

    /// Says where up is, in the colour camera's axes at the first frame (an accelerometer at rest points up). Without it, or
    /// after the first tracked frame, the first camera's image-up is the world's +Z.
    pub fn set_gravity(&mut self, up: DVec3) {
        if up.is_finite() && up.length() > 1e-3 {
            self.up = Some(up);
        }
    }

    /// Tracks and integrates one frame.
    ///
    /// # Errors
    /// The frame's sizes are not the sensor's.
    pub fn push(&mut self, frame: &RgbdFrame) -> Result<FrameReport, FusionError> {
        self.check(frame)?;
        let stamp = frame.color.timestamp_ns;
        self.stats.pairs += 1;
        let first_stamp = *self.first_stamp.get_or_insert(stamp);
        self.stats.duration_s = stamp.saturating_sub(first_stamp) as f64 * 1e-9;

        // Depth to points and normals, colour to a grey pyramid.
        stage("preprocess", || self.frame.fill(frame, &self.rig, &self.config));
        let (gap_s, readout_s) = (self.depth_gap(frame), self.timing.readout_s);
        let velocity = self.recent_velocity().unwrap_or_default();
        self.frame.synchronise(&Motion { velocity, gap_s, readout_s }, &self.rig);
        // Where is the camera?
        let found = stage("track", || match self.state {
            _ if self.is_blind() => None,
            None => Some(self.first_pose()),
            // After a gap the camera may be anywhere.
            Some(Tracking::Tracked) if seconds(self.last_stamp, stamp) <= MAX_PREDICTION_S => self.track(stamp),
            Some(_) => self.relocalise(stamp),
        });
        let Some(pose) = found else { return Ok(self.lose()) };
        self.hold(&pose, stamp);
        // Depth into the volume.
        self.fuse_depth(&pose);
        if self.leave_fine_voxels() {
            // Once more, so that what is told reaches as far from the surface as the truncation distance does now.
            self.fuse_depth(&pose);
        }
        let coarsened = self.make_room();
        // What the next frames are tracked against.
        stage("remember", || self.remember(&pose));
        // A picture with holes is no keyframe.
        let whole = frame.color.missing_packets == 0;
        let offer = || whole.then(|| self.candidates.offer(&self.frame, &pose, &self.config)).flatten();
        let keep = stage("keyframes", offer);
        std::mem::swap(&mut self.frame, &mut self.last);
        Ok(FrameReport {
            tracking: Tracking::Tracked,
            world_from_camera: Some(pose),
            keep,
            blocks_used: self.volume.used() as u64,
            voxel_size_m: f64::from(self.volume.voxel_m()),
            coarsened,
        })
    }

    /// Extracts the mesh and chooses the keyframes.
    #[must_use]
    pub fn finish(self) -> FusionOutput {
        let threshold = extract::Threshold {
            min_weight: self.config.min_weight as f32,
            share: self.config.min_weight_share as f32,
            min_triangles: self.config.min_component_triangles as usize,
        };
        let Timing { delay_s, readout_s, .. } = self.timing;
        tracing::debug!(delay_s, readout_s, "instants as learnt");
        let mut stats = self.stats;
        stats.voxel_size_m = f64::from(self.volume.voxel_m());
        stats.blocks_used = self.volume.used() as u64;
        stats.blocks_total = self.volume.capacity() as u64;
        // What is no longer needed goes before the next thing grows.
        drop((self.anchors, self.reference, self.integrator));
        let mut mesh = extract::extract(&self.volume, &threshold);
        drop(self.volume);
        visible::drop_unseen(&mut mesh, self.candidates.poses(), &self.rig.grey[0]);
        extract::drop_specks(&mut mesh, threshold.min_triangles);
        let chosen = self.candidates.choose(&mesh, &self.rig, &self.config);
        stats.keyframe_coverage = chosen.coverage;
        FusionOutput {
            mesh,
            trajectory: self.trajectory,
            keyframes: chosen.keyframes,
            witnesses: chosen.witnesses,
            stats,
        }
    }

    fn check(&self, frame: &RgbdFrame) -> Result<(), FusionError> {
        let depth = (self.rig.depth.width, self.rig.depth.height);
        let (d, c) = (&frame.depth, &frame.rgb);
        if (d.width as usize, d.height as usize) != depth || d.depth.len() != depth.0 * depth.1 {
            let text = format!("a depth frame of {} × {}, not {} × {}", d.width, d.height, depth.0, depth.1);
            return Err(FusionError::BadFrame(text));
        }
        let color = self.rig.color_size;
        if (c.width, c.height) != color || c.data.len() != 3 * color.0 as usize * color.1 as usize {
            let text = format!("a colour frame of {} × {}, not {} × {}", c.width, c.height, color.0, color.1);
            return Err(FusionError::BadFrame(text));
        }
        Ok(())
    }

    /// True if the frame shows nothing: a covered lens, a black picture, no depth.
    fn is_blind(&self) -> bool {
        self.frame.valid < self.config.tuning.tracking.min_valid_share as f32
            || self.frame.mean_grey < self.config.black_below as f32
    }

    /// Twist per second over the last frames, camera axes; `None` unless they were tracked one after another.
    fn recent_velocity(&self) -> Option<Vector6<f64>> {
        let recent = &self.trajectory[self.trajectory.len().saturating_sub(self.streak.min(VELOCITY_FRAMES))..];
        let ((t0, first), (t1, last)) = (recent.first()?, recent.last()?);
        let span = seconds(*t0, *t1);
        let known = span > 0.0 && span <= VELOCITY_FRAMES as f64 * MAX_PREDICTION_S;
        known.then(|| tracking::log(&first.inverse().compose(last)) / span)
    }

    /// From the depth image's instant to the colour image's, seconds; 0 if they are too far apart.
    fn depth_gap(&self, frame: &RgbdFrame) -> f64 {
        let depth = frame.depth.timestamp_ns.saturating_add(self.rig.depth_to_color_offset_ns);
        let gap = seconds(depth, frame.color.timestamp_ns) + self.timing.delay_s;
        if gap.abs() <= MAX_STAMP_GAP_S { gap } else { 0.0 }
    }

    fn first_pose(&self) -> Pose {
        self.up.map_or_else(camera::world_from_first_camera, camera::level_world)
    }

    fn scene<'a>(&'a self, reference: &'a Reference) -> Scene<'a> {
        Scene { frame: &self.frame, rig: &self.rig, reference, volume: &self.volume, config: &self.config }
    }

    /// Tracks from the last frame: prediction, rotation alone, frame to frame, frame to anchor and model.
    fn track(&mut self, stamp: TimestampNs) -> Option<Pose> {
        let last = self.reference.world_from_camera;
        let dt = seconds(self.last_stamp, stamp);
        let predicted = last.compose(&tracking::exp(&(self.velocity * dt)));
        let effort = effort::choose(&self.config, self.last_blocks, self.frame.valid);
        let mut tracker = std::mem::take(&mut self.tracker);

        let turn = predicted.rotation.conjugate() * last.rotation;
        let mut starts = vec![predicted];
        if let Some(camera_from_last) = rotate::align(&self.frame, &self.last.grey[camera::LEVELS - 1], &self.rig, turn)
        {
            starts.push(Pose::new(last.rotation * camera_from_last.conjugate(), predicted.translation));
        }
        let coarse = starts
            .iter()
            .map(|start| tracker.align(&self.scene(&self.reference), start, &predicted, effort.coarse))
            .min_by(|a, b| a.misfit().total_cmp(&b.misfit()));
        // How fast it went is known better now than from the frames before.
        if let Some(coarse) = &coarse {
            let velocity = tracking::log(&last.inverse().compose(&coarse.world_from_camera)) / dt.max(1e-3);
            self.frame.synchronise(&Motion { velocity, ..self.frame.motion }, &self.rig);
        }
        let fine = coarse.and_then(|coarse| {
            let anchor = &self.anchors.get(self.anchor)?.reference;
            Some((coarse, tracker.align(&self.scene(anchor), &coarse.world_from_camera, &predicted, effort.fine)))
        });
        self.tracker = tracker;
        let (coarse, fine) = fine?;
        let pose = fine.world_from_camera;
        let moved = tracking::log(&last.inverse().compose(&pose));
        let dt = dt.max(1.0 / 60.0);
        let (way, turn) = (moved.fixed_rows::<3>(0).norm(), moved.fixed_rows::<3>(3).norm());
        let possible = way <= (self.config.max_speed_m_s * dt).min(self.config.max_step_m)
            && turn <= (self.config.max_turn_rad_s * dt).min(self.config.max_step_rad);
        let alike = self.looks_alike(&pose);
        tracing::trace!(?coarse, ?fine, possible, alike, timing = ?self.timing, "tracked");
        if !(possible && alike && self.holds(&coarse, &fine)) {
            return None;
        }
        if self.streak >= VELOCITY_FRAMES
            && self.frame.motion.speed(self.frame.median_depth) > LEAST_SPEED
            && let (Some(anchor), Some(step)) = (self.anchors.get(self.anchor), effort.fine.last())
        {
            let system = self.tracker.timing(&self.scene(&anchor.reference), &fine, step);
            self.timing.learn(&system, &self.config);
        }
        Some(pose)
    }

    /// False if the frame looks like neither the anchor nor the last frame did from there: round things on a round table
    /// have the same depth from all sides.
    fn looks_alike(&self, pose: &Pose) -> bool {
        let anchor = self.anchors.get(self.anchor).map(|a| &a.reference);
        let references = anchor.into_iter().chain([&self.reference]);
        let likeness: Vec<f32> = references.filter_map(|r| tracking::likeness(&self.scene(r), pose)).collect();
        tracing::trace!(?likeness, "looks");
        likeness.is_empty() || likeness.iter().any(|l| *l >= DOUBTFUL * self.config.min_likeness as f32)
    }

    /// True if enough of the frame agrees with the model, or, where the model is not known yet, with the last frame.
    fn holds(&self, coarse: &Alignment, fine: &Alignment) -> bool {
        let least = self.config.min_fit as f32;
        let agreement = fine.fit / fine.overlap.max(1e-3);
        fine.fit >= least || (coarse.fit >= least && agreement >= 0.6 && fine.overlap >= 0.1)
    }

    /// Looks for the camera where it was, where its motion would have taken it, and near the anchors that look like the frame.
    fn relocalise(&mut self, stamp: TimestampNs) -> Option<Pose> {
        let mut tracker = std::mem::take(&mut self.tracker);
        let mut tries = vec![self.anchor];
        tries.extend(self.anchors.alike(&self.frame, self.config.tuning.tracking.relocalisation_tries as usize));
        let last = self.reference.world_from_camera;
        let dt = seconds(self.last_stamp, stamp);
        // In small steps: who goes around something does not go straight on.
        let step = tracking::exp(&(self.velocity * (dt / COASTING_STEPS as f64)));
        let carried_on = (dt <= MAX_COASTING_S).then(|| (0..COASTING_STEPS).fold(last, |pose, _| pose.compose(&step)));
        let mut best: Option<Found> = None;
        for (n, i) in tries.into_iter().enumerate() {
            let Some(anchor) = self.anchors.get(i) else { continue };
            let at = anchor.reference.world_from_camera;
            let turned = rotate::align(&self.frame, &anchor.grey, &self.rig, DQuat::IDENTITY)
                .map(|camera_from_anchor| Pose::new(at.rotation * camera_from_anchor.conjugate(), at.translation));
            let [last, carried_on] = [Some(last), carried_on].map(|pose| pose.filter(|_| n == 0));
            let starts = [Some(at), turned, last, carried_on];
            best = better(best, self.find_from(&mut tracker, i, starts.into_iter().flatten()));
        }
        // From there, by the anchor nearest to it, until it gets no better.
        for _ in 0..POLISHING_ROUNDS {
            let Some(found) = best else { break };
            let pose = found.alignment.world_from_camera;
            let (distance, angle) = (self.config.anchor_distance, self.config.anchor_angle_rad);
            let Some((nearest, _)) = self.anchors.nearest(&pose, distance, angle) else { break };
            let polished = self.find_from(&mut tracker, nearest, [pose].into_iter());
            let gain = polished.map_or(0.0, |p| p.score() - found.score());
            best = better(best, polished);
            if gain < LEAST_GAIN {
                break;
            }
        }
        self.tracker = tracker;
        let Found { alignment: found, likeness, anchor } = best?;
        // A wrong place must not be fused: more agreement is asked of it than of a tracked frame. The picture is compared
        // by correlation, since its exposure and its blur may be others than the anchor's.
        let strict = (1.5 * self.config.min_fit as f32).min(0.9);
        let alike = likeness >= self.config.min_likeness as f32;
        if found.fit < strict || found.fit < 0.7 * found.overlap || found.photo_seen < 0.3 || !alike {
            return None;
        }
        self.anchor = anchor;
        Some(found.world_from_camera)
    }

    /// The best alignment to an anchor from several starts.
    fn find_from(&self, tracker: &mut Tracker, i: usize, starts: impl Iterator<Item = Pose>) -> Option<Found> {
        let scene = self.scene(&self.anchors.get(i)?.reference);
        let coarse = starts
            .map(|start| tracker.align(&scene, &start, &start, &effort::FIND))
            .min_by(|a, b| a.misfit().total_cmp(&b.misfit()))?;
        let start = coarse.world_from_camera;
        let fine = tracker.align(&scene, &start, &start, effort::best().fine);
        let likeness = tracking::likeness(&scene, &fine.world_from_camera).unwrap_or(0.0);
        tracing::trace!(i, ?coarse, ?fine, likeness, "relocalisation");
        Some(Found { alignment: fine, likeness, anchor: i })
    }

    fn lose(&mut self) -> FrameReport {
        self.stats.lost_pairs += 1;
        if self.state == Some(Tracking::Tracked) {
            self.stats.losses += 1;
            self.state = Some(Tracking::Lost);
            self.streak = 0;
        }
        FrameReport {
            tracking: Tracking::Lost,
            world_from_camera: None,
            keep: None,
            blocks_used: self.volume.used() as u64,
            voxel_size_m: f64::from(self.volume.voxel_m()),
            coarsened: false,
        }
    }

    fn hold(&mut self, pose: &Pose, stamp: TimestampNs) {
        self.stats.tracked_pairs += 1;
        self.streak += 1;
        let dt = seconds(self.last_stamp, stamp);
        self.velocity = match self.state {
            Some(Tracking::Tracked) if dt > 1e-3 => {
                tracking::log(&self.reference.world_from_camera.inverse().compose(pose)) / dt
            }
            _ => Vector6::zeros(),
        };
        self.stats.relocalisations += u64::from(self.state == Some(Tracking::Lost));
        self.state = Some(Tracking::Tracked);
        self.last_stamp = stamp;
        self.trajectory.push((stamp, *pose));
    }

    /// Integrates the frame as seen from `pose`.
    fn fuse_depth(&mut self, pose: &Pose) {
        let motion = self.frame.motion;
        let world_from_depth = pose.compose(&motion.color_from_row(0.0)).compose(&self.rig.color_from_depth);
        let sweep = motion.of_depth(&self.rig);
        let integrated = stage("integrate", || {
            self.integrator.integrate(&mut self.volume, &self.rig, &self.frame.depth, &world_from_depth, &sweep)
        });
        self.stats.blocks_refused += integrated.refused;
        self.last_blocks = integrated.blocks;
        tracing::trace!(blocks = integrated.blocks, "integrated");
    }

    /// Goes over to voxels of the length that was asked for when fine ones become dear, or say more than depth does.
    fn leave_fine_voxels(&mut self) -> bool {
        let fine = f64::from(self.volume.voxel_m()) < 0.75 * self.config.voxel_size_m;
        let far = self.frame.median_depth;
        let noisy = FINE_SIGMAS * camera::depth_sigma(far) > self.volume.truncation_m();
        let rough = far > FINE_PIXELS * self.volume.voxel_m() * self.rig.depth.fx;
        let dear = self.last_blocks > self.config.fine_blocks as usize;
        if !fine || !(noisy || rough || dear || self.is_nearly_full()) {
            return false;
        }
        self.coarsen();
        tracing::info!(voxel_m = self.volume.voxel_m(), noisy, rough, dear, "no more fine voxels");
        true
    }

    /// Coarsens the volume when the pool is nearly full and a coarser voxel is allowed.
    fn make_room(&mut self) -> bool {
        if !self.is_nearly_full() || f64::from(self.volume.voxel_m()) * 2.0 > self.config.max_voxel_size_m * 1.001 {
            return false;
        }
        self.coarsen();
        self.stats.coarsenings += 1;
        true
    }

    fn is_nearly_full(&self) -> bool {
        self.volume.used() as f64 >= self.config.coarsen_at * self.volume.capacity() as f64
    }

    fn coarsen(&mut self) {
        self.volume.coarsen();
        self.integrator.coarsened();
    }

    /// Keeps the frame as the next one's reference, and changes to another anchor where this one is too far away.
    fn remember(&mut self, pose: &Pose) {
        self.reference.fill(&self.frame, &self.rig, pose, 1..camera::LEVELS);
        let (distance, angle) = (self.config.anchor_distance, self.config.anchor_angle_rad);
        match self.anchors.nearest(pose, distance, angle) {
            Some((i, d)) if d <= 1.0 => self.anchor = i,
            _ => {
                let mut reference = Reference::default();
                reference.fill(&self.frame, &self.rig, pose, 0..camera::LEVELS);
                self.anchor = self.anchors.add(reference, &self.frame);
            }
        }
    }
}

/// Runs a stage inside a tracing span of its name, by which benchmarks tell the stages apart.
fn stage<T>(name: &'static str, f: impl FnOnce() -> T) -> T {
    let _span = match name {
        "preprocess" => tracing::debug_span!("preprocess"),
        "track" => tracing::debug_span!("track"),
        "integrate" => tracing::debug_span!("integrate"),
        "remember" => tracing::debug_span!("remember"),
        _ => tracing::debug_span!("keyframes"),
    }
    .entered();
    f()
}

fn seconds(from: TimestampNs, to: TimestampNs) -> f64 {
    to.saturating_sub(from) as f64 * 1e-9
}
