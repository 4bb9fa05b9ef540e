//! Errors of the estimator on scenes with known truth, as a Markdown table. Needs `LUMISCAN_SHARED`.
//!
//!     cargo run --release -p tests --example accuracy

#![allow(clippy::expect_used, reason = "whatever is wrong with a fixture is to end the program")]

use estimator::Options;
use firmware_config::EstimatorConfig;
use recordings::import::photos::import_photos;
use std::time::Duration;
use tests::evaluation::{Figures, evaluate};
use tests::truth::Truth;

fn figures(name: &str) -> (usize, Figures) {
    let truth = Truth::read(&tests::shared(), name);
    let scan = import_photos(&truth.folder, None).expect("a scan");
    let options = Options { budget: Duration::from_secs(3600), rounds: Some(2), reference: None, memory_mb: None };
    let found = estimator::estimate(&scan, &EstimatorConfig::default(), &options, &()).expect("an answer");
    (truth.mesh.positions.len(), evaluate(&truth, &scan, &found))
}

fn main() {
    let names = ["ball", "bunny", "fruits"];
    let all = names.map(figures);
    let row = |head: &str, cell: &dyn Fn(&Figures) -> String| {
        println!("| {head} | {} |", all.each_ref().map(|(_, f)| cell(f)).join(" | "));
    };
    let heads: Vec<String> = names.iter().zip(&all).map(|(name, (n, _))| format!("{name}, {n} vertices")).collect();
    println!("| | {} |\n|---|{}", heads.join(" | "), "---|".repeat(names.len()));
    row("exposure, log RMS", &|f| format!("{:.4}", f.exposure));
    row("poses, px: as given → refined", &|f| format!("{:.1} → {:.2}", f.given_pose_px, f.pose_px));
    row("albedo, relative error: median / p90", &|f| format!("{:.4} / {:.3}", f.albedo.median, f.albedo.p90));
    row("albedo, log standard deviation within a material", &|f| format!("{:.3}", f.albedo.within));
    row("irradiance, relative error: median / p90", &|f| format!("{:.3} / {:.3}", f.irradiance.0, f.irradiance.1));
    row("segments, adjusted Rand index", &|f| format!("{:.3}", f.ari));
    row("gloss of segments, area under the ROC curve", &|f| f.auc.map_or("–".into(), |a| format!("{a:.2}")));
}
