//! Transfer, bands, bounces and rays, by evidence and within the plan (§3.3).

use crate::factorisation::{FactorisationOptions, Factorised, Start, factorise};
use crate::model_selection::{self, BandLimits};
use crate::stages::prepare::Prepared;
use crate::stages::run::Run;
use crate::transfer::{self, Traced, Tracer};
use firmware_config::SolverChoice;
use recordings::decision::Decision;
use std::sync::Arc;

/// Transfer (Eq. 8) with the rays that are set, or with the few by which [`select_model`] judges whether more are required.
pub fn trace(prepared: &Prepared, run: &mut Run) -> Arc<Traced> {
    let tuning = &run.config.tuning.model_selection;
    let blocked = tracer(prepared, run).blocked(tuning.pilot_vertices as usize, tuning.pilot_rays);
    if !model_selection::is_open(run.config, blocked) {
        let max_rays = run.plan.workload().rays;
        let rays = if run.rays_are_set() { max_rays } else { max_rays.min(tuning.pilot_rays) };
        if let Some(traced) = trace_more(prepared, rays, None, run) {
            return traced;
        }
    }
    Arc::new(transfer::unoccluded(&prepared.mesh, run.plan.workload().bands))
}

fn tracer<'a>(prepared: &'a Prepared, run: &Run) -> Tracer<'a> {
    let (bands, seed) = (run.plan.workload().bands, run.config.seed);
    Tracer { mesh: &prepared.mesh, graph: &prepared.graph, scene: &prepared.scene, bands, seed }
}

/// Traces up to `rays` rays per vertex, beyond those of `have`, or fewer if the time does not suffice; `None` if not even those
/// would be more.
fn trace_more(prepared: &Prepared, mut rays: u32, have: Option<&Traced>, run: &mut Run) -> Option<Arc<Traced>> {
    let tracer = tracer(prepared, run);
    let progress = run.progress;
    loop {
        let first = have.map_or(0, |h| h.rays);
        let watch = run.plan.watch_rays(rays - first);
        let go_on = |share| {
            progress.stage("transfer", share);
            watch(share)
        };
        let traced = tracer.trace_while(rays, have, &go_on);
        drop(watch);
        if let Some(traced) = traced {
            run.plan.rays_done(rays - first);
            return Some(Arc::new(traced));
        }
        rays = run.plan.fewer_rays(rays, first)?;
    }
}

/// The model that the scene requires.
pub struct SelectedModel<'a> {
    /// Transfer with as many rays as are required.
    pub traced: Arc<Traced>,
    /// Transfer level, bounces and bands.
    pub options: FactorisationOptions<'a>,
    /// Start of the factorisation.
    pub start: Option<Start>,
}

/// Selects bounces, bands and rays.
pub fn select_model<'a>(prepared: &mut Prepared, traced: Arc<Traced>, run: &mut Run<'a>) -> SelectedModel<'a> {
    let config = run.config;
    run.progress.stage("factorisation", 0.0);
    let (bounces, max_bands) = run.plan.light(traced.mean_blocked());
    let gi = model_selection::interreflects(config, &traced);
    let tuning = &config.tuning.factorisation;
    let options = FactorisationOptions { gi, bands: max_bands, max_bands, bounces, solver: config.solver, tuning };
    if config.solver != SolverChoice::Robust {
        return SelectedModel { traced, options, start: None };
    }
    let min_bands = if config.bands > 0 { max_bands } else { 1 };
    let limits = BandLimits { gi, bounces, bands: min_bands..=max_bands };
    let selected = model_selection::bands(&traced, &prepared.colors(), &limits, &config.tuning);
    prepared.decisions.push(selected.decision);
    let options = FactorisationOptions { bands: selected.bands, ..options };
    let mut model = SelectedModel { traced, options, start: Some(selected.start) };
    let (have, blocked) = (model.traced.rays, model.traced.mean_blocked());
    if !run.rays_are_set() && have > 0 {
        let wanted = model_selection::rays(&model.traced, selected.held_out, &config.tuning.model_selection);
        let rays = run.plan.more_rays(wanted, have, blocked, selected.bands, 1);
        model.options.bounces = run.plan.workload().bounces;
        if rays > have
            && let Some(better) = trace_more(prepared, rays, Some(&model.traced), run)
        {
            model.traced = better;
        }
    }
    model
}

/// Rays and bounces that were cut are made up for where time is left in the end.
pub fn spend(prepared: &mut Prepared, found: Factorised, options: &FactorisationOptions, run: &mut Run) -> Factorised {
    if run.plan.has_spare() { refine(prepared, found, options, run) } else { found }
}

/// Factorises again with more rays, if the held-out error asks for them now that gloss is removed, and with bounces that were cut.
pub fn refine(prepared: &mut Prepared, found: Factorised, options: &FactorisationOptions, run: &mut Run) -> Factorised {
    let traced = Arc::clone(&found.transfer.traced);
    let config = run.config;
    if run.rays_are_set() || config.solver != SolverChoice::Robust || traced.rays == 0 {
        return found;
    }
    let held_out = model_selection::held_out_error(&found, &prepared.colors(), &config.tuning);
    let bands = found.solution.bands();
    let wanted = model_selection::rays(&traced, held_out, &config.tuning.model_selection);
    let bounces_before = run.plan.workload().bounces;
    let rays = run.plan.more_rays(wanted, traced.rays, traced.mean_blocked(), bands, bounces_before);
    let bounces = run.plan.workload().bounces;
    let better = if rays > traced.rays { trace_more(prepared, rays, Some(&traced), run) } else { None };
    match &better {
        Some(better) => prepared.decisions.push(Decision::RaysWithoutGloss {
            chosen: better.rays,
            before: traced.rays,
            held_out,
            error_before: traced.relative_error(),
            error: better.relative_error(),
            vertices: better.vertices() as u32,
        }),
        None if rays > traced.rays => {
            run.plan.bounces_stay(bounces_before);
            return found;
        }
        None if !options.gi || bounces == bounces_before => return found,
        None => {}
    }
    let options = FactorisationOptions { bands, bounces, ..*options };
    factorise(better.unwrap_or(traced), &prepared.colors(), &options, Some(found.into()))
}
