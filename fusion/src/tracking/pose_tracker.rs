//! The pose of the camera from frame to frame: motion prior, tracking, loss, references.

use crate::camera::rig::{LEVELS, Rig};
use crate::camera::rolling_shutter::Motion;
use crate::camera::twist::{exp, log};
use crate::frame::grey::Grey;
use crate::frame::preprocess::Frame;
use crate::report::{Margin, Tracking};
use crate::tracking::align::Aligner;
use crate::tracking::anchors::Anchors;
use crate::tracking::effort::Effort;
use crate::tracking::margin::{Evidence, margin};
use crate::tracking::ncc::ncc;
use crate::tracking::problem::AlignmentContext;
use crate::tracking::reference::Reference;
use crate::tracking::timing::Timing;
use crate::tracking::{gates, rotate};
use firmware_config::FusionConfig;
use nalgebra::Vector6;
use recordings::types::{Pose, RgbdFrame, TimestampNs};

/// Shortest interval from which a velocity is computed, seconds.
const MIN_INTERVAL_S: f64 = 1e-3;

/// State of tracking.
pub struct PoseTracker {
    pub(super) aligner: Aligner,
    pub(super) anchors: Anchors,
    /// Number of the current anchor.
    pub(super) anchor: usize,
    /// The last tracked frame.
    pub(super) reference: Reference,
    /// Its coarsest grey level.
    last_grey: Grey,
    pub(super) last_stamp: TimestampNs,
    /// Twist of the camera per second (translation in metres, rotation in radians), camera axes.
    pub(super) velocity: Vector6<f64>,
    timing: Timing,
    /// Frames tracked without interruption.
    streak: usize,
    /// `None` before the first tracked frame.
    state: Option<Tracking>,
    trajectory: Vec<(TimestampNs, Pose)>,
    /// Of the current frame, if it was tracked from the last one.
    pub(super) margin: Option<Margin>,
}

impl PoseTracker {
    /// No frame tracked yet.
    pub fn new(config: &FusionConfig) -> Self {
        Self {
            aligner: Aligner::default(),
            anchors: Anchors::new(config.max_anchors as usize),
            anchor: 0,
            reference: Reference::default(),
            last_grey: Grey::default(),
            last_stamp: 0,
            velocity: Vector6::zeros(),
            timing: Timing::default(),
            streak: 0,
            state: None,
            trajectory: Vec::new(),
            margin: None,
        }
    }

    /// State after the last frame; `None` before the first tracked frame.
    pub fn state(&self) -> Option<Tracking> {
        self.state
    }

    /// How far the current frame is from being lost.
    pub fn margin(&self) -> Option<Margin> {
        self.margin
    }

    /// Time since the last tracked frame, seconds.
    pub fn age_s(&self, stamp: TimestampNs) -> f64 {
        seconds(self.last_stamp, stamp)
    }

    /// Poses of the tracked frames.
    pub fn into_trajectory(self) -> Vec<(TimestampNs, Pose)> {
        let Timing { delay_s, readout_s, .. } = self.timing;
        tracing::debug!(delay_s, readout_s, "estimated timing");
        self.trajectory
    }

    /// Motion of the camera during a new frame, from the frames before it.
    pub fn predict_motion(&self, frame: &RgbdFrame, rig: &Rig, config: &FusionConfig) -> Motion {
        let depth = frame.depth.timestamp_ns.saturating_add(rig.depth_to_color_offset_ns);
        let gap_s = seconds(depth, frame.color.timestamp_ns) + self.timing.delay_s;
        // Stamps too far apart are wrong.
        let gap_s = if gap_s.abs() <= config.tuning.timing.max_stamp_gap_s { gap_s } else { 0.0 };
        Motion { velocity: self.recent_velocity(config).unwrap_or_default(), gap_s, readout_s: self.timing.readout_s }
    }

    /// Mean twist per second over the last frames, camera axes; `None` unless they were tracked without interruption.
    fn recent_velocity(&self, config: &FusionConfig) -> Option<Vector6<f64>> {
        let frames = config.tuning.timing.velocity_frames as usize;
        let recent = &self.trajectory[self.trajectory.len().saturating_sub(self.streak.min(frames))..];
        let ((t0, first), (t1, last)) = (recent.first()?, recent.last()?);
        let span = seconds(*t0, *t1);
        let known = span > 0.0 && span <= frames as f64 * config.tuning.tracking.max_prediction_s;
        known.then(|| log(&first.inverse().compose(last)) / span)
    }

    /// Tracks a frame from the last one: motion prior, rotation search, frame to frame, frame to anchor and model, gates.
    pub fn track(
        &mut self,
        frame: &mut Frame,
        context: AlignmentContext,
        stamp: TimestampNs,
        effort: &Effort,
    ) -> Option<Pose> {
        let AlignmentContext { rig, config, .. } = context;
        self.margin = None;
        let last = self.reference.world_from_camera;
        let dt = self.age_s(stamp);
        let predicted = last.compose(&exp(&(self.velocity * dt)));
        let mut starts = vec![predicted];
        let turn = predicted.rotation.conjugate() * last.rotation;
        if let Some(camera_from_last) = rotate::align(frame, &self.last_grey, rig, turn, config) {
            starts.push(Pose::new(last.rotation * camera_from_last.conjugate(), predicted.translation));
        }
        let frame_to_frame = context.problem(frame, &self.reference);
        let coarse = starts
            .iter()
            .map(|start| self.aligner.align(&frame_to_frame, start, &predicted, effort.coarse))
            .min_by(|a, b| a.cost(&config.tuning.tracking).total_cmp(&b.cost(&config.tuning.tracking)))?;
        // The coarse alignment gives a better velocity than the frames before.
        let velocity = log(&last.inverse().compose(&coarse.world_from_camera)) / dt.max(MIN_INTERVAL_S);
        frame.synchronise(&Motion { velocity, ..frame.motion }, rig);

        let frame_to_anchor = context.problem(frame, &self.anchors.get(self.anchor)?.reference);
        let fine = self.aligner.align(&frame_to_anchor, &coarse.world_from_camera, &predicted, effort.fine);
        let pose = fine.world_from_camera;
        let twist = log(&last.inverse().compose(&pose));
        let plausible = gates::is_plausible_motion(&twist, dt, config);
        let references = [frame_to_anchor, context.problem(frame, &self.reference)];
        let correlations: Vec<f32> = references.iter().filter_map(|r| ncc(r, &pose)).collect();
        tracing::trace!(?coarse, ?fine, plausible, ?correlations, timing = ?self.timing, "tracked");
        if !(plausible
            && gates::agrees_with_images(&correlations, config)
            && gates::agrees_with_geometry(&coarse, &fine, config))
        {
            return None;
        }
        let anchor = frame_to_anchor.reference;
        let (coarse, correlations) = (&coarse, &correlations);
        let evidence =
            Evidence { frame: frame_to_anchor.frame, anchor, coarse, fine: &fine, correlations, twist, dt_s: dt };
        self.margin = Some(margin(&evidence, config));
        let tuning = &config.tuning.timing;
        if self.streak >= tuning.velocity_frames as usize
            && frame.motion.speed(frame.median_depth) > tuning.min_speed_m_s
            && let Some(stage) = effort.fine.last()
        {
            self.timing.update(&self.aligner.timing_system(&frame_to_anchor, &fine, stage), config);
        }
        Some(pose)
    }

    /// Takes over the pose of the current frame.
    pub fn accept_pose(&mut self, pose: &Pose, stamp: TimestampNs) {
        let dt = self.age_s(stamp);
        self.velocity = match self.state {
            Some(Tracking::Tracked) if dt > MIN_INTERVAL_S => {
                log(&self.reference.world_from_camera.inverse().compose(pose)) / dt
            }
            _ => Vector6::zeros(),
        };
        self.streak += 1;
        self.state = Some(Tracking::Tracked);
        self.last_stamp = stamp;
        self.trajectory.push((stamp, *pose));
    }

    /// Notes that the pose of the current frame is unknown.
    pub fn mark_lost(&mut self) {
        if self.state == Some(Tracking::Tracked) {
            self.state = Some(Tracking::Lost);
            self.streak = 0;
        }
        self.margin = None;
    }

    /// Keeps a tracked frame as the reference of the next one, and changes to the nearest anchor; the frame becomes an anchor
    /// if there is none within `fusion.anchor_distance` and `anchor_angle_rad`.
    pub fn update_references(&mut self, frame: &Frame, pose: &Pose, rig: &Rig, config: &FusionConfig) {
        let min_gradient = config.tuning.tracking.min_grey_gradient as f32;
        self.reference.fill(frame, rig, pose, 1..LEVELS, min_gradient);
        self.last_grey.clone_from(&frame.grey[LEVELS - 1]);
        match self.anchors.nearest(pose, config.anchor_distance, config.anchor_angle_rad) {
            Some((i, d)) if d <= 1.0 => self.anchor = i,
            _ => {
                let mut reference = Reference::default();
                reference.fill(frame, rig, pose, 0..LEVELS, min_gradient);
                self.anchor = self.anchors.add(reference, frame);
            }
        }
    }
}

fn seconds(from: TimestampNs, to: TimestampNs) -> f64 {
    to.saturating_sub(from) as f64 * 1e-9
}
