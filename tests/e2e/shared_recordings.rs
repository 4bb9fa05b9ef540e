//! The main job on real Kinect recordings, where they are at hand.

#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::{arg, json, ok, shared};
use firmware_config::{EstimatorConfig, ExposureChoice, Switch};
use recordings::result::Estimate;
use recordings::scan::Scan;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Replays a recording with the given options; the published folder and its manifest.
fn replay(source: &Path, device: &Path, extra: &[&str]) -> (PathBuf, serde_json::Value) {
    let stdout = ok(&[&["replay", &arg(source), "--device", &arg(device)], extra].concat());
    let folder = PathBuf::from(stdout.lines().last().unwrap());
    let manifest = std::fs::read_to_string(folder.join("manifest.json")).unwrap();
    (folder, serde_json::from_str(&manifest).unwrap())
}

fn lines(folder: &Path) -> usize {
    std::fs::read_to_string(folder.join("trajectory.txt")).unwrap().lines().filter(|l| !l.starts_with('#')).count()
}

#[test]
fn a_desk_stays_tracked_and_within_memory() {
    let Some(shared) = shared() else { return };
    let device = tempfile::tempdir().unwrap();
    let (folder, manifest) = replay(&shared.join("data/tum_fr1_xyz_400"), device.path(), &["--rounds", "1"]);
    let stats = &manifest["capture"]["stats"];
    assert_eq!(stats["losses"], 0);
    assert_eq!(lines(&folder) as u64, stats["pairs"].as_u64().unwrap());
    for process in ["capture", "estimator"] {
        let peak = manifest[process]["memory_peak_bytes"].as_u64().unwrap() >> 20;
        assert!(peak <= 512, "{process}: {peak} MiB");
    }
    assert!(folder.join("preview.png").exists());
    let result = json(&["inspect", &arg(folder.join("result.lres")), "--json"]);
    assert!(result["vertices"].as_u64().unwrap() > 10_000, "{}", result["vertices"]);
    assert!(result["vertices"].as_u64().unwrap() < 84_000, "no more than the 80 000 asked for: {}", result["vertices"]);
    witnesses_gain_by_corrections(&folder);
}

/// Frames that no step used are predicted better than with exposure and pose correction off.
fn witnesses_gain_by_corrections(folder: &Path) {
    struct Silent;
    impl estimator::Progress for Silent {
        fn stage(&self, _: &'static str, _: f64) {}
    }
    let with = Estimate::read(&folder.join("result.lres")).unwrap();
    let scan = Scan::read(&folder.join("scan.lscan")).unwrap();
    let config = EstimatorConfig {
        exposure: ExposureChoice::None,
        refine_poses: Switch::Off,
        specular: Switch::Off,
        rays: 16,
        bands: 3,
        ..EstimatorConfig::default()
    };
    let options = estimator::Options { budget: Duration::from_secs(3600), rounds: Some(1) };
    let without = estimator::estimate(&scan, &config, &options, &Silent).unwrap();
    assert_eq!(with.witnesses.len(), 3);
    for (a, b) in with.witnesses.iter().zip(&without.witnesses) {
        println!("{}: {:.1} dB, {:.1} dB without corrections", a.name, a.lit_psnr_db, b.lit_psnr_db);
        assert!(a.lit_psnr_db > b.lit_psnr_db + 1.0, "{}: {} dB, {} dB", a.name, a.lit_psnr_db, b.lit_psnr_db);
    }
}

#[test]
fn a_kitchen_stays_tracked() {
    let Some(shared) = shared() else { return };
    let device = tempfile::tempdir().unwrap();
    let (folder, manifest) = replay(&shared.join("data/redkitchen_300"), device.path(), &["--no-estimate"]);
    let stats = &manifest["capture"]["stats"];
    assert_eq!((&stats["losses"], &stats["pairs"]), (&0.into(), &300.into()));
    assert_eq!(lines(&folder), 300);
}

/// The camera hardly moves: one keyframe is all there is, and the result says what cannot be known from it.
#[test]
fn a_standing_camera_ends_with_an_honest_result() {
    let Some(shared) = shared() else { return };
    let device = tempfile::tempdir().unwrap();
    let (folder, _) = replay(&shared.join("data/scenenn_31"), device.path(), &["--rounds", "1"]);
    let result = json(&["inspect", &arg(folder.join("result.lres")), "--json"]);
    assert_eq!(result["keyframes"], 1);
    let warnings = result["warnings"].to_string();
    assert!(warnings.contains("one keyframe"), "{warnings}");
}
