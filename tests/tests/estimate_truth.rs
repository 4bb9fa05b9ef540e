//! The estimator from mesh, posed pictures and their erroneous poses alone, against scenes whose light and materials are
//! known. The bounds are those that a release must hold; the figures that are printed are what it reaches.

// Test code: whatever is wrong with a fixture is to end the test.
#![allow(clippy::expect_used)]

use estimator::Options;
use firmware_config::EstimatorConfig;
use recordings::import::photos::import_photos;
use std::time::Duration;
use tests::metrics;
use tests::truth::Truth;

/// Vertices a segment has at least to count in the area under the curve.
const LEAST_SEGMENT: usize = 20;

fn check(name: &str) {
    let Some(shared) = tests::shared() else { return };
    let truth = Truth::read(&shared, name);
    let scan = import_photos(&truth.folder, None).expect("a scan");
    let options = Options { budget: Duration::from_secs(600), rounds: Some(2) };
    let found = estimator::estimate(&scan, &EstimatorConfig::default(), &options, &()).expect("an answer");

    let seen: Vec<usize> = (0..truth.seen.len()).filter(|&i| truth.seen[i] >= 2).collect();
    let albedo: Vec<[f64; 3]> = found.albedo.iter().map(|a| a.to_array().map(f64::from)).collect();
    let albedo = metrics::albedo(&albedo, &truth.albedo, &truth.material, |i| truth.seen[i] >= 2);
    let pick = |labels: &[u32]| seen.iter().map(|&i| labels[i]).collect::<Vec<u32>>();
    let ari = metrics::adjusted_rand_index(&pick(&truth.material), &pick(&found.segment));
    let (median, p90) = metrics::scene_irradiance(&truth.transfer().gi, &found.light.coefficients, &truth.light);
    // A segment is glossy if most of its vertices are.
    let labels = &found.segment;
    let of = |s: usize| seen.iter().filter(move |&&i| labels[i] as usize == s);
    let judged: Vec<usize> = (0..found.segments.len()).filter(|&s| of(s).count() >= LEAST_SEGMENT).collect();
    let glossy = |&s: &usize| 2 * of(s).filter(|&&i| truth.glossy[truth.material[i] as usize]).count() > of(s).count();
    let gloss: Vec<bool> = judged.iter().map(glossy).collect();
    let scores: Vec<f64> = judged.iter().map(|&s| found.segments[s].w_s).collect();
    let auc = metrics::area_under_curve(&scores, &gloss);
    println!("{name}: albedo {albedo:.4?}, ARI {ari:.3}, scene irradiance {median:.4} / {p90:.4}, AUC {auc:.3?}");

    assert!(albedo.median <= 0.06 && albedo.p90 <= 0.22, "{name}: {albedo:?}");
    assert!(albedo.within <= 0.10, "{name}: shading left in the albedo: {albedo:?}");
    assert!(ari >= 0.90, "{name}: ARI {ari}");
    // What the true light cut at l ≤ 4 leaves, and what a release may add.
    let (true_median, true_p90) = match name {
        "ball" => (0.009, 0.045),
        "bunny" => (0.028, 0.163),
        _ => (0.016, 0.099),
    };
    assert!(median <= true_median + 0.03 && p90 <= true_p90 + 0.15, "{name}: scene irradiance {median} / {p90}");
    assert!(auc.is_none_or(|a| a >= 0.95), "{name}: AUC {auc:?}");
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
