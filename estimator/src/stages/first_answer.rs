//! The first answer: a coarse estimate that is complete, so that a result stands whatever the machine does afterwards.

use crate::api::{Options, Progress};
use crate::budget::{Done, FirstAnswer, Machine, WallClock};
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

/// Hands a coarse estimate over, if the run has a clock; none where its few pictures show too little. It keeps its own coarse mesh:
/// brought to the vertices of the scan, it would come later and tell no more. Returns what it took of the machine.
pub fn first_answer(
    machine: &dyn Machine,
    scan: &Scan,
    config: &EstimatorConfig,
    options: &Options,
    progress: &dyn Progress,
) -> Done {
    if options.rounds.is_some() {
        return Done::default();
    }
    progress.stage("first answer", 0.0);
    let size = Run::size(scan, config);
    let (began, effort) = (machine.now(), FirstAnswer::of(&size));
    make(scan, effort, config, options, progress);
    let reference_seconds = effort.cost(&size);
    machine.worked(reference_seconds);
    Done { reference_seconds, seconds: machine.now() - began }
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
