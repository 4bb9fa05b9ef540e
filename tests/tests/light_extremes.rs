//! The estimator at the extremes: each ends in an honest answer or in a refusal, never in NaN.

use estimator::EstimateError;
use estimator::Options;
use estimator::mesh::graph::Graph;
use estimator::rays::RayScene;
use estimator::transfer::{self, Tracer, Transfer};
use firmware_config::EstimatorConfig;
use glam::Vec3;
use recordings::decision::{TransferLevel, Warning};
use recordings::result::Estimate;
use recordings::scan::Scan;
use recordings::types::Mesh;
use std::sync::Arc;
use std::time::Duration;
use tests::scans::{globe, scan, shaded, sheet};

/// A flat wall of `n` × `n` quads in z = 0, facing +z.
fn wall(n: u32, size: f32) -> Mesh {
    sheet(n, Vec3::new(-0.5, -0.5, 0.0) * size, Vec3::X * size, Vec3::Y * size)
}

fn run(scan: &Scan) -> Result<Estimate, EstimateError> {
    let options = Options { budget: Duration::from_secs(600), rounds: Some(1), reference: None, memory_mb: None };
    let e = estimator::estimate(scan, &EstimatorConfig::default(), &options, &())?;
    let finite = |v: &Vec3| v.is_finite() && v.min_element() >= 0.0;
    assert_eq!(e.albedo.len(), e.mesh.positions.len());
    assert!(e.albedo.iter().all(|a| finite(a) && a.max_element() <= 1.0), "albedo");
    assert!(e.lit_color.iter().all(finite), "lit colour");
    assert!(e.confidence.iter().all(|c| (0.0..=1.0).contains(c)), "confidence");
    assert!(e.segment.iter().all(|s| (*s as usize) < e.segments.len()), "segment");
    assert!(e.light.coefficients.iter().chain(&e.light.standard_deviation).flatten().all(|x| x.is_finite()), "light");
    assert!(e.segments.iter().all(|s| s.albedo.iter().all(|x| x.is_finite()) && s.w_d.is_finite() && s.w_s >= 0.0));
    assert!(e.keyframes.iter().all(|k| k.world_from_camera.is_finite() && k.gain.iter().all(|g| *g > 0.0)));
    Ok(e)
}

#[test]
fn nothing_to_work_with_is_refused() {
    for mesh in [Mesh::default(), Mesh { positions: vec![Vec3::ZERO], normals: vec![Vec3::Z], triangles: vec![] }] {
        assert!(matches!(run(&scan(mesh, 3, 2.0, shaded)), Err(EstimateError::Unusable(_))), "no triangle");
    }
    assert!(matches!(run(&scan(globe(12, 0.5, 1.0), 0, 2.0, shaded)), Err(EstimateError::Unusable(_))), "no keyframe");
}

#[test]
fn black_and_clipped_pictures_carry_no_weight() {
    for pixel in [|_, _| [0; 3], |_, _| [255; 3]] as [fn(u32, u32) -> [u8; 3]; 2] {
        match run(&scan(globe(12, 0.5, 1.0), 3, 2.0, pixel)) {
            Err(e) => assert!(matches!(&e, EstimateError::Unusable(why) if !why.is_empty()), "{e}"),
            Ok(e) => assert!(e.confidence.iter().all(|c| *c < 0.1), "confident in {:?}", pixel(0, 0)),
        }
    }
}

#[test]
fn one_keyframe_gives_an_answer_and_a_warning() {
    let e = run(&scan(globe(16, 0.5, 1.0), 1, 2.0, shaded)).expect("an answer");
    assert!(e.warnings.contains(&Warning::OneKeyframe), "{:?}", e.warnings);
    assert!(e.confidence.contains(&0.0), "its back was never seen");
    assert!(e.confidence.iter().any(|c| *c > 0.1), "its front was");
}

#[test]
fn a_wall_has_neither_bounces_nor_gloss() {
    let e = run(&scan(wall(24, 1.0), 3, 1.5, |_, _| [128; 3])).expect("an answer");
    assert!(e.transfer != TransferLevel::Gi, "a flat wall reflects nothing onto itself: {}", e.transfer);
    assert!(e.segments.iter().all(|s| s.w_s == 0.0), "gloss cannot be observed on it");
}

#[test]
fn hostile_geometry_ends_in_an_answer() {
    let mut mesh = globe(16, 0.5, 1.0);
    let n = mesh.positions.len() as u32;
    mesh.positions.extend([Vec3::splat(f32::NAN), Vec3::splat(1e30), Vec3::ZERO]);
    mesh.normals.extend([Vec3::splat(f32::NAN), Vec3::ZERO, Vec3::ZERO]);
    mesh.triangles.extend([[0, 1, n], [0, 1, n + 1], [5, 5, 6], [0, 1, 2], [0, 1, 2], [7, 8, n + 2]]);
    run(&scan(mesh, 3, 2.0, shaded)).expect("an answer");
}

#[test]
fn scale_does_not_matter() {
    let at = |size: f32| run(&scan(globe(16, 0.5 * size, 1.0), 3, 2.0 * f64::from(size), shaded)).expect("an answer");
    let (small, large) = (at(0.01), at(100.0));
    for (a, b) in small.albedo.iter().zip(&large.albedo) {
        assert!((*a - *b).length() < 1e-3 * (1.0 + a.length()), "albedo {a} {b}");
    }
    let of = |e: &Estimate| e.light.coefficients.iter().flatten().copied().collect::<Vec<f64>>();
    let (a, b) = (of(&small), of(&large));
    let size = a.iter().map(|x| x * x).sum::<f64>().sqrt();
    for (a, b) in a.iter().zip(&b) {
        assert!((a - b).abs() < 1e-3 * size, "light {a} {b}");
    }
}

/// Inside a closed sphere of albedo ρ with unit emission the radiosity is 1/(1 − ρ): the bounces are that series.
#[test]
fn closed_sphere_is_the_geometric_series() {
    let mesh = globe(24, 1.0, -1.0);
    let mut traced = Tracer { mesh: &mesh, graph: &Graph::of(&mesh), scene: &RayScene::new(&mesh), bands: 1, seed: 1 }
        .trace(64, &|_| ());
    assert!(traced.blocked.iter().all(|b| *b == 1.0), "no ray leaves a closed sphere");
    // Emission in the place of light from outside.
    Arc::make_mut(&mut traced.direct).fill(1.0);
    let traced = Arc::new(traced);
    for rho in [0.001f32, 0.5, 0.9, 0.999] {
        let bounced = transfer::bounce(&traced, &vec![Vec3::splat(rho); mesh.positions.len()], 0);
        let transfer = Transfer { traced: Arc::clone(&traced), bounced: Some(bounced) };
        let expected = 1.0 / (1.0 - f64::from(rho));
        for i in 0..mesh.positions.len() {
            let mut row = [0.0];
            transfer.row(i, 1, &mut row);
            assert!((row[0] / expected - 1.0).abs() < 1e-2, "ρ = {rho}: {} instead of {expected}", row[0]);
        }
    }
}

#[test]
fn same_bits_for_any_thread_count() {
    let scan = scan(globe(16, 0.5, 1.0), 3, 2.0, shaded);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| run(&scan).expect("an answer"))
    };
    assert!(with(1) == with(3), "the answer depends on the number of threads");
}
