//! Pose refinement: all keyframes against common lit colours, each against colours without its own observations.

use crate::association::alignment::{Alignment, ExpectedMotion, Motion, PoseDeviation, align, pose_of};
use crate::association::context::AssociationContext;
use crate::association::keyframe_image::KeyframeImage;
use crate::association::light_field::LightField;
use crate::association::lit_color::LitColors;
use crate::association::observations::RefinedView;
use crate::mesh::raster::Raster;
use crate::numerics::robust::median;
use firmware_config::tuning::PoseTuning;
use glam::Vec3;
use rayon::prelude::*;
use recordings::decision::Decision;
use recordings::types::Pose;

/// Rounds that are made even if poses hardly move: they add pyramid levels.
const MIN_ROUNDS: u32 = 2;
/// Rounds from given poses until every pyramid level has been used and the finest has converged.
const TURNING_ROUNDS: u32 = 3;
/// Fewer motions do not tell what they have in common.
const MIN_COMMON: usize = 3;
/// A lit colour without the keyframe's own observations needs this share of the vertex's weight.
const MIN_REST: f32 = 0.05;

/// Refines all poses, round by round.
pub struct PoseRefiner {
    /// Given poses, `[keyframe]`.
    given: Vec<Pose>,
    /// Sum of the steps since the given pose, `[keyframe]`.
    moved: Vec<Motion>,
    /// The round from which on the given translations stay, since the pictures do not tell them from rotations.
    turns_from: Option<u32>,
    /// The keyframe ran away and is held by the others' deviation, `[keyframe]`.
    held: Vec<bool>,
    /// RMS step in pixels, `[round]`.
    history: Vec<f64>,
    first_residual: f64,
    last_residual: f64,
}

impl PoseRefiner {
    /// Starts at the given poses.
    pub fn new(given: Vec<Pose>) -> Self {
        let keyframes = given.len();
        Self {
            given,
            moved: vec![Motion::zeros(); keyframes],
            turns_from: None,
            held: vec![false; keyframes],
            history: vec![],
            first_residual: 0.0,
            last_residual: 0.0,
        }
    }

    /// One round over all keyframes, from coarse to fine. Returns false if the poses have converged.
    pub fn step(
        &mut self,
        context: &AssociationContext,
        images: &[Option<KeyframeImage>],
        (field, rasters): (&LightField, &[Option<Raster>]),
        lit: &LitColors,
        views: &mut [RefinedView],
        round: u32,
    ) -> bool {
        let levels: &[f64] = match round - self.turns_from.unwrap_or(0) {
            0 => &[0.25, 0.5],
            1 => &[0.5, 1.0],
            _ => &[1.0],
        };
        let filled = fill(context, &lit.color, &lit.weight);
        let own = of_keyframes(field, views.len());
        let tuning = &context.config.tuning.pose;
        let expected = if context.poses_are_tracked { self.tracked(tuning) } else { ExpectedMotion::given(tuning) };
        let deviation = self.hold_runaways(&expected.common, tuning);
        let alignments: Vec<Option<Alignment>> = (0..views.len())
            .into_par_iter()
            .map(|j| {
                let image = images[j].as_ref()?;
                let colors = without_own(field, lit, &filled, &views[j], &own[j]);
                let rotation_alone = self.turns_from.map(|_| PoseDeviation::ROTATION_ALONE);
                let expected =
                    ExpectedMotion { held: rotation_alone.or(deviation.filter(|_| self.held[j])), ..expected };
                let mut total: Option<Alignment> = None;
                for &level in levels {
                    let mut view = views[j];
                    let mut moved = self.moved[j];
                    if let Some(a) = &total {
                        view.world_from_camera = a.pose;
                        moved = a.moved;
                    }
                    // Where the keyframe has not moved yet, it is drawn as it was for the observations.
                    let known = rasters[j].as_ref().filter(|_| total.is_none());
                    if let Some(next) = align(context, image, (&colors, known), &view, &moved, &expected, level) {
                        let step_px = libm::hypot(total.as_ref().map_or(0.0, |t| t.step_px), next.step_px);
                        total = Some(Alignment { step_px, ..next });
                    }
                }
                total
            })
            .collect();
        // Each keyframe follows where the others were, and what tracking expects of it holds it back: steps on the finest level shrink by
        // a fixed share only.
        let is_slow = context.poses_are_tracked && levels == [1.0];
        let is_steady = is_slow && self.history.last_chunk::<2>().is_none_or(|[one, next]| next <= one);
        let (mut squares, mut before, mut after, mut count) = (0.0, 0.0, 0.0, 0.0);
        let mut moved_px = [Vec::new(), Vec::new()];
        for (j, alignment) in alignments.into_iter().enumerate() {
            let Some(mut a) = alignment else { continue };
            if is_steady {
                let more = (a.moved - self.moved[j]) * (context.config.tuning.pose.over_relaxation - 1.0);
                a.pose = a.pose.compose(&pose_of(&more).inverse());
                a.moved += more;
            }
            views[j].world_from_camera = a.pose;
            views[j].residual_px = a.step_px;
            self.moved[j] = a.moved;
            moved_px.iter_mut().zip(a.moved_px).for_each(|(all, px)| all.push(px));
            squares += a.step_px * a.step_px;
            before += a.before;
            after += a.after;
            count += 1.0;
        }
        if count == 0.0 {
            return false;
        }
        if self.history.is_empty() {
            self.first_residual = before / count;
        }
        self.last_residual = after / count;
        let rms = f64::sqrt(squares / count);
        self.history.push(rms);
        // Steps from coarse pictures do not count yet.
        let is_due = round >= MIN_ROUNDS && self.turns_from.is_none() && !context.poses_are_tracked;
        if is_due && is_ambiguous(moved_px, &context.config.tuning.pose) {
            self.restart(views, round + 1);
            return true;
        }
        rms > context.config.tuning.pose.converged_px || round < MIN_ROUNDS
    }

    /// Rounds to make, of these at most: one that began again is not left at the given poses.
    pub fn rounds(&self, most: u32) -> u32 {
        self.turns_from.map_or(most, |first| most.max(first + TURNING_ROUNDS))
    }

    /// Back to the given poses, which from this round on only turn.
    fn restart(&mut self, views: &mut [RefinedView], round: u32) {
        self.turns_from = Some(round);
        self.moved.fill(Motion::zeros());
        self.held.fill(false);
        views.iter_mut().zip(&self.given).for_each(|(view, given)| view.world_from_camera = *given);
    }

    /// Marks keyframes that moved much farther than the others: what they show does not hold them. Returns the deviation of the
    /// given poses, if enough keyframes tell it.
    fn hold_runaways(&mut self, common: &Motion, tuning: &PoseTuning) -> Option<PoseDeviation> {
        let off: Vec<Motion> = self.aligned().map(|m| m - common).collect();
        let deviation = PoseDeviation::of(&off).filter(|_| off.len() >= tuning.deviation_keyframes as usize)?;
        for (held, moved) in self.held.iter_mut().zip(&self.moved).filter(|(_, m)| has_moved(m)) {
            *held |= deviation.is_exceeded_by(&(moved - common), tuning.runaway_deviations);
        }
        Some(deviation)
    }

    /// The motions of the keyframes that were aligned.
    fn aligned(&self) -> impl Iterator<Item = &Motion> {
        self.moved.iter().filter(|m| has_moved(m))
    }

    /// Tracked poses are right among each other but for a little: what the keyframes' motions have in common, as where the sensor
    /// takes its colour camera to be, is found from all of them. Too few keyframes do not tell it.
    fn tracked(&self, tuning: &PoseTuning) -> ExpectedMotion {
        let is_told = self.aligned().count() >= MIN_COMMON;
        let middle = |r: usize| median(self.aligned().map(|m| m[r])).filter(|_| is_told);
        let common = Motion::from_fn(|r, _| middle(r).unwrap_or(0.0));
        let deviation_px = if self.given.len() < MIN_COMMON { tuning.prior_px } else { tuning.tracked_px };
        ExpectedMotion { common, deviation_px, held: None }
    }

    /// Steps and residuals as evidence.
    pub fn decision(&self, refined: bool) -> Decision {
        Decision::Pose {
            refined,
            steps_px: self.history.clone(),
            first_residual: self.first_residual,
            last_residual: self.last_residual,
        }
    }
}

/// False for a keyframe that was not aligned.
fn has_moved(motion: &Motion) -> bool {
    motion.norm() > 0.0
}

/// Long motions whose translations rotations mostly undo again: far surfaces without relief tell the two apart by little, and what is
/// found is an error of the colours. `px` has the keyframes' motions in pixels: all of it, and the translation's part.
fn is_ambiguous(px: [Vec<f64>; 2], tuning: &PoseTuning) -> bool {
    match px.map(median) {
        [Some(all), Some(translation)] => all > tuning.ambiguous_px && translation > tuning.ambiguous_share * all,
        _ => false,
    }
}

/// The pose at which an image fits these lit colours best, starting at the pose of `view`, at these levels of its pyramid in turn. The
/// image must not have contributed to the colours.
#[must_use]
pub fn located(
    context: &AssociationContext,
    image: &KeyframeImage,
    color: &[Vec3],
    weight: &[f32],
    view: &RefinedView,
    levels: &[f64],
) -> Pose {
    let colors = fill(context, color, weight);
    let mut found = *view;
    let mut moved = Motion::zeros();
    let expected = ExpectedMotion::given(&context.config.tuning.pose);
    for &level in levels {
        if let Some(a) = align(context, image, (&colors, None), &found, &moved, &expected, level) {
            (found.world_from_camera, moved) = (a.pose, a.moved);
        }
    }
    found.world_from_camera
}

/// Lit colours, `[vertex]`, extended over rings of unseen vertices by means of neighbours; NaN farther away.
fn fill(context: &AssociationContext, color: &[Vec3], weight: &[f32]) -> Vec<Vec3> {
    let known = color.iter().zip(weight).map(|(&c, &w)| (w > 0.0 && !c.is_nan()).then_some(c));
    let mut colors: Vec<Option<Vec3>> = known.collect();
    context.graph.fill(&mut colors, context.config.tuning.pose.fill_rings as usize);
    colors.into_iter().map(|c| c.unwrap_or(Vec3::NAN)).collect()
}

/// Numbers of the observations of every keyframe.
fn of_keyframes(field: &LightField, keyframes: usize) -> Vec<Vec<u32>> {
    let mut own = vec![Vec::new(); keyframes];
    (0u32..).zip(&field.observations).for_each(|(n, o)| own[o.keyframe as usize].push(n));
    own
}

/// The colours without a keyframe's `own` observations; NaN where no other keyframe saw the vertex.
fn without_own(field: &LightField, lit: &LitColors, filled: &[Vec3], view: &RefinedView, own: &[u32]) -> Vec<Vec3> {
    let mut colors = filled.to_vec();
    let factor = Vec3::from_array(view.gain.map(|g| (1.0 / g) as f32));
    for &n in own {
        let (o, used) = (&field.observations[n as usize], lit.used[n as usize]);
        let i = o.vertex as usize;
        let rest = lit.weight[i] - used;
        colors[i] = if rest > MIN_REST * lit.weight[i] {
            (lit.color[i] * lit.weight[i] - Vec3::from_array(o.color) * factor * used) / rest
        } else {
            Vec3::NAN
        };
    }
    colors
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tracked_poses_stay_near_what_their_motions_have_in_common() {
        let tuning = PoseTuning::default();
        let motion = |x: f64| Motion::from([0.01, x, 0.0, 0.0, 0.02, x]);
        let mut refiner = PoseRefiner::new(vec![Pose::IDENTITY; 6]);
        let zero = refiner.tracked(&tuning);
        assert_eq!((zero.common, zero.deviation_px), (Motion::zeros(), tuning.tracked_px));
        // One that was not aligned, and one that ran away.
        refiner.moved = [-0.003, 0.0, 0.002, 0.004, 0.9].map(motion).into_iter().chain([Motion::zeros()]).collect();
        let common = refiner.tracked(&tuning).common;
        assert!((common - motion(0.002)).norm() < 1e-12, "{common}");
        let few = PoseRefiner::new(vec![Pose::IDENTITY; 2]).tracked(&tuning);
        assert_eq!((few.common, few.deviation_px), (Motion::zeros(), tuning.prior_px));
    }

    #[test]
    fn translations_that_rotations_undo_are_ambiguous() {
        let tuning = PoseTuning::default();
        // Pixels in all, and by the translation alone.
        assert!(is_ambiguous([vec![1.3, 2.1, 1.7], vec![3.4, 4.5, 6.7]], &tuning), "a closed room");
        assert!(!is_ambiguous([vec![0.9, 0.7, 1.2], vec![3.1, 4.2, 2.9]], &tuning), "one plain body");
        assert!(!is_ambiguous([vec![2.6, 2.7, 2.0], vec![2.3, 2.5, 2.0]], &tuning), "things on a table");
        assert!(!is_ambiguous([vec![0.01; 3], vec![0.1; 3]], &tuning), "poses that were right");
        assert!(!is_ambiguous([vec![], vec![]], &tuning), "nothing was aligned");
    }
}
