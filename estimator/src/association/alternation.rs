//! The alternation of Eqs. (2)–(5): samples, exposures, lit colours and poses in turn.

use crate::api::Progress;
use crate::association::context::AssociationContext;
use crate::association::eligibility::EligibilityRules;
use crate::association::exposure::{self, Exposures};
use crate::association::exposure_patches::{ExposureProblem, Known};
use crate::association::haze::LeftOut;
use crate::association::keyframe_image::KeyframeImage;
use crate::association::lampless_air::LamplessAir;
use crate::association::light_field::LightField;
use crate::association::lit_color::lit_colors;
use crate::association::observations::{Association, Lens, RefinedView, always_clipped, are_exposed};
use crate::association::pose::PoseRefiner;
use crate::association::reliability::{reliability, turns};
use crate::association::seen_lamps::seen_lamps;
use crate::association::veil::Veil;
use firmware_config::Switch;
use rayon::prelude::*;
use recordings::types::{Keyframe, Pose};

/// Limits on the time that association takes.
pub struct AssociationEffort<'a> {
    /// Largest number of rounds of pose refinement.
    pub rounds: u32,
    /// Every `stride`-th keyframe is used.
    pub stride: usize,
    /// Called before every round with its number; `false` ends the refinement.
    pub go_on: &'a mut dyn FnMut(u32) -> bool,
}

/// A change of the vignetting, or of what white stands for, that colours do not show; a larger one asks for them once more, so many times.
const UNFELT: f64 = 0.01;
const UNFELT_WHITE: f64 = 0.05;
const FREED_AGAIN: u32 = 2;

/// Data association (Eqs. 2–5) until it converges.
pub fn associate(context: &mut AssociationContext, keyframes: &[Keyframe], progress: &dyn Progress) -> Association {
    let rounds = context.config.association_rounds;
    associate_within(context, keyframes, progress, AssociationEffort { rounds, stride: 1, go_on: &mut |_| true })
}

/// The keyframes' pictures, and what they are free of.
struct Pictures<'a> {
    keyframes: &'a [Keyframe],
    /// `None` where there is none, or it is left out: `[keyframe]`.
    images: Vec<Option<KeyframeImage>>,
    /// `[keyframe]`.
    veils: Vec<Option<Veil>>,
    lens: Lens,
}

/// Data association (Eqs. 2–5) within an effort. Leaves the context with the response that was found.
pub fn associate_within(
    context: &mut AssociationContext,
    keyframes: &[Keyframe],
    progress: &dyn Progress,
    effort: AssociationEffort,
) -> Association {
    let config = context.config;
    let mut pictures = Pictures::new(context, keyframes, effort.stride);
    let mut views: Vec<RefinedView> = keyframes
        .iter()
        .map(|k| RefinedView { world_from_camera: k.world_from_camera, gain: [1.0; 3], residual_px: 0.0 })
        .collect();
    let refine = config.refine_poses != Switch::Off && keyframes.len() >= 2 && effort.rounds > 0;
    let rounds = if refine { effort.rounds } else { 1 };
    let mut known = Known::Nothing;
    let mut left_out = LeftOut::default();
    let mut refiner = PoseRefiner::new(keyframes.iter().map(|k| k.world_from_camera).collect());
    let mut round = 0;
    while round < refiner.rounds(rounds) {
        progress.stage("association", f64::from(round.min(rounds)) / f64::from(rounds));
        if !refine || !(effort.go_on)(round) {
            break;
        }
        let relaxed = f64::from(round.min(rounds)) / f64::from(rounds);
        let rules = EligibilityRules::new(config, relaxed);
        let (field, rasters) = LightField::gather(context, &pictures.images, &views, &rules, None); // Eqs. (3), (4)
        let exposures = exposure::solve(&field, &pictures.problem(context, known), &views, config.exposure); // Eq. (5)
        views.iter_mut().zip(exposures.gains).for_each(|(v, g)| v.gain = g);
        left_out.take(exposures.hazed, &mut pictures.images);
        pictures.free(context, exposures.lens);
        known = if are_exposed(&views) { Known::Gains } else { Known::Nothing };
        let lit = lit_colors(&field, &views); // Eq. (2)
        if !refiner.step(context, &pictures.images, (&field, &rasters), &lit, &mut views, round) {
            break;
        }
        round += 1;
    }
    let rules = EligibilityRules::new(config, 1.0);
    let mut again = FREED_AGAIN;
    let gather = |context: &AssociationContext, images: &[Option<KeyframeImage>], views: &[RefinedView]| {
        LightField::gather(context, images, views, &rules, Some(rules.last_resort())).0
    };
    let (field, decisions) = loop {
        let field = gather(context, &pictures.images, &views);
        // Gains that were found at poses which were off may be far from right.
        let problem = pictures.problem(context, Known::Poses);
        let Exposures { gains, decisions, lens, hazed } = exposure::solve(&field, &problem, &views, config.exposure);
        views.iter_mut().zip(gains).for_each(|(v, g)| v.gain = g);
        let is_felt = pictures.free(context, lens);
        let is_asked_again = is_felt && again > 0;
        again -= u32::from(is_asked_again);
        if !left_out.take(hazed, &mut pictures.images) && !is_asked_again {
            // The colours are free of what the gains are free of.
            break (if is_felt { gather(context, &pictures.images, &views) } else { field }, decisions);
        }
    };
    let Pictures { mut images, mut veils, lens, .. } = pictures;
    let lit = lit_colors(&field, &views);
    let reliability = reliability(&lit, &context.graph, turns(context, &images, &field, &views));
    progress.stage("association", 1.0);
    let mut observations = field.observations;
    observations.par_iter_mut().for_each(|o| {
        let gain = views[o.keyframe as usize].gain;
        o.color = std::array::from_fn(|c| o.color[c] / gain[c] as f32);
    });
    let haze = left_out.give_back(&mut images, &mut views, &mut veils);
    let poses: Vec<Pose> = views.iter().map(|v| v.world_from_camera).collect();
    Association {
        veils,
        lens,
        seen_lamps: seen_lamps(&images, &poses, context.scene, context.clipped),
        lampless_air: LamplessAir::new(&images, &poses, context.clipped),
        reliability,
        lit_color: lit.color,
        lit_weight: lit.weight,
        clipped: always_clipped(&observations, &field.offsets),
        views,
        observations,
        offsets: field.offsets,
        decisions: decisions.into_iter().chain(haze).chain([refiner.decision(refine)]).collect(),
        dark_below: config.dark_below as f32,
        exposure: config.tuning.exposure.clone(),
    }
}

impl<'a> Pictures<'a> {
    /// The pictures of every `stride`-th keyframe.
    fn new(context: &AssociationContext, keyframes: &'a [Keyframe], stride: usize) -> Self {
        let image =
            |(j, k): (usize, &Keyframe)| if j % stride == 0 { KeyframeImage::new(&k.color, &k.camera) } else { None };
        let images: Vec<_> = keyframes.par_iter().enumerate().map(image).collect();
        let lens = Lens { response: context.response, ..Lens::default() };
        let mut pictures = Self { keyframes, images, veils: Vec::new(), lens };
        pictures.look_up_veils(context);
        pictures
    }

    fn look_up_veils(&mut self, context: &AssociationContext) {
        let veil = |(image, keyframe): (&Option<KeyframeImage>, &Keyframe)| {
            image.as_ref().map(|i| Veil::of(i, &keyframe.camera, &context.table, context.clipped))
        };
        self.veils = self.images.par_iter().zip(self.keyframes).map(veil).collect();
    }

    fn problem<'b>(&'b self, context: &'b AssociationContext, known: Known) -> ExposureProblem<'b> {
        ExposureProblem {
            mesh: context.mesh,
            median_edge: context.median_edge,
            keyframes: self.keyframes.len(),
            dark_below: context.config.dark_below as f32,
            veils: &self.veils,
            lens: Some(self.lens),
            known,
            tuning: &context.config.tuning.exposure,
        }
    }

    /// Frees the pictures of what this lens does to them, from now on; true if colours that were gathered before show the change.
    fn free(&mut self, context: &mut AssociationContext, found: Lens) -> bool {
        let last = std::mem::replace(&mut self.lens, found);
        self.images.iter_mut().flatten().for_each(|i| i.vignetting = found.vignetting);
        if found.response != last.response {
            context.decode_by(found.response);
            self.look_up_veils(context);
        }
        let white = found.response.full_scale() / last.response.full_scale();
        (found.vignetting.strength - last.vignetting.strength).abs() > UNFELT || (white - 1.0).abs() > UNFELT_WHITE
    }
}
