//! Table 1 of the paper on this machine: one scene remeshed to the paper's five sizes. Figures are seconds of wall time,
//! and below them of processor time, which a busy machine stretches less.
//!
//! Needs a scene of posed pictures: `LUMISCAN_SHARED=<shared data> cargo bench -p estimator --bench table1`.

// The paper's 3.14 seconds are no π.
#![allow(clippy::expect_used, clippy::approx_constant)]

mod usage;

use estimator::Options;
use estimator::association::{self, AssociationContext};
use estimator::factorisation::{Colors, FactorisationOptions, factorise};
use estimator::mesh::graph::Graph;
use estimator::mesh::regularise;
use estimator::numerics::sh;
use estimator::rays::RayScene;
use estimator::segmentation;
use estimator::transfer::{self, Tracer};
use firmware_config::{EstimatorConfig, SolverChoice};
use glam::{DVec2, Vec3};
use recordings::import::photos::import_photos;
use recordings::scan::ScanSource;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};
use usage::{peak_mib, processor_s};

/// Vertices, and the paper's seconds: diffuse, shade, gi, segmentation, iteration, total.
const PAPER: [(usize, [f64; 6]); 5] = [
    (10_371, [0.029, 0.780, 10.669, 0.048, 6.333, 17.050]),
    (22_982, [0.099, 4.260, 76.990, 0.113, 10.090, 87.193]),
    (34_817, [0.100, 3.140, 22.410, 0.145, 10.970, 33.525]),
    (72_119, [0.212, 7.550, 112.603, 0.314, 15.993, 128.910]),
    (229_059, [0.656, 32.887, 470.782, 1.109, 48.341, 502.232]),
];
/// What is measured: seconds, but for the last.
const HEADS: [&str; 9] =
    ["diffuse", "shade", "gi", "segmentation", "iteration", "total", "association", "all in", "peak MiB"];
/// Keyframes of the all-in run.
const KEYFRAMES: usize = 20;
/// Rays per vertex, the default.
const RAYS: u32 = 128;

/// What was made, and the seconds of wall and of processor time it took.
fn timed<T>(work: impl FnOnce() -> T) -> (T, DVec2) {
    let (start, before) = (Instant::now(), processor_s());
    let made = work();
    (made, DVec2::new(start.elapsed().as_secs_f64(), processor_s() - before))
}

fn main() {
    let Some(shared) = std::env::var_os("LUMISCAN_SHARED").map(PathBuf::from) else {
        println!("skipped: LUMISCAN_SHARED is not set (it names the folder with truth/fruits)");
        return;
    };
    let mut scan = import_photos(&shared.join("truth/fruits"), None).expect("a scan");
    scan.keyframes.truncate(KEYFRAMES);
    // Regularised as a fused mesh is.
    scan.source = ScanSource::Fusion;
    // A Markdown table; what the paper does not give stays empty.
    let row = |head: &str, times: &[f64]| {
        let cell = |k| times.get(k).map_or_else(String::new, |t: &f64| format!("{t:.2}"));
        println!("| {head} | {} |", (0..HEADS.len()).map(cell).collect::<Vec<_>>().join(" | "));
    };
    println!("| vertices | {} |\n|---|{}", HEADS.join(" | "), "---|".repeat(HEADS.len()));
    let mut all_in = Vec::new();
    for (size, paper) in PAPER {
        // A target far below the mesh's own edges, so that the number of vertices decides.
        let config =
            EstimatorConfig { max_vertices: size as u32, regularise: 0.01, rays: RAYS, ..EstimatorConfig::default() };
        let mesh = regularise::regularise(&scan.mesh, &config, ScanSource::Fusion);
        let scene = RayScene::new(&mesh);
        let (fields, association) = timed(|| {
            let mut context = AssociationContext::new(&mesh, &scene, &scan.sensor.response, &config);
            association::associate(&mut context, &scan.keyframes, &())
        });
        let ((graph, segment), segmentation) = timed(|| {
            let graph = Graph::of(&mesh);
            let segment = segmentation::segment(&mesh, &graph, &scene, &fields.lit_color, &fields.lit_weight, &config);
            (graph, segment)
        });
        let (_, diffuse) = timed(|| transfer::unoccluded(&mesh, sh::MAX_BANDS));
        let tracer = Tracer { mesh: &mesh, graph: &graph, scene: &scene, bands: sh::MAX_BANDS, seed: config.seed };
        let (traced, shade) = timed(|| tracer.trace(RAYS, &|_| ()));
        let (_, bounces) = timed(|| transfer::bounce(&traced, &vec![Vec3::splat(0.5); mesh.positions.len()], 0));
        let gi = shade + bounces;
        let segments = segment.iter().max().map_or(0, |s| *s as usize + 1);
        let colors = Colors {
            lit_color: &fields.lit_color,
            lit_weight: &fields.lit_weight,
            reliability: &fields.reliability,
            clipped: &fields.clipped,
            segment: &segment,
            segments,
            graph: &graph,
            known: None,
        };
        let options = FactorisationOptions {
            gi: true,
            bands: sh::MAX_BANDS,
            max_bands: sh::MAX_BANDS,
            bounces: 0,
            solver: SolverChoice::Robust,
            tuning: &config.tuning.factorisation,
        };
        let (_, iteration) = timed(|| factorise(Arc::new(traced), &colors, &options, None));
        drop(fields);
        let options = Options { budget: Duration::from_secs(3600), rounds: None, reference: None, memory_mb: None };
        let (_, whole) = timed(|| estimator::estimate(&scan, &config, &options, &()).expect("an answer"));
        all_in.push((mesh.positions.len() as f64, whole.y));
        let total = gi + segmentation + iteration;
        let times = [diffuse, shade, gi, segmentation, iteration, total, association, whole];
        let wall: Vec<f64> = times.iter().map(|t| t.x).chain([peak_mib()]).collect();
        let processor: Vec<f64> = times.iter().map(|t| t.y).collect();
        row(&format!("{}", mesh.positions.len()), &wall);
        row("processor", &processor);
        row(&format!("paper, {size}"), &paper);
    }
    let (first, last) = (all_in[0], all_in[all_in.len() - 1]);
    println!("\nGrowth of processor time, all in: n^{:.2}.", libm::log(last.1 / first.1) / libm::log(last.0 / first.0));
}
