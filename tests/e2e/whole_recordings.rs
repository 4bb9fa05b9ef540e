//! The main job on whole recordings: the bundled table, and real Kinect recordings where they are at hand. Each is
//! replayed and estimated once, and all tests read that result.

#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::{arg, fixture, json, ok};
use firmware_config::{EstimatorConfig, ExposureChoice, Switch};
use recordings::result::Estimate;
use recordings::scan::Scan;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Duration;
use tests::digests::{self, assert_unchanged};
use tests::shared;

/// Upper bound of the capture process's peak resident memory.
const MAX_MIB: f64 = 384.0;

/// A published scan.
struct Published {
    folder: PathBuf,
    manifest: serde_json::Value,
}

impl Published {
    /// Replays a recording with the given options into the fixture folder `name`.
    fn new(name: &str, source: &Path, extra: &[&str]) -> Self {
        let stdout = ok(&[&["replay", &arg(source), "--device", &arg(fixture(name))], extra].concat());
        let folder = PathBuf::from(stdout.lines().last().unwrap());
        let manifest = std::fs::read_to_string(folder.join("manifest.json")).unwrap();
        Self { folder, manifest: serde_json::from_str(&manifest).unwrap() }
    }

    fn poses(&self) -> usize {
        let text = std::fs::read_to_string(self.folder.join("trajectory.txt")).unwrap();
        text.lines().filter(|l| !l.starts_with('#')).count()
    }

    /// Counters of the capture process.
    fn stats(&self) -> &serde_json::Value {
        &self.manifest["capture"]["stats"]
    }

    fn peak_mib(&self, process: &str) -> f64 {
        self.manifest[process]["memory_peak_bytes"].as_f64().unwrap() / f64::from(1 << 20)
    }

    fn inspect(&self) -> serde_json::Value {
        json(&["inspect", &arg(self.folder.join("result.lres")), "--json"])
    }

    /// Asserts that scan and result are those whose checksums are committed.
    fn assert_unchanged(&self, name: &str) {
        let mut found = digests::of_result(&self.folder.join("result.lres"));
        found.extend(digests::of_file("scan", &self.folder.join("scan.lscan")));
        assert_unchanged(name, &found);
    }

    /// Asserts that three times forward and backward take the memory and give the surface of once, but for what three
    /// times the poses take.
    fn assert_flat(&self, name: &str, source: &Path) {
        let again = |name: String| Self::new(&name, source, &["--loop", "3", "--no-estimate"]);
        let thrice = again(format!("{name}_thrice"));
        let (a, mut b) = (self.peak_mib("capture"), thrice.peak_mib("capture"));
        // Beside a twentieth, what the allocator keeps from run to run.
        let most = 1.05 * a + 2.0;
        if b > most {
            // By chance, as threads and allocator have it, or since memory grows: then it does in every run.
            b = b.min(again(format!("{name}_thrice_again")).peak_mib("capture"));
        }
        let count = |p: &Self| {
            let (vertices, blocks) = (&p.manifest["capture"]["vertices"], &p.stats()["blocks_used"]);
            (vertices.as_f64().unwrap(), blocks.as_f64().unwrap())
        };
        let ((va, ba), (vb, bb)) = (count(self), count(&thrice));
        println!("{name}: once {a:.1} MiB, {va} vertices, {ba} blocks; thrice {b:.1} MiB, {vb}, {bb}");
        assert!(thrice.stats()["pairs"].as_u64().unwrap() > 2 * self.stats()["pairs"].as_u64().unwrap());
        assert!(vb < 1.1 * va && bb < 1.1 * ba, "the surface grows");
        assert!(b <= most, "{a:.1} MiB became {b:.1} MiB");
        assert!(b <= MAX_MIB, "{b:.1} MiB");
    }
}

fn table_recording() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../recordings/data/tabletop.lrec")
}

/// The bundled recording, estimated with two rounds.
fn table() -> &'static Published {
    static TABLE: OnceLock<Published> = OnceLock::new();
    TABLE.get_or_init(|| Published::new("tabletop", &table_recording(), &["--rounds", "2"]))
}

fn desk_recording() -> PathBuf {
    shared().join("data/tum_fr1_xyz_400")
}

/// A real desk before a far wall, estimated with two rounds.
fn desk() -> &'static Published {
    static DESK: OnceLock<Published> = OnceLock::new();
    DESK.get_or_init(|| Published::new("desk", &desk_recording(), &["--rounds", "2"]))
}

#[test]
fn the_table_gives_the_committed_result() {
    table().assert_unchanged("tabletop");
}

#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: data/tum_fr1_xyz_400")]
fn a_desk_gives_the_committed_result() {
    desk().assert_unchanged("tum_fr1_xyz_400");
}

#[test]
fn a_scan_three_times_as_long_takes_no_more_memory() {
    table().assert_flat("tabletop", &table_recording());
}

/// Rare readings of the far wall must not add up to surface as the scan goes on.
#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: data/tum_fr1_xyz_400")]
fn a_real_scan_three_times_as_long_takes_no_more_memory() {
    desk().assert_flat("desk", &desk_recording());
}

#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: data/tum_fr1_xyz_400")]
fn a_desk_stays_tracked_and_within_memory() {
    let stats = desk().stats();
    assert_eq!(stats["losses"], 0);
    assert_eq!(desk().poses() as u64, stats["pairs"].as_u64().unwrap());
    for process in ["capture", "estimator"] {
        let peak = desk().peak_mib(process);
        assert!(peak <= 512.0, "{process}: {peak:.1} MiB");
    }
    assert!(desk().folder.join("preview.png").exists());
    let vertices = desk().inspect()["vertices"].as_u64().unwrap();
    assert!((10_000..59_000).contains(&vertices), "{vertices}: about as many as the 56 000 asked for");
}

/// Frames that no step used are predicted better than with exposure and pose correction off.
#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: data/tum_fr1_xyz_400")]
fn validation_frames_gain_by_corrections() {
    let with = Estimate::read(&desk().folder.join("result.lres")).unwrap();
    let scan = Scan::read(&desk().folder.join("scan.lscan")).unwrap();
    let config = EstimatorConfig {
        exposure: ExposureChoice::None,
        refine_poses: Switch::Off,
        specular: Switch::Off,
        rays: 16,
        bands: 3,
        ..EstimatorConfig::default()
    };
    let options =
        estimator::Options { budget: Duration::from_secs(3600), rounds: Some(1), reference: None, memory_mb: None };
    let without = estimator::estimate(&scan, &config, &options, &()).unwrap();
    assert_eq!(with.witnesses.len(), 3);
    for (a, b) in with.witnesses.iter().zip(&without.witnesses) {
        println!("{}: {:.1} dB, {:.1} dB without corrections", a.name, a.lit_psnr_db, b.lit_psnr_db);
        assert!(a.lit_psnr_db > b.lit_psnr_db + 1.0, "{}: {} dB, {} dB", a.name, a.lit_psnr_db, b.lit_psnr_db);
    }
}

#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: data/redkitchen_300")]
fn a_kitchen_stays_tracked() {
    let kitchen = Published::new("kitchen", &shared().join("data/redkitchen_300"), &["--no-estimate"]);
    assert_eq!((&kitchen.stats()["losses"], &kitchen.stats()["pairs"]), (&0.into(), &300.into()));
    assert_eq!(kitchen.poses(), 300);
}

/// The camera hardly moves: one keyframe is all there is, and the result says what cannot be known from it.
#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: data/scenenn_31")]
fn a_standing_camera_ends_with_an_honest_result() {
    let result = Published::new("corner", &shared().join("data/scenenn_31"), &["--rounds", "1"]).inspect();
    assert_eq!(result["keyframes"], 1);
    let warnings = result["warning_values"].as_array().expect("a list");
    assert!(warnings.iter().any(|w| w == "one_keyframe"), "{warnings:?}");
}
