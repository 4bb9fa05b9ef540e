//! Sweeps settings over one scene and measures each against ground truth.

use crate::api::EstimateError;
use crate::api::Options;
use crate::api::Progress;
use crate::budget::{self, Machine, Plan, WallClock};
use crate::factorisation::{Factorised, Settings, Start, factorise};
use crate::specular::refit;
use crate::stages::{self, Ready};
use crate::sweep::point::Point;
use crate::sweep::truth::{Answer, Truth};
use crate::transfer::{self, Traced};
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
const UNLIMITED: Options = Options { budget: Duration::from_secs(1_000_000), rounds: None };

/// What settings share, and its cost.
struct Shared {
    ready: Ready,
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
    let open = run.timed(|_| Arc::new(transfer::unoccluded(&shared.ready.mesh, crate::numerics::sh::MAX_BANDS)));
    for rays in RAYS {
        if run.is_over() {
            break;
        }
        let (mesh, scene) = (&shared.ready.mesh, &shared.ready.scene);
        let traced = run.timed(|run| {
            let report = |share| run.progress.stage("transfer", share);
            Arc::new(transfer::trace(mesh, scene, crate::numerics::sh::MAX_BANDS, rays, config.seed, &report))
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

/// What follows the first factorisation of a setting.
enum Specular<'a> {
    /// Nothing: the setting has no specular step of ours.
    Skip,
    /// Specular weights and one factorisation without gloss.
    Refit,
    /// As `lumiscan estimate` does: also the refinement after it.
    RefitAndRefine(&'a EstimatorConfig, &'a mut Plan<'a>),
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

impl Sweep<'_> {
    fn timed<T>(&self, work: impl FnOnce(&Self) -> T) -> (T, f64) {
        let before = self.clock.now();
        let done = work(self);
        (done, self.clock.now() - before)
    }

    fn is_over(&self) -> bool {
        self.wall.now() > self.limit
    }

    fn prepare(&self, config: &EstimatorConfig, vertices: f64, stride: usize) -> Result<Shared, EstimateError> {
        let (ready, seconds) = self.timed(|run| {
            let mut plan = Plan::new(run.clock, &UNLIMITED, config, stages::size(run.scan, config));
            plan.restrict(vertices, stride);
            stages::prepare(run.scan, config, &mut plan, run.progress)
        });
        Ok(Shared { ready: ready?, seconds, keyframes: self.scan.keyframes.len().div_ceil(stride) })
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

    fn automatic(&mut self, name: &str, config: &EstimatorConfig, shared: &mut Shared) {
        let before = self.clock.now();
        let mut plan = Plan::new(self.clock, &UNLIMITED, config, stages::size(self.scan, config));
        let traced = stages::transfer(&shared.ready, config, &UNLIMITED, &mut plan, self.progress);
        let ready = &mut shared.ready;
        let settled = stages::settle(ready, traced, config, &UNLIMITED, &mut plan, self.progress);
        let spent = self.clock.now() - before;
        self.point(
            name,
            shared,
            &(settled.traced, spent),
            settled.settings,
            settled.start,
            Specular::RefitAndRefine(config, &mut plan),
        );
    }

    fn grid(&mut self, shared: &mut Shared, traced: &(Arc<Traced>, f64), transfer: TransferLevel, bands: usize) {
        let settings = Settings {
            gi: transfer == TransferLevel::Gi,
            bands,
            most_bands: bands,
            bounces: 0,
            solver: SolverChoice::Robust,
        };
        self.point("grid", shared, traced, settings, None, Specular::Refit);
    }

    /// The paper's own update at its setting, without our specular refit, which would add to its time; the same update,
    /// and the nonsegmented one, with bands and specular refit as in `auto`, so that the solver alone differs.
    fn paper_solver(&mut self, shared: &mut Shared, traced: &(Arc<Traced>, f64)) {
        let auto = self.points.first().map_or(PAPER_BANDS, |p| p.bands);
        for (name, bands, solver, specular) in [
            ("paper", PAPER_BANDS, SolverChoice::Literal, Specular::Skip),
            ("literal", auto, SolverChoice::Literal, Specular::Refit),
            ("nonsegmented", auto, SolverChoice::Nonsegmented, Specular::Refit),
        ] {
            let settings = Settings { gi: true, bands, most_bands: bands, bounces: 0, solver };
            self.point(name, shared, traced, settings, None, specular);
        }
    }

    fn point(
        &mut self,
        name: &str,
        shared: &mut Shared,
        traced: &(Arc<Traced>, f64),
        settings: Settings,
        start: Option<Start>,
        specular: Specular<'_>,
    ) {
        if self.is_over() {
            return;
        }
        self.progress.stage("factorisation", 0.0);
        let ready = &mut shared.ready;
        // The refit takes gloss out of exposures and lit colours: they are restored for the next setting.
        let fields = ready.fields.clone();
        let before = self.clock.now();
        let mut found = factorise(Arc::clone(&traced.0), &ready.colors(), &settings, start);
        if self.config.specular != Switch::Off && !matches!(specular, Specular::Skip) {
            let gloss;
            (found, gloss, _) =
                refit::refit(&ready.mesh, &ready.scene, &mut ready.fields, &ready.segment, found, &settings);
            if let Specular::RefitAndRefine(config, plan) = specular
                && gloss.iter().any(|g| g.significant)
            {
                found = stages::refine(ready, found, &settings, config, &UNLIMITED, plan, self.progress);
            }
        }
        let seconds = shared.seconds + traced.1 + self.clock.now() - before;
        let (albedo_error, irradiance_error) = self.errors(ready, &found);
        ready.fields = fields;
        self.points.push(Point {
            name: name.into(),
            bands: found.solution.light.len().isqrt(),
            transfer: stages::transfer_level(&found),
            rays: found.transfer.traced.rays,
            vertices: ready.mesh.positions.len(),
            keyframes: shared.keyframes,
            seconds,
            albedo_error,
            irradiance_error,
            pareto: false,
        });
    }

    fn errors(&self, ready: &Ready, found: &Factorised) -> (f64, f64) {
        let seen: Vec<bool> = ready.fields.offsets.windows(2).map(|o| o[1] - o[0] >= 2).collect();
        self.truth.errors(&Answer {
            mesh: &ready.mesh,
            scene: &ready.scene,
            views: &self.views(ready),
            seen: &seen,
            albedo: &found.detail.albedo,
            irradiance: &found.irradiance,
        })
    }

    fn views(&self, ready: &Ready) -> Vec<(i64, recordings::types::Pose)> {
        let times = self.scan.keyframes.iter().map(|k| k.color.timestamp_ns);
        times.zip(&ready.fields.views).map(|(t, v)| (t, v.world_from_camera)).collect()
    }
}
