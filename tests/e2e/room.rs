//! Full-size rooms through the executable: memory stays what was planned, however long the scan.

#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::{arg, ok};
use recordings::recording::{Event, RecordingKind, RecordingWriter};
use std::path::Path;
use tests::synth::{kinect::Kinect, render::Shading, scenes};

/// Peak resident memory of the capture process at most.
const MOST_MIB: f64 = 384.0;

/// The capture's part of the manifest of a replay without estimate.
fn replay(source: &Path, extra: &[&str]) -> serde_json::Value {
    let device = tempfile::tempdir().unwrap();
    let base = ["replay", &arg(source), "--device", &arg(device.path()), "--no-estimate", "--json"].map(String::from);
    let args: Vec<String> = base.into_iter().chain(extra.iter().map(|a| (*a).to_owned())).collect();
    let report: serde_json::Value = serde_json::from_str(&ok(&args)).unwrap();
    report["manifest"]["capture"].clone()
}

fn peak_mib(capture: &serde_json::Value) -> f64 {
    capture["memory_peak_bytes"].as_f64().unwrap() / f64::from(1 << 20)
}

/// Frames of the tour of a room, ten a second.
const FRAMES: u32 = 150;

/// A recording of a tour of a room of 5 × 4 × 2.5 m.
fn write_room(path: &Path) {
    let (scene, mut kinect) = (scenes::room(), Kinect::new(2, 7, 2));
    // One sample at one moment of the shutter is enough for a tracker.
    (kinect.samples, kinect.period_ns) = (1, 100_000_000);
    let mut writer = RecordingWriter::create(path, RecordingKind::Frames, &kinect.sensor()).unwrap();
    for i in 0..FRAMES {
        let tour = |t: f64| scenes::room_tour(t, f64::from(FRAMES) * 0.1);
        let frame = kinect.frame(&scene, Shading::Flat, i, &tour).into_rgbd();
        writer.write(&Event::Color(frame.color)).unwrap();
        writer.write(&Event::Depth(frame.depth)).unwrap();
    }
    writer.finish().unwrap();
}

/// Replays it: at 5 mm it does not fit the pool, so the volume is coarsened, that is reported, and the scan ends well.
fn assert_room(extra: &[&str], frames: std::ops::RangeInclusive<u64>) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("room.lrec");
    write_room(&path);
    let capture = replay(&path, extra);
    let stats = &capture["stats"];
    println!("room: peak {:.0} MiB, {stats}", peak_mib(&capture));
    assert!(frames.contains(&stats["pairs"].as_u64().unwrap()), "{stats}");
    assert_eq!((&stats["losses"], &stats["tracked_pairs"]), (&0.into(), &stats["pairs"]));
    assert!(stats["coarsenings"].as_u64().unwrap() >= 1, "it fitted: {stats}");
    assert!(stats["voxel_size_m"].as_f64().unwrap() > 0.009);
    assert_eq!(stats["blocks_refused"], 0);
    assert!(capture["vertices"].as_u64().unwrap() > 50_000);
    assert!(peak_mib(&capture) <= MOST_MIB, "{} MiB", peak_mib(&capture));
}

#[test]
fn a_full_size_room_ends_within_the_default_pool() {
    assert_room(&[], 150..=150);
}

/// To and fro for five minutes.
#[test]
#[ignore = "minutes"]
fn a_room_scanned_for_five_minutes_ends_within_the_default_pool() {
    assert_room(&["--loop", "20"], 2900..=3000);
}
