//! The trade of speed against accuracy, measured: settings swept on a scene whose albedo and light are known.
//!
//! This is the one place that looks at truth. Nothing here feeds back into an estimate.

pub mod alignment;
pub mod plot;
pub mod truth;

pub use truth::{Answer, Truth};

use crate::api::EstimateError;
use crate::api::Options;
use crate::api::Progress;
use crate::budget::{self, Machine, Plan, WallClock};
use crate::factorisation::{Factorised, Settings, Start, factorise};
use crate::specular::refit;
use crate::stages::{self, Ready};
use crate::transfer::{self, Traced};
use firmware_config::{EstimatorConfig, Quality, SolverChoice, Switch};
use glam::Vec3;
use recordings::decision::TransferLevel;
use recordings::scan::Scan;
use std::fmt::Write;
use std::sync::Arc;
use std::time::Duration;

/// The grid.
const BANDS: [usize; 6] = [2, 3, 4, 5, 7, 9];
const RAYS: [u32; 3] = [64, 256, 1024];
const VERTICES: [f64; 2] = [0.25, 0.5];
/// Bands of the paper's setting: l ≤ 4.
const PAPER_BANDS: usize = 5;
/// A setting comes near the best if its error is at most this many times as large …
const NEAR: f64 = 1.1;
/// … and `auto` may take this many times as long as the cheapest that comes near.
const DEAR: f64 = 2.0;
/// Settings of a whole sweep: the grid (diffuse takes no rays), `auto`, named points, three solvers, vertices, keyframes.
pub const SETTINGS: usize = BANDS.len() * (1 + 2 * RAYS.len()) + 1 + 2 + 3 + VERTICES.len() + 1;
/// A budget that never binds.
const UNLIMITED: Options = Options { budget: Duration::from_secs(1_000_000), rounds: None };

/// One setting and what it brought.
#[derive(Debug, Clone, PartialEq)]
pub struct Point {
    /// What is special about it: "grid", "auto", "draft", "best", "paper", "nonsegmented", "literal", "vertices 0.25" …
    pub name: String,
    /// SH bands.
    pub bands: usize,
    /// Transfer level.
    pub transfer: TransferLevel,
    /// Rays per vertex; 0 for diffuse.
    pub rays: u32,
    /// Vertices.
    pub vertices: usize,
    /// Keyframes used.
    pub keyframes: usize,
    /// Seconds of the clock from the estimator's start to the answer, stages that settings share included.
    pub seconds: f64,
    /// Median relative error of the albedo, after one factor per channel.
    pub albedo_error: f64,
    /// The same of the irradiance.
    pub irradiance_error: f64,
    /// No other setting is both faster and better.
    pub pareto: bool,
}

impl Point {
    /// What settings are ranked by.
    #[must_use]
    pub fn error(&self) -> f64 {
        self.albedo_error + self.irradiance_error
    }
}

/// How `auto` fares against the rule.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Margins {
    /// Its error over the best.
    pub error: f64,
    /// Its time over that of the cheapest setting that comes near the best.
    pub seconds: f64,
}

impl Margins {
    /// The rule holds.
    #[must_use]
    pub fn hold(&self) -> bool {
        self.error <= NEAR && self.seconds <= DEAR
    }
}

/// The margins of `auto` in a sweep; `None` if it is not in it.
#[must_use]
pub fn margins(points: &[Point]) -> Option<Margins> {
    let auto = points.iter().find(|p| p.name == "auto")?;
    let best = points.iter().map(Point::error).fold(f64::INFINITY, f64::min);
    let near = points.iter().filter(|p| p.error() <= NEAR * best);
    let cheapest = near.map(|p| p.seconds).fold(f64::INFINITY, f64::min);
    Some(Margins { error: auto.error() / best, seconds: auto.seconds / cheapest })
}

/// What stages cost before a setting's own begin.
struct Shared {
    ready: Ready,
    seconds: f64,
    keyframes: usize,
}

/// Sweeps the settings on one scene, timed by `clock`. What is not begun within `limit` of wall time is left out, fewest
/// rays first, `auto` before all.
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
    // As `lumiscan estimate` would do it by itself, and at the other named points.
    run.by_itself("auto", config, &mut shared);
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
            run.literal(&mut shared, &traced);
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
            self.by_itself(name, config, &mut shared);
        }
        Ok(())
    }

    fn by_itself(&mut self, name: &str, config: &EstimatorConfig, shared: &mut Shared) {
        let before = self.clock.now();
        let mut plan = Plan::new(self.clock, &UNLIMITED, config, stages::size(self.scan, config));
        let traced = stages::transfer(&shared.ready, config, &UNLIMITED, &mut plan, self.progress);
        let ready = &mut shared.ready;
        let settled = stages::settle(ready, traced, config, &UNLIMITED, &mut plan, self.progress);
        let spent = self.clock.now() - before;
        self.point(name, shared, &(settled.traced, spent), settled.settings, settled.start, Some((config, &mut plan)));
    }

    fn grid(&mut self, shared: &mut Shared, traced: &(Arc<Traced>, f64), transfer: TransferLevel, bands: usize) {
        let settings = Settings {
            gi: transfer == TransferLevel::Gi,
            bands,
            most_bands: bands,
            bounces: 0,
            solver: SolverChoice::Robust,
        };
        self.point("grid", shared, traced, settings, None, None);
    }

    /// The paper's own update: its setting, and the same and the nonsegmented one with the bands of `auto`.
    fn literal(&mut self, shared: &mut Shared, traced: &(Arc<Traced>, f64)) {
        let auto = self.points.first().map_or(PAPER_BANDS, |p| p.bands);
        for (name, bands, solver) in [
            ("paper", PAPER_BANDS, SolverChoice::Literal),
            ("literal", auto, SolverChoice::Literal),
            ("nonsegmented", auto, SolverChoice::Nonsegmented),
        ] {
            let settings = Settings { gi: true, bands, most_bands: bands, bounces: 0, solver };
            self.point(name, shared, traced, settings, None, None);
        }
    }

    fn point(
        &mut self,
        name: &str,
        shared: &mut Shared,
        traced: &(Arc<Traced>, f64),
        settings: Settings,
        start: Option<Start>,
        by_itself: Option<(&EstimatorConfig, &mut Plan)>,
    ) {
        if self.is_over() {
            return;
        }
        self.progress.stage("factorisation", 0.0);
        let ready = &mut shared.ready;
        // Gloss is taken out of exposures and lit colours: the next setting is to find them as they were.
        let fields = ready.fields.clone();
        let before = self.clock.now();
        let mut found = factorise(Arc::clone(&traced.0), &ready.colors(), &settings, start);
        if self.config.specular != Switch::Off {
            let gloss;
            (found, gloss, _) =
                refit::refit(&ready.mesh, &ready.scene, &mut ready.fields, &ready.segment, found, &settings);
            if let Some((config, plan)) = by_itself.filter(|_| gloss.iter().any(|g| g.significant)) {
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

/// The sweep as a table for programs.
#[must_use]
pub fn to_csv(scene: &str, points: &[Point]) -> String {
    let mut text = String::new();
    for p in points {
        let _ = writeln!(
            text,
            "{scene},{},{},{},{},{},{},{:.3},{:.5},{:.5},{:.5},{}",
            p.name,
            p.bands,
            p.transfer,
            p.rays,
            p.vertices,
            p.keyframes,
            p.seconds,
            p.albedo_error,
            p.irradiance_error,
            p.error(),
            u8::from(p.pareto)
        );
    }
    text
}

/// Head of the table.
pub const CSV_HEAD: &str = "scene,setting,bands,transfer,rays,vertices,keyframes,seconds,albedo_error,irradiance_error,\
                            error,pareto\n";

fn luminous(v: &Vec3) -> bool {
    v.is_finite() && v.min_element() > 0.0
}
