//! The plan of one run: what fits the budget, revised as stages end.

use crate::api::Options;
use crate::budget::cost_model::{self, Size};
use crate::budget::first_answer::Done;
use crate::budget::machine::Machine;
use crate::budget::memory;
use crate::budget::probe::{self, Probe};
use crate::budget::workload::{Workload, fewer_bounces};
use firmware_config::EstimatorConfig;
use firmware_config::tuning::BudgetTuning;
use recordings::decision::{Cut, Reduction};
use std::sync::Mutex;
use std::time::Duration;

/// An answer that stands is written before the run ends if that takes less than this share of the time left.
const HAND_OVER_SHARE: f64 = 0.1;
/// Rays and bounces that were cut are made up for in the end if more than this share of the budget is left.
const SPARE_SHARE: f64 = 0.1;

/// Share of the time left that is planned with once an answer stands: what comes too late then is not missed.
const STANDING_SHARE: f64 = 0.9;

/// The clock and the budget of one run.
pub struct Plan<'a> {
    machine: &'a dyn Machine,
    /// Seconds; infinite where rounds replace the clock.
    budget: f64,
    size: Size,
    tuning: BudgetTuning,
    probe: Probe,
    /// Seconds of work that was done before the probe.
    before: f64,
    /// An answer on the planned mesh stands.
    stands: bool,
    /// Reference seconds of work done before and since the probe.
    work: f64,
    /// Everything that was asked for.
    full: Workload,
    /// What is planned of it.
    workload: Workload,
    /// The difference, revised with the plan.
    planned: Vec<Cut>,
    /// Cuts that are final.
    fixed: Vec<Cut>,
}

/// True if by a short look at the machine all that the settings ask for fits the budget.
pub fn is_ample(machine: &dyn Machine, budget: Duration, config: &EstimatorConfig, size: &Size) -> bool {
    let (budget, tuning) = (budget.as_secs_f64(), &config.tuning.budget);
    let needed = Workload::full(config, None).all(size);
    // The shortest probe: as if earlier work had taken the time of a longer one.
    let probe = probe::probe(machine, needed, budget, budget, tuning);
    needed < tuning.usable_share * probe.speed * (budget - probe.end)
}

impl<'a> Plan<'a> {
    /// Measures the machine and plans all stages. Work that was done `before` tells more of the machine than the probe. With rounds
    /// given, no clock is read.
    #[must_use]
    pub fn new(
        machine: &'a dyn Machine,
        options: &Options,
        config: &EstimatorConfig,
        size: Size,
        before: Done,
    ) -> Self {
        let mut full = Workload::full(config, options.rounds);
        let tuning = config.tuning.budget.clone();
        let budget = if options.rounds.is_some() { f64::INFINITY } else { options.budget.as_secs_f64() };
        let (probe, planned, mut fixed) = (Probe { speed: 1.0, end: 0.0 }, Vec::new(), Vec::new());
        if let Some(limit_mb) = options.memory_mb.filter(|_| budget.is_finite()) {
            let asked = full;
            full = memory::fitting(asked, &size, limit_mb, &tuning);
            let reductions = full.reductions_from(&asked, &size);
            fixed.extend(reductions.into_iter().map(|what| Cut::Memory { what, limit_mb }));
        }
        let mut plan = Self {
            machine,
            budget,
            size,
            tuning,
            probe,
            before: before.seconds,
            stands: false,
            work: before.reference_seconds,
            full,
            workload: full,
            planned,
            fixed,
        };
        if budget.is_finite() {
            plan.probe = probe::probe(machine, full.all(&size), budget, before.seconds, &plan.tuning);
            tracing::debug!("planning for a machine {:.2} times as fast as the reference", plan.speed());
            let found = plan.fitting(full, |w| w.all(&size));
            plan.adopt(found);
        }
        plan
    }

    /// The levels planned so far.
    #[must_use]
    pub fn workload(&self) -> Workload {
        self.workload
    }

    /// What was cut.
    #[must_use]
    pub fn cuts(&self) -> Vec<Cut> {
        self.planned.iter().chain(&self.fixed).cloned().collect()
    }

    /// Seconds that everything the settings ask for takes on this machine, budget or not.
    #[must_use]
    pub fn needed_seconds(&self) -> f64 {
        self.full.all(&self.size) / self.speed()
    }

    /// True if an answer that stands is worth its writing; reports that as work.
    pub fn hand_over(&mut self) -> bool {
        let output = cost_model::output(&self.workload.size(&self.size));
        let is_cheap = self.budget.is_finite() && output <= HAND_OVER_SHARE * self.left();
        if is_cheap {
            self.worked(output);
            self.stands = true;
        }
        is_cheap
    }

    /// True if rays or bounces were cut, and more of the budget is left than the texture and a margin take.
    #[must_use]
    pub fn has_spare(&self) -> bool {
        let is_of_light = |cut: &Cut| match cut {
            Cut::Planned { what, .. } => matches!(what, Reduction::Rays { .. } | Reduction::Bounces { .. }),
            cut => matches!(cut, Cut::FewerRays { .. } | Cut::LateRays { .. }),
        };
        let rest = self.workload.end(&self.workload.size(&self.size));
        self.cuts().iter().any(is_of_light) && self.left() - rest > SPARE_SHARE * self.budget * self.speed()
    }

    /// Records a cut that is final.
    pub fn cut(&mut self, what: Cut) {
        self.fixed.push(what);
    }

    /// Restricts the run to a share of the vertices and to every `stride`-th keyframe.
    pub fn restrict(&mut self, vertices: f64, stride: usize) {
        if vertices < 1.0 {
            self.workload.vertices = (self.size.vertices * vertices) as usize;
        }
        self.workload.keyframe_stride = stride.max(1);
    }

    /// Reference seconds per second, from the probe and the stages since.
    fn speed(&self) -> f64 {
        let spent = self.before + self.machine.now() - self.probe.end;
        // The probe has the weight of one reference second of work.
        ((self.work + 1.0) / (spent + 1.0 / self.probe.speed)).max(1e-12)
    }

    /// Reference seconds that are left to plan with.
    fn left(&self) -> f64 {
        if !self.budget.is_finite() {
            return f64::INFINITY;
        }
        let share = if self.stands { STANDING_SHARE } else { self.tuning.usable_share };
        share * self.speed() * (self.budget - self.machine.now())
    }

    /// The highest workload from `workload` down whose `cost` fits the time left; the lowest if none fits.
    fn fitting(&self, mut workload: Workload, cost: impl Fn(&Workload) -> f64) -> Workload {
        let left = self.left();
        while cost(&workload) > left
            && let Some(lower) = workload.lower(&self.size, &self.tuning)
        {
            workload = lower;
        }
        workload
    }

    fn adopt(&mut self, workload: Workload) {
        let speed = self.speed();
        let reductions = workload.reductions_from(&self.full, &self.size);
        self.planned = reductions.into_iter().map(|what| Cut::Planned { what, speed }).collect();
        self.workload = workload;
    }

    /// Reports finished work, in reference seconds.
    pub fn worked(&mut self, reference_seconds: f64) {
        if self.budget.is_finite() {
            self.machine.worked(reference_seconds);
            self.work += reference_seconds;
            tracing::debug!("{:.2} reference seconds after {:.2} s", self.work, self.machine.now());
        }
    }

    /// The mesh is made, with this many vertices.
    pub fn mesh_done(&mut self, vertices: usize) {
        let coarser = (self.workload.vertices as f64) < self.size.vertices;
        self.worked(cost_model::mesh(&self.size, coarser));
        self.size.vertices = vertices as f64;
        (self.workload.vertices, self.full.vertices) = (vertices, vertices);
        self.full.keyframe_stride = self.workload.keyframe_stride;
        // Cuts of vertices and keyframes are final from now on.
        let is_fixed = |cut: &Cut| matches!(cut, Cut::Planned { what, .. } if what.is_of_scan());
        let (fixed, planned) = std::mem::take(&mut self.planned).into_iter().partition(is_fixed);
        self.fixed.extend::<Vec<Cut>>(fixed);
        self.planned = planned;
    }

    /// Maximum number of rounds of pose refinement; [`Self::pose_round`] may end them earlier.
    #[must_use]
    pub fn max_pose_rounds(&self) -> u32 {
        self.full.pose_rounds
    }

    /// True if another round of pose refinement fits, besides the final round. Rounds that were not planned fit if gloss fits
    /// too. Reports the round before as work.
    pub fn pose_round(&mut self, round: u32) -> bool {
        let size = self.workload.size(&self.size);
        if round > 0 {
            self.worked(cost_model::association(&size));
        }
        let pictures = if round == 0 { cost_model::pictures(&size) } else { 0.0 };
        let rest = if round < self.workload.pose_rounds {
            self.workload.least_light(&self.tuning).after_association(&size)
        } else {
            Workload { specular: self.full.specular, ..self.workload }.after_association(&size)
        };
        let fits = pictures + 2.0 * cost_model::association(&size) + rest <= self.left();
        let pose_rounds = if fits { self.full.pose_rounds } else { round };
        if !fits || round >= self.workload.pose_rounds {
            self.adopt(Workload { pose_rounds, ..self.workload });
        }
        fits
    }

    /// The light field is made.
    pub fn association_done(&mut self) {
        let size = self.workload.size(&self.size);
        self.worked(cost_model::pictures(&size) + cost_model::association(&size));
    }

    /// Segments are made: the rest is planned again.
    pub fn segmentation_done(&mut self) {
        let size = self.workload.size(&self.size);
        self.worked(cost_model::segmentation(&size));
        if self.budget.is_finite() {
            let pose_rounds = self.workload.pose_rounds;
            let Workload { vertices, keyframe_stride, .. } = self.full;
            let rest = |w: &Workload| Workload { vertices, keyframe_stride, ..*w }.after_segmentation(&size);
            let found = self.fitting(Workload { pose_rounds, ..self.full }, rest);
            self.adopt(Workload { vertices, keyframe_stride, pose_rounds, ..found });
        }
    }

    /// Time, in seconds, at which tracing has to end: the rest needs the time after it.
    fn rays_deadline(&self) -> f64 {
        if !self.budget.is_finite() {
            return f64::INFINITY;
        }
        let size = self.workload.size(&self.size);
        let least = self.workload.least_light(&self.tuning);
        let rest = least.after_segmentation(&size) / (self.tuning.usable_share * self.speed());
        let now = self.machine.now();
        now + (self.budget - now - rest).max(0.0) * self.tuning.usable_share
    }

    /// A callback for tracing `rays` rays per vertex: gets the share done, returns false if they will not be done in time.
    pub fn watch_rays<'b>(&'b self, rays: u32) -> impl Fn(f64) -> bool + Sync + use<'a, 'b> {
        let (start, deadline) = (self.machine.now(), self.rays_deadline());
        let (machine, finite) = (self.machine, self.budget.is_finite());
        let all = cost_model::rays(self.size.vertices, rays);
        let reported = Mutex::new(0.0f64);
        move |share| {
            if !finite {
                return true;
            }
            if let Ok(mut reported) = reported.lock() {
                machine.worked(all * (share - *reported).max(0.0));
                *reported = reported.max(share);
            }
            let now = machine.now();
            let end = start + (now - start) / share.max(0.02);
            now < deadline && (end < deadline || share < 0.02)
        }
    }

    /// Rays per vertex to trace after `rays` were late, more than the `have` already traced; `None` if there is no time for them.
    pub fn fewer_rays(&mut self, rays: u32, have: u32) -> Option<u32> {
        let fewer = rays / 4;
        if have > 0 && fewer <= have {
            self.fixed.push(Cut::LateRays { rays: have, instead_of: rays });
            self.rays_were_late(have);
            return None;
        }
        if fewer < self.tuning.min_rays || self.machine.now() > self.rays_deadline() {
            self.fixed.push(Cut::AbandonedTransfer { rays });
            return None;
        }
        self.fixed.push(Cut::LateRays { rays: fewer, instead_of: rays });
        self.rays_were_late(fewer);
        Some(fewer)
    }

    /// What was late is named already: later plans do not name it once more.
    fn rays_were_late(&mut self, rays: u32) {
        (self.workload.rays, self.full.rays) = (rays, rays);
    }

    /// As many of the `wanted` rays per vertex as fit, and of the bounces; `have` rays are traced already, a share `blocked` of them hit, and
    /// there are at least the bounces `least`.
    pub fn more_rays(&mut self, wanted: u32, have: u32, blocked: f64, bands: usize, least: u32) -> u32 {
        if !self.budget.is_finite() {
            return wanted;
        }
        let size = self.workload.size(&self.size);
        let mut rays = wanted;
        // Those that were cut before this was known are asked for again.
        let mut bounces = self.full.bounces;
        let done = cost_model::rays(size.vertices, have);
        let cost = |rays, bounces| {
            let workload = Workload { rays, bands, bounces, ..self.workload };
            workload.light(&size, blocked) - done + workload.end(&size)
        };
        while (rays > have || bounces != least) && cost(rays, bounces) > self.left() {
            match fewer_bounces(bounces).filter(|_| bounces != least) {
                Some(fewer) => bounces = fewer,
                None => rays = (rays / 2).max(have),
            }
        }
        // This decision takes the place of an earlier one.
        self.fixed.retain(|cut| !matches!(cut, Cut::FewerRays { .. } | Cut::LateRays { .. }));
        if rays < wanted {
            self.fixed.push(Cut::FewerRays { rays, instead_of: wanted });
        }
        // The evidence of the scene replaces the number of rays that was planned without it.
        self.full.rays = rays;
        self.adopt(Workload { bounces, rays, ..self.workload });
        rays
    }

    /// Bounces that [`Self::more_rays`] granted were not made: there are as many as before.
    pub fn bounces_stay(&mut self, bounces: u32) {
        self.adopt(Workload { bounces, ..self.workload });
    }

    /// Rays are traced. The callback has reported them to the machine already.
    pub fn rays_done(&mut self, rays: u32) {
        self.work += cost_model::rays(self.size.vertices, rays);
    }

    /// Maximum numbers of bounces and bands that fit; `blocked` is the share of rays that hit.
    pub fn light(&mut self, blocked: f64) -> (u32, usize) {
        if self.budget.is_finite() {
            let size = self.workload.size(&self.size);
            let rest = |w: &Workload| w.light(&size, blocked) - cost_model::rays(size.vertices, w.rays) + w.end(&size);
            let mut lower = self.workload;
            while rest(&lower) > self.left() && (lower.bounces != 1 || lower.bands > 3) {
                match fewer_bounces(lower.bounces) {
                    Some(fewer) => lower.bounces = fewer,
                    None => lower.bands -= 2,
                }
            }
            self.adopt(lower);
        }
        (self.workload.bounces, self.workload.bands)
    }

    /// Light and albedo are factorised.
    pub fn light_done(&mut self, blocked: f64, bands: usize) {
        let size = self.workload.size(&self.size);
        let workload = Workload { bands, ..self.workload };
        self.worked(workload.light(&size, blocked) - cost_model::rays(size.vertices, workload.rays));
    }

    /// True if so many searches for lamps and emitting surfaces fit.
    pub fn fits_local_light(&self, searches: u32) -> bool {
        let size = self.workload.size(&self.size);
        f64::from(searches) * cost_model::local_light(&size) + cost_model::output(&size) <= self.left()
    }

    /// True if a search for lamps and emitting surfaces fits; a cut where it does not.
    pub fn local_light(&mut self) -> bool {
        let fits = self.fits_local_light(1);
        if !fits {
            self.fixed.push(Cut::LocalLight);
        }
        fits
    }

    /// Lamps and emitting surfaces were looked for so many times.
    pub fn local_light_done(&mut self, searches: u32) {
        let size = self.workload.size(&self.size);
        self.worked(f64::from(searches) * cost_model::local_light(&size));
    }

    /// True if glare and materials can be looked for before what is planned after them; `blocked` is the share of rays that hit.
    pub fn materials(&mut self, blocked: f64, bands: usize) -> bool {
        let size = self.workload.size(&self.size);
        let fits = self.workload.materials(&size, blocked, bands) + self.workload.end(&size) <= self.left();
        if !fits {
            self.fixed.push(Cut::Materials);
        }
        fits
    }

    /// Glare and materials were looked for.
    pub fn materials_done(&mut self, blocked: f64, bands: usize) {
        let size = self.workload.size(&self.size);
        self.worked(self.workload.materials(&size, blocked, bands));
    }

    /// True if gloss is asked for and fits, planned or not.
    pub fn specular(&mut self, bands: usize) -> bool {
        let size = self.workload.size(&self.size);
        let fits = cost_model::specular(&size, bands) + cost_model::output(&size) <= self.left();
        if self.full.specular && fits {
            self.adopt(Workload { specular: true, ..self.workload });
            return true;
        }
        if self.workload.specular {
            self.fixed.push(Cut::Specular);
            (self.full.specular, self.workload.specular) = (false, false);
        }
        false
    }

    /// Gloss was looked for.
    pub fn specular_done(&mut self, bands: usize) {
        let size = self.workload.size(&self.size);
        self.worked(cost_model::specular(&size, bands));
        (self.full.specular, self.workload.specular) = (false, false);
    }

    /// True if a texture is asked for and fits, planned or not.
    pub fn texture(&mut self) -> bool {
        let size = self.workload.size(&self.size);
        let fits = cost_model::texture(&size) + cost_model::output(&size) <= self.left();
        if self.full.texture && fits {
            self.adopt(Workload { texture: true, ..self.workload });
            return true;
        }
        if self.workload.texture {
            self.fixed.push(Cut::Texture);
            (self.full.texture, self.workload.texture) = (false, false);
        }
        false
    }

    /// The texture is made.
    pub fn texture_done(&mut self) {
        let size = self.workload.size(&self.size);
        self.worked(cost_model::texture(&size));
        (self.full.texture, self.workload.texture) = (false, false);
    }

    /// True if the prediction of another validation frame fits; reports it as work.
    pub fn witness(&mut self) -> bool {
        let size = self.workload.size(&self.size);
        let fits = cost_model::witness(&size) + cost_model::output(&size) <= self.left();
        if fits {
            self.worked(cost_model::witness(&size));
        }
        fits
    }

    /// The result is about to be written; reports that as work.
    pub fn writing(&mut self) {
        let size = self.workload.size(&self.size);
        self.worked(cost_model::output(&size));
    }
}
