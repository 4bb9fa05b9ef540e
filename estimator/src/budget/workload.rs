//! Levels of every stage, and what they cost.

use crate::budget::cost_model::{self, Size};
use crate::numerics::sh;
use firmware_config::tuning::BudgetTuning;
use firmware_config::{EstimatorConfig, Switch, TextureChoice};
use recordings::decision::Reduction;

/// Rays of one round (`--rounds`).
const ROUND: u32 = 64;
/// Share of rays that hit, before it is known.
const LIKELY_BLOCKED: f64 = 0.4;
/// Solutions for the light, besides those of gloss.
const SOLUTIONS: f64 = 2.5;
/// Answers that are written: two before the last.
const WRITTEN: f64 = 3.0;

/// How much of everything a run does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Workload {
    /// Maximum number of vertices.
    pub vertices: usize,
    /// Every n-th keyframe is used.
    pub keyframe_stride: usize,
    /// Rounds of pose refinement; 0 keeps the poses.
    pub pose_rounds: u32,
    /// Maximum number of rays per vertex.
    pub rays: u32,
    /// Maximum number of bounces; 0 = until convergence.
    pub bounces: u32,
    /// Maximum number of SH bands.
    pub bands: usize,
    /// Gloss is looked for.
    pub specular: bool,
    /// A texture is made.
    pub texture: bool,
}

/// The next lower number of bounces, 0 = until convergence; `None` below one.
pub(super) fn fewer_bounces(bounces: u32) -> Option<u32> {
    match bounces {
        1 => None,
        2 => Some(1),
        _ => Some(2),
    }
}

impl Workload {
    /// Everything that the settings ask for.
    #[must_use]
    pub fn full(config: &EstimatorConfig, rounds: Option<u32>) -> Self {
        let auto = rounds.map_or(config.tuning.budget.default_rays, |r| ROUND * r.max(1));
        Self {
            vertices: usize::MAX,
            keyframe_stride: 1,
            pose_rounds: if config.refine_poses == Switch::Off { 0 } else { config.association_rounds },
            rays: if config.rays > 0 { config.rays } else { auto },
            bounces: config.bounces,
            bands: if config.bands > 0 { config.bands as usize } else { sh::MAX_BANDS },
            specular: config.specular != Switch::Off,
            texture: config.texture != TextureChoice::Off,
        }
    }

    /// The lowest level of what follows the light field.
    pub(super) fn least_light(self, tuning: &BudgetTuning) -> Self {
        Self { rays: tuning.min_rays, bounces: 1, bands: 5, specular: false, texture: false, ..self }
    }

    /// The size of the scan at these levels.
    pub(super) fn size(&self, full: &Size) -> Size {
        Size {
            vertices: full.vertices.min(self.vertices as f64),
            keyframes: (full.keyframes / self.keyframe_stride as f64).ceil(),
            ..*full
        }
    }

    /// Reference seconds of what follows the segmentation, before anything was traced.
    pub(super) fn after_segmentation(&self, size: &Size) -> f64 {
        self.light(size, LIKELY_BLOCKED) + self.end(size)
    }

    /// Reference seconds of what follows the light field.
    pub(super) fn after_association(&self, size: &Size) -> f64 {
        cost_model::segmentation(size) + self.light(size, LIKELY_BLOCKED) + self.end(size)
    }

    /// Reference seconds of transfer and factorisation; `blocked` is the share of rays that hit.
    pub(super) fn light(&self, size: &Size, blocked: f64) -> f64 {
        cost_model::rays(size.vertices, self.rays)
            + cost_model::BOUNCED * cost_model::bounces(size.vertices, self.rays, blocked, self.bounces)
            + SOLUTIONS * cost_model::solution(self.bands)
    }

    /// Reference seconds of the factorisations that tell glare and materials.
    pub(super) fn materials(&self, size: &Size, blocked: f64, bands: usize) -> f64 {
        let once = cost_model::bounces(size.vertices, self.rays, blocked, self.bounces) + cost_model::solution(bands);
        cost_model::AGAIN * once
    }

    /// Reference seconds of gloss, texture and output.
    pub(super) fn end(&self, size: &Size) -> f64 {
        let specular = if self.specular { cost_model::specular(size, self.bands) } else { 0.0 };
        let texture = if self.texture { cost_model::texture(size) } else { 0.0 };
        specular + texture + WRITTEN * cost_model::output(size)
    }

    /// Reference seconds of the whole run.
    pub(super) fn all(&self, full: &Size) -> f64 {
        let size = self.size(full);
        cost_model::mesh(full, size.vertices < full.vertices)
            + cost_model::pictures(&size)
            + (f64::from(self.pose_rounds) + 1.0) * cost_model::association(&size)
            + self.after_association(&size)
            + size.witnesses * cost_model::witness(&size)
    }

    /// The next lower level; `None` at the lowest.
    pub(super) fn lower(&self, full: &Size, tuning: &BudgetTuning) -> Option<Self> {
        let mut next = *self;
        let fewer_vertices = self.size(full).vertices * tuning.vertex_step;
        if let Some(fewer) = fewer_bounces(self.bounces) {
            next.bounces = fewer;
        } else if self.rays > tuning.few_rays {
            next.rays = (self.rays / 2).max(tuning.few_rays);
        } else if self.pose_rounds > 2 {
            next.pose_rounds = 2;
        } else if fewer_vertices >= f64::from(tuning.sufficient_vertices) {
            next.vertices = fewer_vertices as usize;
        } else if self.texture {
            next.texture = false;
        } else if self.specular {
            next.specular = false;
        } else if self.pose_rounds > 0 {
            next.pose_rounds = 0;
        } else if self.bands > 5 {
            next.bands = 5;
        } else if self.keyframe_stride == 1 && full.keyframes >= f64::from(tuning.min_keyframes) {
            next.keyframe_stride = 2;
        } else if fewer_vertices >= f64::from(tuning.min_vertices) {
            next.vertices = fewer_vertices as usize;
        } else if self.rays > tuning.min_rays {
            next.rays /= 2;
        } else {
            return None;
        }
        Some(next)
    }

    /// What the step from `before` to this reduces.
    pub(super) fn reductions_from(&self, before: &Self, full: &Size) -> Vec<Reduction> {
        let bands = |s: &Self| s.bands as u32;
        let vertices = |s: &Self| s.size(full).vertices as u32;
        let reduced = [
            (self.bounces != before.bounces).then_some(Reduction::Bounces {
                to: self.bounces,
                from: (before.bounces > 0).then_some(before.bounces),
            }),
            (self.rays != before.rays).then_some(Reduction::Rays { to: self.rays, from: before.rays }),
            (self.pose_rounds != before.pose_rounds)
                .then_some(Reduction::PoseRounds { to: self.pose_rounds, from: before.pose_rounds }),
            (self.texture != before.texture).then_some(Reduction::Texture),
            (self.specular != before.specular).then_some(Reduction::Specular),
            (self.bands != before.bands).then(|| Reduction::Bands { to: bands(self), from: bands(before) }),
            (self.keyframe_stride != before.keyframe_stride)
                .then_some(Reduction::Keyframes { stride: self.keyframe_stride as u32, of: full.keyframes as u32 }),
            (self.vertices < before.vertices)
                .then(|| Reduction::Vertices { to: self.vertices as u32, from: vertices(before) }),
        ];
        reduced.into_iter().flatten().collect()
    }
}
