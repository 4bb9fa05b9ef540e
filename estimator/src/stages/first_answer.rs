//! The first answer: a coarse estimate that is complete, so that a result stands whatever the machine does afterwards.

use crate::api::{Options, Progress};
use crate::budget::{self, Done, FirstAnswer, Machine, WallClock};
use crate::factorisation::factorise;
use crate::mesh::clustering::sketched;
use crate::specular::Gloss;
use crate::stages::gloss::Answer;
use crate::stages::model::{select_model, trace};
use crate::stages::prepare::prepare_on;
use crate::stages::result::{light, result};
use crate::stages::run::Run;
use crate::stages::scale::fix_scale;
use firmware_config::{EstimatorConfig, Switch, TextureChoice};
use recordings::decision::Cut;
use recordings::local_light::LocalLight;
use recordings::scan::Scan;
use std::sync::Arc;

/// The first answer of a run, made at once or beside other work. It keeps its own coarse mesh: brought to the vertices of the scan, it
/// would come later and tell no more.
#[derive(Clone, Copy, Default)]
pub struct First<'a> {
    /// What it took of the machine, if it is made.
    done: Done,
    /// What it is made of, if it is not.
    waits: Option<Ingredients<'a>>,
}

#[derive(Clone, Copy)]
struct Ingredients<'a> {
    scan: &'a Scan,
    config: &'a EstimatorConfig,
    options: &'a Options,
    progress: &'a dyn Progress,
}

impl<'a> First<'a> {
    /// Hands a coarse estimate over, if the run has a clock; none where its few pictures show too little. Where the budget is far from
    /// binding, it waits for work that leaves threads idle.
    pub fn new(
        machine: &'a dyn Machine,
        scan: &'a Scan,
        config: &'a EstimatorConfig,
        options: &'a Options,
        progress: &'a dyn Progress,
    ) -> Self {
        if options.rounds.is_some() {
            return Self::default();
        }
        progress.stage("first answer", 0.0);
        let ingredients = Ingredients { scan, config, options, progress };
        if budget::is_ample(machine, options.budget, config, &Run::size(scan, config)) {
            return Self { done: Done::default(), waits: Some(ingredients) };
        }
        let began = machine.now();
        let reference_seconds = ingredients.make();
        machine.worked(reference_seconds);
        Self { done: Done { reference_seconds, seconds: machine.now() - began }, waits: None }
    }

    /// What it took of the machine so far.
    #[must_use]
    pub fn done(&self) -> Done {
        self.done
    }

    /// Makes the answer if it still waits; returns the reference seconds of that.
    #[must_use]
    pub fn made_late(self) -> f64 {
        self.waits.map_or(0.0, Ingredients::make)
    }
}

impl Ingredients<'_> {
    /// Hands the answer over; returns its cost in reference seconds.
    fn make(self) -> f64 {
        let Self { scan, config, options, progress } = self;
        let size = Run::size(scan, config);
        let effort = FirstAnswer::of(&size);
        make(scan, effort, config, options, progress);
        effort.cost(&size)
    }
}

fn make(scan: &Scan, effort: FirstAnswer, config: &EstimatorConfig, options: &Options, progress: &dyn Progress) {
    let config = coarse(config, effort);
    // Fixed rounds: this part of the run has no plan of its own.
    let options = Options { rounds: Some(1), ..options.clone() };
    let clock = WallClock::start();
    let mut own = Run::new(&clock, scan, &config, &options, &(), Done::default());
    own.plan.restrict(1.0, effort.keyframe_stride);
    let Ok(mut prepared) = prepare_on(sketched(&scan.mesh, effort.vertices), scan, &mut own) else { return };
    let traced = trace(&prepared, &mut own);
    let model = select_model(&mut prepared, traced, &mut own);
    let found = factorise(Arc::clone(&model.traced), &prepared.colors(), &model.options, model.start);
    let mut answer = Answer { found, gloss: vec![Gloss::NONE; prepared.segments] };
    fix_scale(&mut prepared, &mut answer, &config);
    own.plan.cut(Cut::FirstAnswer {
        vertices: prepared.mesh.positions.len() as u32,
        keyframes: scan.keyframes.len().div_ceil(effort.keyframe_stride) as u32,
    });
    let local_light = LocalLight::default();
    let light = light(&prepared, &mut answer, local_light.model, &config);
    let (estimate, _) = result(scan, &mut prepared, answer, local_light, light, &own);
    progress.answer(&estimate);
}

/// The settings at their cheapest.
fn coarse(config: &EstimatorConfig, effort: FirstAnswer) -> EstimatorConfig {
    EstimatorConfig {
        rays: effort.rays,
        bands: effort.bands,
        bounces: 1,
        refine_poses: Switch::Off,
        specular: Switch::Off,
        texture: TextureChoice::Off,
        ..config.clone()
    }
}
