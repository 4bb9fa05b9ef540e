//! What a run may spend, and on what: the machine is measured, all stages are planned to fit, the clock is watched, and
//! what is cut is written down. Bounces give way first, then rays, then vertices beyond those that tell enough, then what
//! refines, then vertices again.

pub mod cost_model;

use crate::api::Options;
use crate::budget::cost_model::Size;
use crate::numerics::sh;
use firmware_config::{EstimatorConfig, Quality, Switch};
use rayon::prelude::*;
use recordings::decision::{Cut, Reduction};
use std::time::Instant;

/// Rays of one round.
pub const ROUND: u32 = 64;
/// Rays per vertex where the budget does not bind and nothing is known of the scene.
pub const DEFAULT_RAYS: u32 = 128;
/// Rays per vertex before fewer vertices are taken, and at the very least.
const FEW_RAYS: u32 = 32;
const LEAST_RAYS: u32 = 8;
/// Keyframes that every second one is left out of at least.
const MANY_KEYFRAMES: usize = 12;
/// Vertices that tell light and gloss nearly as well as more do: what is above gives way before gloss does, which nine tenths
/// of the albedo's worst errors come from where it is not looked for.
const TELLING_VERTICES: f64 = 40_000.0;
/// Fewest vertices that a mesh is cut to, and the factor of one cut.
const LEAST_VERTICES: f64 = 2000.0;
const VERTEX_CUT: f64 = 0.7;
/// Share of the time left that is planned with: costs are estimates, and machines stall.
const USABLE: f64 = 0.7;
/// Reference seconds of one slice of the speed probe.
const PROBE_SECONDS: f64 = 0.9e-3;
/// Evaluations of one slice, and tasks they are shared among.
const PROBE_EVALUATIONS: u32 = 16_000;
const PROBE_TASKS: u32 = 16;
/// Slices at least.
const LEAST_SLICES: u32 = 4;
/// Where the budget may bind, the probe goes on for this share of it: a machine that is halted now and then is fast in
/// between.
const PROBE_SHARE: f64 = 0.04;
/// A stall came again if there was another this share as long.
const AGAIN: f64 = 0.2;
/// The budget cannot bind if all is done in this share of it.
const CLEARLY_ENOUGH: f64 = 0.125;

/// What tells the time. On a simulated machine, time passes as work is reported.
pub trait Machine: Sync {
    /// Seconds since the run began.
    fn now(&self) -> f64;
    /// Work of so many reference seconds was just done.
    fn worked(&self, _reference_seconds: f64) {}
}

/// The machine that this runs on.
#[derive(Debug)]
pub struct WallClock(Instant);

impl WallClock {
    /// Starts the clock.
    #[must_use]
    pub fn start() -> Self {
        Self(Instant::now())
    }
}

impl Machine for WallClock {
    fn now(&self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }
}

/// How much of everything a run does.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// Vertices at most.
    pub vertices: usize,
    /// Every so manieth keyframe is used.
    pub keyframe_stride: usize,
    /// Rounds of pose refinement; 0 = poses stay.
    pub pose_rounds: u32,
    /// Rays per vertex at most.
    pub rays: u32,
    /// Bounces at most; 0 = until they no longer matter.
    pub bounces: u32,
    /// SH bands at most.
    pub bands: usize,
    /// Gloss is looked for.
    pub specular: bool,
}

impl Shape {
    /// Everything that the settings ask for.
    #[must_use]
    pub fn full(config: &EstimatorConfig, rounds: Option<u32>) -> Self {
        let auto = rounds.map_or(DEFAULT_RAYS, |r| ROUND * r.max(1));
        Self {
            vertices: usize::MAX,
            keyframe_stride: 1,
            pose_rounds: if config.refine_poses == Switch::Off { 0 } else { config.association_rounds },
            rays: if config.rays > 0 { config.rays } else { auto },
            bounces: config.bounces,
            bands: if config.bands > 0 { config.bands as usize } else { sh::MAX_BANDS },
            specular: config.specular != Switch::Off,
        }
    }

    fn size(&self, full: &Size) -> Size {
        Size {
            vertices: full.vertices.min(self.vertices as f64),
            keyframes: (full.keyframes / self.keyframe_stride as f64).ceil(),
            ..*full
        }
    }

    /// Reference seconds of what follows the light field.
    fn after_association(&self, size: &Size) -> f64 {
        cost_model::segmentation(size) + self.light(size, 0.4) + self.end(size)
    }

    /// Transfer and factorisation; `blocked` is the share of rays that hit.
    fn light(&self, size: &Size, blocked: f64) -> f64 {
        cost_model::rays(size.vertices, self.rays)
            + cost_model::BOUNCED * cost_model::bounces(size.vertices, self.rays, blocked, self.bounces)
            + 2.5 * cost_model::solution(self.bands)
    }

    fn end(&self, size: &Size) -> f64 {
        let specular = if self.specular { cost_model::specular(size, self.bands) } else { 0.0 };
        specular + cost_model::output(size)
    }

    fn all(&self, full: &Size) -> f64 {
        let size = self.size(full);
        cost_model::mesh(full, size.vertices < full.vertices)
            + cost_model::pictures(&size)
            + (f64::from(self.pose_rounds) + 1.0) * cost_model::association(&size)
            + self.after_association(&size)
            + size.witnesses * cost_model::witness(&size)
    }

    /// The next lower level; `None` at the lowest.
    fn lower(&self, full: &Size) -> Option<Self> {
        let mut next = *self;
        if self.bounces == 0 || self.bounces > 2 {
            next.bounces = 2;
        } else if self.bounces > 1 {
            next.bounces = 1;
        } else if self.rays > FEW_RAYS {
            next.rays = (self.rays / 2).max(FEW_RAYS);
        } else if self.pose_rounds > 2 {
            next.pose_rounds = 2;
        } else if self.size(full).vertices * VERTEX_CUT >= TELLING_VERTICES {
            next.vertices = (self.size(full).vertices * VERTEX_CUT) as usize;
        } else if self.specular {
            next.specular = false;
        } else if self.pose_rounds > 0 {
            next.pose_rounds = 0;
        } else if self.bands > 5 {
            next.bands = 5;
        } else if self.keyframe_stride == 1 && full.keyframes >= MANY_KEYFRAMES as f64 {
            next.keyframe_stride = 2;
        } else if self.size(full).vertices * VERTEX_CUT >= LEAST_VERTICES {
            next.vertices = (self.size(full).vertices * VERTEX_CUT) as usize;
        } else if self.rays > LEAST_RAYS {
            next.rays /= 2;
        } else {
            return None;
        }
        Some(next)
    }

    /// What the step from `before` to this reduced.
    fn reductions_from(&self, before: &Self, full: &Size) -> Vec<Reduction> {
        let bands = |s: &Self| s.bands as u32;
        let vertices = |s: &Self| s.size(full).vertices as u32;
        let reduced = [
            (self.bounces != before.bounces)
                .then(|| Reduction::Bounces { to: self.bounces, from: (before.bounces > 0).then_some(before.bounces) }),
            (self.rays != before.rays).then_some(Reduction::Rays { to: self.rays, from: before.rays }),
            (self.pose_rounds != before.pose_rounds)
                .then_some(Reduction::PoseRounds { to: self.pose_rounds, from: before.pose_rounds }),
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

/// The clock and the budget of one run.
pub struct Plan<'a> {
    machine: &'a dyn Machine,
    /// Seconds; infinite where rounds replace the clock.
    budget: f64,
    size: Size,
    /// Reference seconds a second, as the probe saw it.
    probed: f64,
    /// Reference seconds of work done since the probe, and when it ended.
    work: f64,
    since: f64,
    /// All that was asked for, what is planned of it, and what that leaves out.
    full: Shape,
    shape: Shape,
    planned: Vec<Cut>,
    /// What was cut for good.
    cut: Vec<Cut>,
}

impl<'a> Plan<'a> {
    /// Measures the machine and plans all stages. With rounds given, no clock is read.
    #[must_use]
    pub fn new(machine: &'a dyn Machine, options: &Options, config: &EstimatorConfig, size: Size) -> Self {
        let shape = Shape::full(config, options.rounds);
        let budget = if options.rounds.is_some() { f64::INFINITY } else { options.budget.as_secs_f64() };
        let (planned, cut) = (Vec::new(), Vec::new());
        let mut plan =
            Self { machine, budget, size, probed: 1.0, work: 0.0, since: 0.0, full: shape, shape, planned, cut };
        if budget.is_finite() {
            plan.probe(shape.all(&size));
            let found = plan.fitting(shape, |s| s.all(&size), f64::INFINITY);
            plan.take(found);
        }
        plan
    }

    /// What the run does, as planned so far.
    #[must_use]
    pub fn shape(&self) -> Shape {
        self.shape
    }

    /// What was cut.
    #[must_use]
    pub fn cuts(&self) -> Vec<Cut> {
        self.planned.iter().chain(&self.cut).cloned().collect()
    }

    /// Seconds that everything the settings ask for would take on this machine, budget or not.
    #[must_use]
    pub fn needed_seconds(&self) -> f64 {
        self.full.all(&self.size) / self.speed()
    }

    /// Notes something that was left out for want of time.
    pub fn leave_out(&mut self, what: Cut) {
        self.cut.push(what);
    }

    /// Takes a share of the vertices and every `stride`th keyframe only.
    pub fn restrict(&mut self, vertices: f64, stride: usize) {
        if vertices < 1.0 {
            self.shape.vertices = (self.size.vertices * vertices) as usize;
        }
        self.shape.keyframe_stride = stride.max(1);
    }

    /// Speed of this machine in reference seconds a second. `needed` is what there is to do. A slice that takes longest is
    /// left out, as a machine may stall once; one that stalls again and again is as slow as that makes it.
    fn probe(&mut self, needed: f64) {
        let (mut slices, mut spent, mut longest, mut second) = (0, 0.0, 0.0f64, 0.0f64);
        let mut before = self.machine.now();
        loop {
            let evaluated: f32 = (0..PROBE_TASKS).into_par_iter().map(probe_slice).collect::<Vec<f32>>().iter().sum();
            std::hint::black_box(evaluated);
            self.machine.worked(PROBE_SECONDS);
            slices += 1;
            let now = self.machine.now();
            let slice = now - before;
            spent += slice;
            second = second.max(slice.min(longest));
            longest = longest.max(slice);
            before = now;
            if slices < LEAST_SLICES {
                continue;
            }
            let left_out = if second < AGAIN * longest { longest } else { 0.0 };
            let steady = (spent - left_out).max(1e-9);
            self.probed = f64::from(slices - 1) * PROBE_SECONDS / steady;
            let enough = needed < CLEARLY_ENOUGH * self.probed * (self.budget - now);
            if enough || steady >= PROBE_SHARE * self.budget {
                break;
            }
        }
        self.since = before;
        tracing::debug!("planning for a machine {:.2} times as fast as the reference", self.probed);
    }

    /// What the probe and the stages since have shown.
    fn speed(&self) -> f64 {
        let spent = self.machine.now() - self.since;
        // Little work says little: the probe counts like a second of it.
        ((self.work + 1.0) / (spent + 1.0 / self.probed)).max(1e-12)
    }

    /// Reference seconds that may still be planned with.
    fn left(&self) -> f64 {
        if self.budget.is_finite() { USABLE * self.speed() * (self.budget - self.machine.now()) } else { f64::INFINITY }
    }

    /// The highest level from `shape` down whose `cost` fits what is left.
    fn fitting(&self, mut shape: Shape, cost: impl Fn(&Shape) -> f64, most: f64) -> Shape {
        let left = self.left().min(most);
        while cost(&shape) > left {
            match shape.lower(&self.size) {
                Some(lower) => shape = lower,
                None => break,
            }
        }
        shape
    }

    fn take(&mut self, shape: Shape) {
        let speed = self.speed();
        let reductions = shape.reductions_from(&self.full, &self.size);
        self.planned = reductions.into_iter().map(|what| Cut::Planned { what, speed }).collect();
        self.shape = shape;
    }

    /// Work of so many reference seconds is done.
    pub fn worked(&mut self, reference_seconds: f64) {
        if self.budget.is_finite() {
            self.machine.worked(reference_seconds);
            self.work += reference_seconds;
        }
    }

    /// The mesh has become what it is.
    pub fn mesh_done(&mut self, vertices: usize) {
        let coarser = (self.shape.vertices as f64) < self.size.vertices;
        self.worked(cost_model::mesh(&self.size, coarser));
        self.size.vertices = vertices as f64;
        (self.shape.vertices, self.full.vertices) = (vertices, vertices);
        self.full.keyframe_stride = self.shape.keyframe_stride;
        // The mesh is what it is from now on, and so are the keyframes.
        let is_fixed = |cut: &Cut| matches!(cut, Cut::Planned { what, .. } if what.is_of_scan());
        let (fixed, planned) = std::mem::take(&mut self.planned).into_iter().partition(is_fixed);
        (self.cut, self.planned) = (fixed, planned);
    }

    /// Rounds of pose refinement that are begun at most, [`Self::pose_round`] willing.
    #[must_use]
    pub fn most_pose_rounds(&self) -> u32 {
        self.full.pose_rounds
    }

    /// True if another round of pose refinement fits; it and the final round count as work. Rounds that were not planned fit
    /// if gloss can be looked for besides.
    pub fn pose_round(&mut self, round: u32) -> bool {
        let size = self.shape.size(&self.size);
        if round > 0 {
            self.worked(cost_model::association(&size));
        }
        let pictures = if round == 0 { cost_model::pictures(&size) } else { 0.0 };
        let rest = if round < self.shape.pose_rounds {
            self.least(&size)
        } else {
            Shape { specular: self.full.specular, ..self.shape }.after_association(&size)
        };
        let fits = pictures + 2.0 * cost_model::association(&size) + rest <= self.left();
        let pose_rounds = if fits { self.full.pose_rounds } else { round };
        if !fits || round >= self.shape.pose_rounds {
            self.take(Shape { pose_rounds, ..self.shape });
        }
        fits
    }

    /// What must still be done when the light field is there, at the lowest level of everything.
    fn least(&self, size: &Size) -> f64 {
        let least = Shape { rays: LEAST_RAYS, bounces: 1, bands: 5, specular: false, ..self.shape };
        least.after_association(size)
    }

    /// The light field is there.
    pub fn association_done(&mut self) {
        let size = self.shape.size(&self.size);
        self.worked(cost_model::pictures(&size) + cost_model::association(&size));
    }

    /// Segments are there: what of the rest fits is decided anew.
    pub fn segmentation_done(&mut self) {
        let size = self.shape.size(&self.size);
        self.worked(cost_model::segmentation(&size));
        if self.budget.is_finite() {
            let pose_rounds = self.shape.pose_rounds;
            let rest = |s: &Shape| {
                let s = Shape { vertices: self.full.vertices, keyframe_stride: self.full.keyframe_stride, ..*s };
                s.light(&size, 0.4) + s.end(&size)
            };
            let found = self.fitting(Shape { pose_rounds, ..self.full }, rest, f64::INFINITY);
            let Shape { vertices, keyframe_stride, .. } = self.full;
            self.take(Shape { vertices, keyframe_stride, pose_rounds, ..found });
        }
    }

    /// Seconds after which rays are no longer worth waiting for: the rest needs the time.
    #[must_use]
    pub fn rays_until(&self) -> f64 {
        if !self.budget.is_finite() {
            return f64::INFINITY;
        }
        let size = self.shape.size(&self.size);
        let least = Shape { rays: LEAST_RAYS, bounces: 1, bands: 5, specular: false, ..self.shape };
        let rest = (least.light(&size, 0.4) + least.end(&size)) / (USABLE * self.speed());
        let now = self.machine.now();
        now + (self.budget - now - rest).max(0.0) * USABLE
    }

    /// Told the share of `rays` that is traced; false if they will not be there in time.
    pub fn watch_rays<'b>(&'b self, rays: u32) -> impl Fn(f64) -> bool + Sync + use<'a, 'b> {
        let (start, until) = (self.machine.now(), self.rays_until());
        let (machine, finite) = (self.machine, self.budget.is_finite());
        let all = cost_model::rays(self.size.vertices, rays);
        let told = std::sync::Mutex::new(0.0f64);
        move |share| {
            if !finite {
                return true;
            }
            if let Ok(mut told) = told.lock() {
                machine.worked(all * (share - *told).max(0.0));
                *told = told.max(share);
            }
            let now = machine.now();
            let end = start + (now - start) / share.max(0.02);
            now < until && (end < until || share < 0.02)
        }
    }

    /// Fewer rays after some were given up, where that is more than those that are there already; `None` if there is no
    /// time for any.
    pub fn fewer_rays(&mut self, rays: u32, have: u32) -> Option<u32> {
        let fewer = rays / 4;
        if have > 0 && fewer <= have {
            self.cut.push(Cut::LateRays { rays: have, instead_of: rays });
            self.shape.rays = have;
            return None;
        }
        if fewer < LEAST_RAYS || self.machine.now() > self.rays_until() {
            self.cut.push(Cut::AbandonedTransfer { rays });
            return None;
        }
        self.cut.push(Cut::LateRays { rays: fewer, instead_of: rays });
        self.shape.rays = fewer;
        Some(fewer)
    }

    /// As many of the `wanted` rays as fit, `have` of which are there.
    pub fn more_rays(&mut self, wanted: u32, have: u32, blocked: f64, bands: usize) -> u32 {
        if !self.budget.is_finite() {
            return wanted;
        }
        let size = self.shape.size(&self.size);
        let mut rays = wanted;
        let mut bounces = self.shape.bounces;
        let there = cost_model::rays(size.vertices, have);
        let cost = |rays, bounces| {
            let shape = Shape { rays, bands, bounces, ..self.shape };
            shape.light(&size, blocked) - there + shape.end(&size)
        };
        while rays > have && cost(rays, bounces) > self.left() {
            match bounces {
                1 => rays /= 2,
                2 => bounces = 1,
                _ => bounces = 2,
            }
        }
        if rays < wanted {
            self.cut.push(Cut::FewerRays { rays, instead_of: wanted });
        }
        // What was planned before anything was known of the scene no longer counts.
        self.full.rays = rays;
        self.take(Shape { bounces, rays, ..self.shape });
        rays
    }

    /// Rays are there: they count as work (a simulated machine was told already).
    pub fn rays_done(&mut self, rays: u32) {
        self.work += cost_model::rays(self.size.vertices, rays);
    }

    /// Bounces and bands that fit, `blocked` being the share of rays that hit.
    pub fn light(&mut self, blocked: f64) -> (u32, usize) {
        if self.budget.is_finite() {
            let size = self.shape.size(&self.size);
            let rest = |s: &Shape| s.light(&size, blocked) - cost_model::rays(size.vertices, s.rays) + s.end(&size);
            let mut shape = self.shape;
            while rest(&shape) > self.left() && (shape.bounces != 1 || shape.bands > 3) {
                match shape.bounces {
                    1 => shape.bands -= 2,
                    2 => shape.bounces = 1,
                    _ => shape.bounces = 2,
                }
            }
            self.take(shape);
        }
        (self.shape.bounces, self.shape.bands)
    }

    /// Light and albedo are there.
    pub fn light_done(&mut self, blocked: f64, bands: usize) {
        let size = self.shape.size(&self.size);
        let shape = Shape { bands, ..self.shape };
        self.worked(shape.light(&size, blocked) - cost_model::rays(size.vertices, shape.rays));
    }

    /// True if there is time to look for gloss.
    pub fn specular(&mut self, bands: usize) -> bool {
        let size = self.shape.size(&self.size);
        let fits = cost_model::specular(&size, bands) + cost_model::output(&size) <= self.left();
        if self.shape.specular && !fits {
            self.cut.push(Cut::Specular);
        }
        self.shape.specular && fits
    }

    /// Gloss has been looked for.
    pub fn specular_done(&mut self, bands: usize) {
        let size = self.shape.size(&self.size);
        self.worked(cost_model::specular(&size, bands));
        (self.full.specular, self.shape.specular) = (false, false);
    }

    /// True if there is time to predict another witness frame.
    pub fn witness(&mut self) -> bool {
        let size = self.shape.size(&self.size);
        let fits = cost_model::witness(&size) + cost_model::output(&size) <= self.left();
        if fits {
            self.worked(cost_model::witness(&size));
        }
        fits
    }

    /// Told before the result is written, which is the last work there is.
    pub fn writing(&mut self) {
        let size = self.shape.size(&self.size);
        self.worked(cost_model::output(&size));
    }
}

fn probe_slice(task: u32) -> f32 {
    let mut values = [0.0f32; sh::MAX_COEFFICIENTS];
    let mut sum = 0.0;
    for i in 0..PROBE_EVALUATIONS / PROBE_TASKS {
        let draw =
            |k| crate::numerics::random::unit(crate::numerics::random::hash(task * PROBE_EVALUATIONS + i, k)) - 0.5;
        sh::eval_f32(glam::Vec3::new(draw(1), draw(2), draw(3)).normalize_or(glam::Vec3::Z), &mut values);
        sum += values[7];
    }
    sum
}

/// The settings with the named point of the trade applied to what is left to `auto`.
#[must_use]
pub fn at_quality(config: &EstimatorConfig) -> EstimatorConfig {
    let mut config = config.clone();
    let auto = |value: &mut u32, to: u32| {
        if *value == 0 {
            *value = to;
        }
    };
    match config.quality {
        Quality::Draft => {
            auto(&mut config.rays, 32);
            auto(&mut config.bands, 4);
            auto(&mut config.bounces, 2);
            config.association_rounds = config.association_rounds.min(2);
        }
        Quality::Standard => {}
        Quality::Best => auto(&mut config.rays, 1024),
    }
    config
}
