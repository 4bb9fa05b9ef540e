//! Relocalisation: the pose of a lost camera.

use crate::camera::twist::exp;
use crate::frame::preprocess::Frame;
use crate::tracking::align::Alignment;
use crate::tracking::ncc::ncc;
use crate::tracking::pose_tracker::PoseTracker;
use crate::tracking::problem::AlignmentContext;
use crate::tracking::{effort, gates, rotate};
use glam::DQuat;
use recordings::types::{Pose, TimestampNs};

/// Steps of the integration of the velocity.
const EXTRAPOLATION_STEPS: usize = 16;

/// A possible pose of a lost camera.
#[derive(Debug, Clone, Copy)]
struct Hypothesis {
    alignment: Alignment,
    /// Correlation with the anchor's image.
    ncc: f32,
    /// Number of the anchor.
    anchor: usize,
}

impl Hypothesis {
    fn score(&self) -> f32 {
        self.alignment.fit + self.ncc
    }
}

fn better(a: Option<Hypothesis>, b: Option<Hypothesis>) -> Option<Hypothesis> {
    [a, b].into_iter().flatten().reduce(|a, b| if b.score() > a.score() { b } else { a })
}

impl PoseTracker {
    /// Searches from the last pose, from the extrapolated one, and from the anchors that look like the frame; refines the
    /// best hypothesis; returns it if it passes the gate.
    pub fn relocalise(&mut self, frame: &Frame, context: AlignmentContext, stamp: TimestampNs) -> Option<Pose> {
        let AlignmentContext { rig, config, .. } = context;
        self.margin = None;
        let tuning = &config.tuning.relocalisation;
        let mut tries = vec![self.anchor];
        tries.extend(self.anchors.most_similar(frame, config.tuning.tracking.relocalisation_tries as usize));
        let mut best = None;
        for (n, i) in tries.into_iter().enumerate() {
            let Some(anchor) = self.anchors.get(i) else { continue };
            let at = anchor.reference.world_from_camera;
            let turned = rotate::align(frame, &anchor.grey, rig, DQuat::IDENTITY, config)
                .map(|camera_from_anchor| Pose::new(at.rotation * camera_from_anchor.conjugate(), at.translation));
            let [last, extrapolated] = if n == 0 {
                [Some(self.reference.world_from_camera), self.extrapolate(stamp, tuning.max_extrapolation_s)]
            } else {
                [None, None]
            };
            let starts = [Some(at), turned, last, extrapolated];
            best = better(best, self.align_to_anchor(frame, context, i, starts.into_iter().flatten()));
        }
        for _ in 0..tuning.refinement_rounds {
            let Some(current) = best else { break };
            let pose = current.alignment.world_from_camera;
            let nearest = self.anchors.nearest(&pose, config.anchor_distance, config.anchor_angle_rad);
            let Some((nearest, _)) = nearest else { break };
            let refined = self.align_to_anchor(frame, context, nearest, [pose].into_iter());
            let gain = refined.map_or(0.0, |r| r.score() - current.score());
            best = better(best, refined);
            if gain < tuning.min_gain as f32 {
                break;
            }
        }
        let found = best?;
        if !gates::accepts_relocalisation(&found.alignment, found.ncc, config) {
            return None;
        }
        self.anchor = found.anchor;
        Some(found.alignment.world_from_camera)
    }

    /// The last pose moved on by the last velocity, in small steps, since a camera that circles an object does not move
    /// straight on; `None` after more than `max_s` seconds.
    fn extrapolate(&self, stamp: TimestampNs, max_s: f64) -> Option<Pose> {
        let dt = self.age_s(stamp);
        let step = exp(&(self.velocity * (dt / EXTRAPOLATION_STEPS as f64)));
        let last = self.reference.world_from_camera;
        (dt <= max_s).then(|| (0..EXTRAPOLATION_STEPS).fold(last, |pose, _| pose.compose(&step)))
    }

    /// The best alignment to an anchor from several start poses.
    fn align_to_anchor(
        &mut self,
        frame: &Frame,
        context: AlignmentContext,
        anchor: usize,
        starts: impl Iterator<Item = Pose>,
    ) -> Option<Hypothesis> {
        let problem = context.problem(frame, &self.anchors.get(anchor)?.reference);
        let tuning = &context.config.tuning.tracking;
        let coarse = starts
            .map(|start| self.aligner.align(&problem, &start, &start, &effort::RELOCALISE))
            .min_by(|a, b| a.cost(tuning).total_cmp(&b.cost(tuning)))?;
        let start = coarse.world_from_camera;
        let fine = self.aligner.align(&problem, &start, &start, effort::best().fine);
        let ncc = ncc(&problem, &fine.world_from_camera).unwrap_or(0.0);
        tracing::trace!(anchor, ?coarse, ?fine, ncc, "relocalisation");
        Some(Hypothesis { alignment: fine, ncc, anchor })
    }
}
