//! The live page in a browser: a scan on a simulated Kinect, driven from it. Skipped where Chromium or node's packages are not
//! installed; `.ci/run` installs them.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "these are tests")]

mod common;

use common::http::Served;
use common::{arg, fixture, text};
use recordings::recording::{Event, RecordingKind, RecordingReader, RecordingWriter};
use recordings::types::{ColorFrame, DepthFrame};
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};

/// When a hand comes before the lens, for how long, and the time between the frames of that.
const COVERED_AT_NS: i64 = 2_500_000_000;
const COVERED_NS: i64 = 2_000_000_000;
const PERIOD_NS: i64 = 33_333_333;

/// The bundled recording, interrupted by a hand before the lens.
fn covered_for_a_while(path: &Path) {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../recordings/data/tabletop.lrec");
    let mut reader = RecordingReader::open(&source).unwrap();
    let mut writer = RecordingWriter::create(path, RecordingKind::Frames, &reader.sensor().clone()).unwrap();
    let (mut first, mut color, mut depth) = (None, None, None);
    let mut shift = 0;
    while let Some(event) = reader.next_event().unwrap() {
        let t = event.timestamp_ns();
        if shift == 0 && t - *first.get_or_insert(t) >= COVERED_AT_NS {
            let (Some(Event::Color(color)), Some(Event::Depth(depth))) = (&color, &depth) else { continue };
            for k in 0..COVERED_NS / PERIOD_NS {
                let t = t + k * PERIOD_NS;
                let empty = vec![0; depth.depth.len()];
                writer.write(&Event::Depth(DepthFrame { timestamp_ns: t, depth: empty, ..depth.clone() })).unwrap();
                writer.write(&Event::Color(ColorFrame { timestamp_ns: t, ..color.clone() })).unwrap();
            }
            shift = COVERED_NS;
        }
        let mut event = event;
        match &mut event {
            Event::Color(c) => c.timestamp_ns += shift,
            Event::Depth(d) => d.timestamp_ns += shift,
            Event::Accelerometer(a) => a.timestamp_ns += shift,
            Event::Packet(_) => {}
        }
        writer.write(&event).unwrap();
        match event {
            Event::Color(_) => color = Some(event),
            Event::Depth(_) => depth = Some(event),
            _ => {}
        }
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
    // On a simulated clock no frame is lost, however busy the machine is.
    let (device, plan) = (arg(folder.join("device")), format!("{},fast", arg(&recording)));
    let fixed = ["capture", "--device", &device, "--simulate", &plan, "--serve", "127.0.0.1:0"];
    let settings = [
        "daemon.min_free_mb=1",
        "daemon.max_scan_s=3600",
        "fusion.voxel_size_m=0.01",
        "fusion.fine_blocks=0",
        "estimator.quality=draft",
    ];
    let settings = settings.iter().flat_map(|s| ["--set", s]);
    let s = Served::start(&folder, &fixed.into_iter().chain(settings).collect::<Vec<_>>());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/foreign/live.cjs");
    let url = format!("http://{}/?code={}", s.host, s.code);
    // Meanwhile another client takes a kilobyte a second.
    let over = AtomicBool::new(false);
    let output = std::thread::scope(|scope| {
        scope.spawn(|| s.read_slowly("/api/live.mjpeg", &over));
        let output = Command::new("node").arg(script).args([&url, &arg(&folder)]).output();
        over.store(true, Ordering::Relaxed);
        output.unwrap()
    });
    let report = format!("{}{}", text(&output.stdout), text(&output.stderr));
    assert!(output.status.success(), "{report}\n{}", s.log());
    eprintln!("{report}");
    s.signal("-TERM");
    assert_eq!(s.ended().0, Some(0));
}
