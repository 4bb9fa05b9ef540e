//! Sweeps settings over one scene and measures each against ground truth.

use crate::api::EstimateError;
use crate::api::Options;
use crate::api::Progress;
use crate::budget::{self, Done, Machine, WallClock};
use crate::factorisation::{FactorisationOptions, Factorised, factorise};
use crate::numerics::sh::MAX_BANDS;
use crate::specular::refit::{Refitted, refit};
use crate::stages::{self, Prepared, Run};
use crate::sweep::point::Point;
use crate::sweep::truth::{Answer, Truth};
use crate::transfer::{self, Traced, Tracer};
use firmware_config::{EstimatorConfig, Quality, SolverChoice, Switch};
use recordings::decision::TransferLevel;
use recordings::scan::Scan;
use std::sync::Arc;
use std::time::Duration;

/// The grid: SH bands, rays per vertex, shares of the vertices.
const BANDS: [usize; 6] = [2, 3, 4, 5, 7, 9];
const RAYS: [u32; 3] = [64, 256, 1024];
const VERTICES: [f64; 2] = [0.25, 0.5];
/// Bands of the paper's setting: l ≤ 4.
const PAPER_BANDS: usize = 5;
/// Settings of a whole sweep: the grid (diffuse takes no rays), `auto`, named points, three solvers, vertices, keyframes.
pub const SETTINGS: usize = BANDS.len() * (1 + 2 * RAYS.len()) + 1 + 2 + 3 + VERTICES.len() + 1;
/// A budget that never binds.
const UNLIMITED: Options =
    Options { budget: Duration::from_secs(1_000_000), rounds: None, reference: None, memory_mb: None };

/// What settings share, and its cost.
struct Shared {
    prepared: Prepared,
    seconds: f64,
    keyframes: usize,
}

/// Sweeps the settings on one scene, timed by `clock`: `auto` first, then by number of rays. Settings that have not begun
/// within `limit` of wall time are left out.
///
/// # Errors
/// The scan is unusable.
pub fn sweep(
    scan: &Scan,
    truth: &Truth,
    config: &EstimatorConfig,
    clock: &dyn Machine,
    limit: Duration,
    progress: &dyn Progress,
) -> Result<Vec<Point>, EstimateError> {
    let wall = WallClock::start();
    let limit = limit.as_secs_f64();
    let mut run = Sweep { scan, truth, config, clock, wall, limit, points: Vec::new(), progress };
    let mut shared = run.prepare(config, 1.0, 1)?;
    // As `lumiscan estimate` chooses, and at the other named points.
    run.automatic("auto", config, &mut shared);
    for (name, quality) in [("draft", Quality::Draft), ("best", Quality::Best)] {
        run.variant(name, &budget::at_quality(&EstimatorConfig { quality, ..config.clone() }), 1.0, 1)?;
    }
    let open = run.timed(|_| Arc::new(transfer::unoccluded(&shared.prepared.mesh, MAX_BANDS)));
    for rays in RAYS {
        if run.is_over() {
            break;
        }
        let Prepared { mesh, graph, scene, .. } = &shared.prepared;
        let tracer = Tracer { mesh, graph, scene, bands: MAX_BANDS, seed: config.seed };
        let traced = run.timed(|run| {
            let report = |share| run.progress.stage("transfer", share);
            Arc::new(tracer.trace(rays, &report))
        });
        if rays == RAYS[0] {
            BANDS.into_iter().for_each(|bands| run.grid(&mut shared, &open, TransferLevel::Diffuse, bands));
            run.paper_solver(&mut shared, &traced);
        }
        for transfer in [TransferLevel::Shade, TransferLevel::Gi] {
            BANDS.into_iter().for_each(|bands| run.grid(&mut shared, &traced, transfer, bands));
        }
    }
    drop(shared);
    for share in VERTICES {
        run.variant(&format!("vertices {share}"), config, share, 1)?;
    }
    run.variant("keyframes 0.5", config, 1.0, 2)?;
    let mut points = run.points;
    for i in 0..points.len() {
        let (error, seconds) = (points[i].error(), points[i].seconds);
        points[i].pareto = !points
            .iter()
            .any(|p| p.error() <= error && p.seconds <= seconds && (p.error() < error || p.seconds < seconds));
    }
    Ok(points)
}

struct Sweep<'a> {
    scan: &'a Scan,
    truth: &'a Truth,
    config: &'a EstimatorConfig,
    clock: &'a dyn Machine,
    wall: WallClock,
    limit: f64,
    points: Vec<Point>,
    progress: &'a dyn Progress,
}

impl<'a> Sweep<'a> {
    fn timed<T>(&self, work: impl FnOnce(&Self) -> T) -> (T, f64) {
        let before = self.clock.now();
        let done = work(self);
        (done, self.clock.now() - before)
    }

    fn is_over(&self) -> bool {
        self.wall.now() > self.limit
    }

    fn prepare(&self, config: &EstimatorConfig, vertices: f64, stride: usize) -> Result<Shared, EstimateError> {
        let (prepared, seconds) = self.timed(|sweep| {
            let mut run = Run::new(sweep.clock, sweep.scan, config, &UNLIMITED, sweep.progress, Done::default());
            run.plan.restrict(vertices, stride);
            stages::prepare(sweep.scan, || 0.0, &mut run)
        });
        Ok(Shared { prepared: prepared?, seconds, keyframes: self.scan.keyframes.len().div_ceil(stride) })
    }

    fn variant(
        &mut self,
        name: &str,
        config: &EstimatorConfig,
        vertices: f64,
        stride: usize,
    ) -> Result<(), EstimateError> {
        if !self.is_over() {
            let mut shared = self.prepare(config, vertices, stride)?;
            self.automatic(name, config, &mut shared);
        }
        Ok(())
    }

    /// Everything as `lumiscan estimate` does it.
    fn automatic(&mut self, name: &str, config: &EstimatorConfig, shared: &mut Shared) {
        let mut run = Run::new(self.clock, self.scan, config, &UNLIMITED, self.progress, Done::default());
        self.point(name, shared, 0.0, |_, prepared| {
            let solved = stages::light_and_albedo(prepared, &mut run);
            let (mut answer, _, mut with_gloss) = stages::materials_and_gloss(prepared, solved, &mut run);
            stages::sharpen(prepared, &mut answer.found, &mut with_gloss);
            answer.found
        });
    }

    fn grid(&mut self, shared: &mut Shared, traced: &(Arc<Traced>, f64), transfer: TransferLevel, bands: usize) {
        let options = self.options(transfer == TransferLevel::Gi, bands, SolverChoice::Robust);
        self.setting("grid", shared, traced, &options, true);
    }

    fn options(&self, gi: bool, bands: usize, solver: SolverChoice) -> FactorisationOptions<'a> {
        let tuning = &self.config.tuning.factorisation;
        FactorisationOptions { gi, bands, max_bands: bands, bounces: 0, solver, tuning }
    }

    /// The paper's own update at its setting, without our specular refit, which would add to its time; the same update,
    /// and the nonsegmented one, with bands and specular refit as in `auto`, so that the solver alone differs.
    fn paper_solver(&mut self, shared: &mut Shared, traced: &(Arc<Traced>, f64)) {
        let auto = self.points.first().map_or(PAPER_BANDS, |p| p.bands);
        for (name, bands, solver, removes_gloss) in [
            ("paper", PAPER_BANDS, SolverChoice::Literal, false),
            ("literal", auto, SolverChoice::Literal, true),
            ("nonsegmented", auto, SolverChoice::Nonsegmented, true),
        ] {
            let options = self.options(true, bands, solver);
            self.setting(name, shared, traced, &options, removes_gloss);
        }
    }

    /// One factorisation, and where gloss is removed, specular weights and another one without it.
    fn setting(
        &mut self,
        name: &str,
        shared: &mut Shared,
        traced: &(Arc<Traced>, f64),
        options: &FactorisationOptions,
        removes_gloss: bool,
    ) {
        self.point(name, shared, traced.1, |sweep, prepared| {
            let found = factorise(Arc::clone(&traced.0), &prepared.colors(), options, None);
            if !removes_gloss || sweep.config.specular == Switch::Off {
                return found;
            }
            let (surface, fields) = prepared.surface();
            let Refitted { found, .. } = refit(&surface, fields, found, options, &sweep.config.tuning.specular);
            found
        });
    }

    /// Measures what `solve` finds, whose transfer took `tracing` seconds before.
    fn point(
        &mut self,
        name: &str,
        shared: &mut Shared,
        tracing: f64,
        solve: impl FnOnce(&Self, &mut Prepared) -> Factorised,
    ) {
        if self.is_over() {
            return;
        }
        self.progress.stage("factorisation", 0.0);
        let prepared = &mut shared.prepared;
        // Glare and gloss are taken out of exposures and lit colours, and segments change: all is restored for the next setting.
        let fields = prepared.fields.clone();
        let (segment, segments) = (prepared.segment.clone(), prepared.segments);
        let (found, seconds) = self.timed(|sweep| solve(sweep, prepared));
        let seconds = shared.seconds + tracing + seconds;
        let (albedo_error, irradiance_error) = self.errors(prepared, &found);
        (prepared.fields, prepared.segment, prepared.segments) = (fields, segment, segments);
        self.points.push(Point {
            name: name.into(),
            bands: found.solution.bands(),
            transfer: stages::transfer_level(&found),
            rays: found.transfer.traced.rays,
            vertices: prepared.mesh.positions.len(),
            keyframes: shared.keyframes,
            seconds,
            albedo_error,
            irradiance_error,
            pareto: false,
        });
    }

    fn errors(&self, prepared: &Prepared, found: &Factorised) -> (f64, f64) {
        let seen: Vec<bool> = prepared.fields.offsets.windows(2).map(|o| o[1] - o[0] >= 2).collect();
        self.truth.errors(&Answer {
            mesh: &prepared.mesh,
            scene: &prepared.scene,
            views: &self.views(prepared),
            seen: &seen,
            albedo: &found.detail.albedo,
            irradiance: &found.irradiance,
        })
    }

    fn views(&self, prepared: &Prepared) -> Vec<(i64, recordings::types::Pose)> {
        let times = self.scan.keyframes.iter().map(|k| k.color.timestamp_ns);
        times.zip(&prepared.fields.views).map(|(t, v)| (t, v.world_from_camera)).collect()
    }
}
