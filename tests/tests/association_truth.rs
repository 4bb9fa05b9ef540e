//! Data association and segmentation against scenes whose poses, exposures and materials are known.

// Test code: whatever is wrong with a fixture is to end the test.
#![allow(clippy::expect_used)]

use estimator::association::{Association, associate};
use estimator::scene::Scene;
use estimator::{Progress, remesh, segmentation};
use firmware_config::EstimatorConfig;
use recordings::photos::import_photos;
use recordings::scan::Scan;
use recordings::types::Pose;
use std::path::Path;
use tests::metrics::{adjusted_rand_index, median};
use tests::truth::{Truth, json};

struct Silent;
impl Progress for Silent {
    fn stage(&self, _: &'static str, _: f64) {}
}

struct Outcome {
    truth: Truth,
    scan: Scan,
    association: Association,
    segment: Vec<u32>,
}

fn run(shared: &Path, name: &str) -> Outcome {
    let truth = Truth::read(shared, name);
    let scan = import_photos(&truth.folder, None).expect("a scan");
    let config = EstimatorConfig::default();
    let mesh = remesh::regularise(&scan.mesh, &config, scan.source);
    assert_eq!(mesh.positions, truth.mesh.positions, "an imported mesh keeps its vertices");
    let scene = Scene::new(&mesh);
    let association = associate(&mesh, &scene, &scan.keyframes, &scan.sensor.response, &config, &Silent);
    let segment = segmentation::segment(&mesh, &scene, &association.lit_color, &association.lit_weight, &config);
    Outcome { truth, scan, association, segment }
}

/// RMS over keyframes of the log gains' error (mean over channels), after one factor.
fn exposure_error(outcome: &Outcome) -> f64 {
    let exposures = json(&outcome.truth.folder.join("truth/exposures.json"));
    let gains = exposures["gain"].as_array().expect("gain");
    let mut errors: Vec<f64> = outcome
        .association
        .views
        .iter()
        .zip(gains)
        .map(|(v, g)| {
            v.gain.iter().map(|x| libm::log(*x)).sum::<f64>() / 3.0 - libm::log(g.as_f64().expect("a number"))
        })
        .collect();
    let common = median(&errors);
    errors.iter_mut().for_each(|e| *e = (*e - common) * (*e - common));
    f64::sqrt(errors.iter().sum::<f64>() / errors.len() as f64)
}

/// Mean over keyframes of the median distance, in pixels, between vertices projected with these poses and the true ones.
fn pose_error(outcome: &Outcome, poses: &[Pose]) -> f64 {
    let truth = json(&outcome.truth.folder.join("truth/poses.json"));
    let frames = truth["frames"].as_array().expect("frames");
    let camera = outcome.scan.keyframes[0].camera.intrinsics;
    let project = |pose: &Pose, p: glam::DVec3| {
        let q = pose.inverse().transform(p);
        (q.z > 0.1).then(|| glam::DVec2::new(q.x / q.z * camera.fx, q.y / q.z * camera.fy))
    };
    let half = glam::DVec2::new(f64::from(camera.width), f64::from(camera.height)) / 2.0;
    let mut errors = Vec::new();
    for (pose, frame) in poses.iter().zip(frames) {
        let rows: [[f64; 4]; 4] =
            serde_json::from_value(frame["camera_to_world"].clone()).expect("a matrix of four by four");
        let right = Pose::from_rows(&rows).expect("a pose");
        let step = (outcome.truth.mesh.positions.len() / 3000).max(1);
        let distances: Vec<f64> = outcome
            .truth
            .mesh
            .positions
            .iter()
            .step_by(step)
            .filter_map(|p| Some((project(pose, p.as_dvec3())?, project(&right, p.as_dvec3())?)))
            .filter(|(_, b)| b.abs().cmplt(half).all())
            .map(|(a, b)| a.distance(b))
            .collect();
        errors.push(median(&distances));
    }
    errors.iter().sum::<f64>() / errors.len() as f64
}

fn check(name: &str) {
    let Some(shared) = tests::shared() else { return };
    let outcome = run(&shared, name);
    let poses: Vec<Pose> = outcome.association.views.iter().map(|v| v.world_from_camera).collect();
    let given: Vec<Pose> = outcome.scan.keyframes.iter().map(|k| k.world_from_camera).collect();
    let (exposure, pose, before) =
        (exposure_error(&outcome), pose_error(&outcome, &poses), pose_error(&outcome, &given));
    let seen: Vec<usize> = (0..outcome.truth.seen.len()).filter(|&i| outcome.truth.seen[i] >= 2).collect();
    let pick = |labels: &[u32]| seen.iter().map(|&i| labels[i]).collect::<Vec<u32>>();
    let ari = adjusted_rand_index(&pick(&outcome.truth.material), &pick(&outcome.segment));
    let covered = seen.iter().filter(|&&i| outcome.association.lit_weight[i] > 0.0).count();
    let covered = covered as f64 / seen.len() as f64;
    println!("{name}: exposure {exposure:.4}, pose {before:.2} -> {pose:.3} px, ARI {ari:.3}, covered {covered:.3}");
    assert!(before > 2.0, "the given poses are wrong");
    assert!(exposure <= 0.0075, "log RMS of exposures {exposure}");
    assert!(pose <= 0.3, "poses are off by {pose} px");
    assert!(ari >= 0.9, "ARI {ari}");
    assert!(covered >= 0.95, "{covered} of the vertices that two keyframes see have a colour");
}

#[test]
fn ball() {
    check("ball");
}

#[test]
fn bunny() {
    check("bunny");
}

#[test]
fn fruits() {
    check("fruits");
}
