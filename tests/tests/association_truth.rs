//! Data association and segmentation against scenes whose poses, exposures and materials are known.

// Test code: whatever is wrong with a fixture is to end the test.
#![allow(clippy::expect_used)]

use estimator::Options;
use estimator::association::{Association, associate};
use estimator::estimate;
use estimator::mesh::regularise;
use estimator::rays::RayScene;
use estimator::segmentation;
use firmware_config::{EstimatorConfig, ExposureChoice, Switch};
use glam::Vec3;
use recordings::decision::Decision;
use recordings::import::photos::import_photos;
use recordings::scan::Scan;
use recordings::types::Pose;
use std::path::Path;
use std::time::Duration;
use tests::metrics::{adjusted_rand_index, median};
use tests::truth::{Truth, json};

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
    let mesh = regularise::regularise(&scan.mesh, &config, scan.source);
    assert_eq!(mesh.positions, truth.mesh.positions, "an imported mesh keeps its vertices");
    let scene = RayScene::new(&mesh);
    let association = associate(&mesh, &scene, &scan.keyframes, &scan.sensor.response, &config, &());
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

/// How much of the true steps of colour between neighbours is left in colours of any exposure, over the steepest
/// twentieth of the steps: 1 = all, 0 = a blur.
fn sharpness(truth: &Truth, color: &[Vec3], weight: &[f32]) -> f64 {
    let level = |c: Vec3| libm::log(f64::from(c.element_sum()).max(1e-3));
    let real = |i: u32| level(Vec3::from_array(truth.lit_color[i as usize].map(|x| x as f32)));
    let sides = truth.mesh.triangles.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]);
    let known = |i: u32| weight[i as usize] > 0.0 && truth.seen[i as usize] >= 2;
    let mut steps: Vec<[f64; 2]> = sides
        .filter(|&(a, b)| known(a) && known(b))
        .map(|(a, b)| [real(b) - real(a), level(color[b as usize]) - level(color[a as usize])])
        .collect();
    steps.sort_by(|a, b| b[0].abs().total_cmp(&a[0].abs()));
    let steep = &steps[..steps.len() / 20];
    steep.iter().map(|s| s[0] * s[1]).sum::<f64>() / steep.iter().map(|s| s[0] * s[0]).sum::<f64>()
}

/// The paper's Fig. 3: colours fused as they come, frame by frame from the given poses, are a blur beside what
/// association makes of the same pictures.
#[test]
fn associated_colours_are_sharper_than_fused_ones() {
    let Some(shared) = tests::shared() else { return };
    let outcome = run(&shared, "bunny");
    let sharp = sharpness(&outcome.truth, &outcome.association.lit_color, &outcome.association.lit_weight);
    let config = EstimatorConfig { refine_poses: Switch::Off, exposure: ExposureChoice::None, ..Default::default() };
    let scene = RayScene::new(&outcome.truth.mesh);
    let (keyframes, response) = (&outcome.scan.keyframes, &outcome.scan.sensor.response);
    let given = associate(&outcome.truth.mesh, &scene, keyframes, response, &config, &());
    let mut fused = vec![(Vec3::ZERO, 0.0); outcome.truth.mesh.positions.len()];
    for o in &given.observations {
        let (sum, weight) = &mut fused[o.vertex as usize];
        *sum += o.weight * Vec3::from_array(o.color);
        *weight += o.weight;
    }
    let (colors, weights): (Vec<Vec3>, Vec<f32>) = fused.into_iter().map(|(s, w)| (s / f32::max(w, 1e-9), w)).unzip();
    let blurred = sharpness(&outcome.truth, &colors, &weights);
    println!("share of the true steps of colour: associated {sharp:.3}, fused {blurred:.3}");
    assert!(sharp > 1.2 * blurred, "associated {sharp}, fused {blurred}");
}

/// A frame that no step used is predicted from the pose its picture tells, and better so than without corrections.
#[test]
fn a_witness_is_predicted_better_with_exposure_and_pose() {
    let Some(shared) = tests::shared() else { return };
    let mut scan = import_photos(&shared.join("truth/ball"), None).expect("a scan");
    scan.witnesses = vec![scan.keyframes.remove(5)];
    let predicted = |refine_poses, exposure| {
        let config = EstimatorConfig { refine_poses, exposure, rays: 32, bands: 3, ..Default::default() };
        let options = Options { budget: Duration::from_secs(3600), rounds: None };
        let result = estimate(&scan, &config, &options, &()).expect("a result");
        assert!(
            result.decisions.iter().any(|d| matches!(d, Decision::Witnesses { frames: 1, .. })),
            "what limits them is said"
        );
        (result.witnesses[0].lit_psnr_db, result.witnesses[0].model_psnr_db)
    };
    let with = predicted(Switch::Auto, ExposureChoice::Auto);
    let without = predicted(Switch::Off, ExposureChoice::None);
    println!("lit colours and model: {with:.1?} dB, {without:.1?} dB without corrections");
    assert!(with.0 > without.0 + 3.0 && with.1 > without.1 + 1.0, "{with:?} dB, {without:?} dB without corrections");
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
