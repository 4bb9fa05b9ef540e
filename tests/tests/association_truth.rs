//! What data association gains: sharper colours, and better prediction of frames that no step used.
//! Its accuracy is asserted in `estimate_truth.rs`.

// Test code: whatever is wrong with a fixture is to end the test.
#![allow(clippy::expect_used)]

use estimator::Options;
use estimator::association::{Association, AssociationContext, associate};
use estimator::estimate;
use estimator::rays::RayScene;
use firmware_config::{EstimatorConfig, ExposureChoice, Switch};
use glam::Vec3;
use recordings::decision::Decision;
use recordings::import::photos::import_photos;
use std::time::Duration;
use tests::truth::Truth;

fn associated(name: &str, config: &EstimatorConfig) -> (Truth, Association) {
    let truth = Truth::read(&tests::shared(), name);
    let scan = import_photos(&truth.folder, None).expect("a scan");
    let scene = RayScene::new(&truth.mesh);
    let association = associate(
        &mut AssociationContext::new(&truth.mesh, &scene, &scan.sensor.response, config),
        &scan.keyframes,
        &(),
    );
    (truth, association)
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
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: the scenes of truth/")]
fn associated_colours_are_sharper_than_fused_ones() {
    let (truth, ours) = associated("bunny", &EstimatorConfig::default());
    let sharp = sharpness(&truth, &ours.lit_color, &ours.lit_weight);
    let config = EstimatorConfig { refine_poses: Switch::Off, exposure: ExposureChoice::None, ..Default::default() };
    let (_, given) = associated("bunny", &config);
    let mut fused = vec![(Vec3::ZERO, 0.0); truth.mesh.positions.len()];
    for o in &given.observations {
        let (sum, weight) = &mut fused[o.vertex as usize];
        *sum += o.weight * Vec3::from_array(o.color);
        *weight += o.weight;
    }
    let (colors, weights): (Vec<Vec3>, Vec<f32>) = fused.into_iter().map(|(s, w)| (s / f32::max(w, 1e-9), w)).unzip();
    let blurred = sharpness(&truth, &colors, &weights);
    println!("share of the true steps of colour: associated {sharp:.3}, fused {blurred:.3}");
    assert!(sharp > 1.2 * blurred, "associated {sharp}, fused {blurred}");
}

/// A frame that no step used is predicted from the pose that its picture gives, better than without corrections.
#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: the scenes of truth/")]
fn a_validation_frame_is_predicted_better_with_exposure_and_pose() {
    let shared = tests::shared();
    let mut scan = import_photos(&shared.join("truth/ball"), None).expect("a scan");
    scan.witnesses = vec![scan.keyframes.remove(5)];
    let predicted = |refine_poses, exposure| {
        let config = EstimatorConfig { refine_poses, exposure, rays: 32, bands: 3, ..Default::default() };
        let options = Options { budget: Duration::from_secs(3600), rounds: None, reference: None, memory_mb: None };
        let result = estimate(&scan, &config, &options, &()).expect("a result");
        assert!(
            result.decisions.iter().any(|d| matches!(d, Decision::Witnesses { frames: 1, .. })),
            "the result says what limits them"
        );
        (result.witnesses[0].lit_psnr_db, result.witnesses[0].model_psnr_db)
    };
    let with = predicted(Switch::Auto, ExposureChoice::Auto);
    let without = predicted(Switch::Off, ExposureChoice::None);
    println!("lit colours and model: {with:.1?} dB, {without:.1?} dB without corrections");
    assert!(with.0 > without.0 + 3.0 && with.1 > without.1 + 1.0, "{with:?} dB, {without:?} dB without corrections");
}
