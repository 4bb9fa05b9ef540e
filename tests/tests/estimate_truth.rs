//! The estimator from mesh, posed pictures and their erroneous poses alone, against scenes whose poses, exposures, light
//! and materials are known. Each scene has its own bounds, at 1.3 times the errors that are reached and printed.

// Test code: whatever is wrong with a fixture is to end the test.
#![allow(clippy::expect_used)]

use estimator::Options;
use firmware_config::EstimatorConfig;
use recordings::import::photos::import_photos;
use recordings::result::Estimate;
use std::time::Duration;
use tests::digests;
use tests::evaluation::{Figures, evaluate};
use tests::metrics::AlbedoError;
use tests::truth::Truth;

/// Upper bound of the size of a result file, connectivity included, its texture left out.
const MAX_BYTES_PER_VERTEX: f64 = 24.0;

/// Estimates `truth/<name>`. The bounds are upper ones for errors; lower ones for `given_pose_px`, `covered`, `ari` and `auc`.
fn check(name: &str, bounds: &Figures) {
    let truth = Truth::read(&tests::shared(), name);
    let scan = import_photos(&truth.folder, None).expect("a scan");
    let options = Options { budget: Duration::from_secs(600), rounds: Some(2), reference: None, memory_mb: None };
    let found = estimator::estimate(&scan, &EstimatorConfig::default(), &options, &()).expect("an answer");
    let figures = evaluate(&truth, &scan, &found);
    println!("{name}: {figures:.5?}");

    // The texture is a picture: its size depends on what is printed on the surface.
    let file = tempfile::NamedTempFile::new().expect("a file");
    Estimate { texture: None, ..found }.write(file.path()).expect("a result file");
    let bytes = file.path().metadata().expect("a file").len() as f64 / truth.mesh.positions.len() as f64;
    println!("{name}: {bytes:.1} bytes a vertex");
    assert!(bytes <= MAX_BYTES_PER_VERTEX, "{name}: {bytes} bytes a vertex");

    assert!(figures.given_pose_px > bounds.given_pose_px, "{name}: poses are given with errors");
    let errors = |f: &Figures| {
        [
            ("exposure", f.exposure),
            ("pose_px", f.pose_px),
            ("not covered", 1.0 - f.covered),
            ("albedo, median", f.albedo.median),
            ("albedo, p90", f.albedo.p90),
            ("shading left in the albedo", f.albedo.within),
            ("irradiance, median", f.irradiance.0),
            ("irradiance, p90", f.irradiance.1),
            ("1 - ARI", 1.0 - f.ari),
            ("1 - AUC", 1.0 - f.auc.unwrap_or(1.0)),
        ]
    };
    for ((what, error), (_, bound)) in errors(&figures).into_iter().zip(errors(bounds)) {
        assert!(error <= bound, "{name}: {what} {error}, at most {bound}");
    }
    assert_eq!(figures.auc.is_some(), bounds.auc.is_some(), "{name}: AUC {:?}", figures.auc);
    digests::assert_unchanged(name, &digests::of_result(file.path()));
}

#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: truth/ball")]
fn ball() {
    check(
        "ball",
        &Figures {
            exposure: 0.00038,
            given_pose_px: 2.0,
            pose_px: 0.06,
            covered: 0.9517,
            albedo: AlbedoError { median: 0.00068, p90: 0.0396, within: 0.0042 },
            irradiance: (0.0050, 0.075),
            ari: 0.972,
            auc: None,
        },
    );
}

#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: truth/bunny")]
fn bunny() {
    check(
        "bunny",
        &Figures {
            exposure: 0.0075,
            given_pose_px: 2.0,
            pose_px: 0.182,
            covered: 0.9726,
            albedo: AlbedoError { median: 0.0280, p90: 0.0900, within: 0.0319 },
            irradiance: (0.0193, 0.111),
            ari: 0.92,
            auc: Some(1.0),
        },
    );
}

#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: truth/fruits")]
fn fruits() {
    check(
        "fruits",
        &Figures {
            exposure: 0.0038,
            given_pose_px: 2.0,
            pose_px: 0.134,
            covered: 0.9767,
            albedo: AlbedoError { median: 0.0270, p90: 0.22, within: 0.0546 },
            irradiance: (0.0160, 0.114),
            ari: 0.965,
            auc: Some(1.0),
        },
    );
}
