//! The live page in a browser: a scan on a simulated Kinect, driven from it. Skipped where Chromium or node's packages are not
//! installed; `.ci/run` installs them.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "these are tests")]

mod common;

use common::http::Served;
use common::{arg, fixture, text};
use recordings::recording::{Event, RecordingKind, RecordingReader, RecordingWriter};
use std::path::Path;
use std::process::Command;

/// The bundled recording with a hand before the lens for half a second.
fn covered_for_a_while(path: &Path) {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../recordings/data/tabletop.lrec");
    let mut reader = RecordingReader::open(&source).unwrap();
    let mut writer = RecordingWriter::create(path, RecordingKind::Frames, &reader.sensor().clone()).unwrap();
    let mut first = None;
    while let Some(mut event) = reader.next_event().unwrap() {
        let t = event.timestamp_ns() - *first.get_or_insert(event.timestamp_ns());
        let covered = (2_500_000_000..3_300_000_000).contains(&t);
        if let (Event::Depth(depth), true) = (&mut event, covered) {
            depth.depth.fill(0);
        }
        writer.write(&event).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn a_scan_is_driven_from_a_phone() {
    let chromium = std::env::var("CHROMIUM").unwrap_or_else(|_| "/usr/bin/chromium".into());
    let playwright = Command::new("node").args(["-e", "require.resolve('playwright-core')"]).output();
    if !Path::new(&chromium).exists() || !playwright.is_ok_and(|o| o.status.success()) {
        eprintln!("skipped: Chromium or the npm package playwright-core is not there (CHROMIUM, NODE_PATH)");
        return;
    }
    let folder = fixture("live_page");
    let recording = folder.join("covered.lrec");
    covered_for_a_while(&recording);
    let (device, recording) = (arg(folder.join("device")), arg(&recording));
    let fixed = ["capture", "--device", &device, "--simulate", &recording, "--serve", "127.0.0.1:0"];
    let settings =
        ["daemon.min_free_mb=1", "fusion.voxel_size_m=0.01", "fusion.fine_blocks=0", "estimator.quality=draft"];
    let settings = settings.iter().flat_map(|s| ["--set", s]);
    let s = Served::start(&folder, &fixed.into_iter().chain(settings).collect::<Vec<_>>());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/foreign/live.cjs");
    let url = format!("http://{}/?code={}", s.host, s.code);
    let output = Command::new("node").arg(script).args([&url, &arg(&folder)]).output().unwrap();
    let report = format!("{}{}", text(&output.stdout), text(&output.stderr));
    assert!(output.status.success(), "{report}\n{}", s.log());
    eprintln!("{report}");
    s.signal("-TERM");
    assert_eq!(s.ended().0, Some(0));
}
