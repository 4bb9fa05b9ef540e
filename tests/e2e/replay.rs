//! `replay` from a source to a published scan: what appears, what stays the same, what happens when it is interrupted.

#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::{EXECUTABLE, arg, child_of, json, ok, scans, text, tum_folder};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const FRAMES: usize = 24;
/// Enough for these small pictures.
const COARSE: [&str; 2] = ["--set", "fusion.voxel_size_m=0.01"];

/// Replays the synthetic table and returns the published folder.
fn replay(source: &Path, device: &Path, extra: &[&str]) -> PathBuf {
    let (source, device) = (arg(source), arg(device));
    let stdout = ok(&[&["replay", &source, "--device", &device], &COARSE[..], extra].concat());
    PathBuf::from(stdout.lines().last().unwrap())
}

fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap());
    entries.map(|e| (text(e.file_name().as_encoded_bytes()), std::fs::read(e.path()).unwrap())).collect()
}

fn stamps(folder: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(folder.join("trajectory.txt")).unwrap();
    let lines = text.lines().filter(|l| !l.starts_with('#'));
    lines.map(|l| l.split(' ').next().unwrap().to_owned()).collect()
}

#[test]
fn a_published_scan_is_complete_and_says_what_is_in_it() {
    let dir = tempfile::tempdir().unwrap();
    let (source, device) = (dir.path().join("table"), dir.path().join("device"));
    tum_folder(&source, FRAMES);
    let folder = replay(&source, &device, &["--rounds", "1"]);
    assert_eq!(folder.parent(), Some(device.join("scans").as_path()));
    let id = folder.file_name().unwrap().to_str().unwrap();
    assert!(id.len() == "20261121T110534Z-table".len() && id.ends_with("Z-table"), "{id}");
    assert_eq!(scans(&device), [id], "nothing else, no staging folder either");

    let found = files(&folder);
    let names: Vec<&str> = found.keys().map(String::as_str).collect();
    assert_eq!(names, ["manifest.json", "preview.png", "result.lres", "scan.lscan", "trajectory.txt", "viewer.html"]);
    let manifest: serde_json::Value = serde_json::from_slice(&found["manifest.json"]).unwrap();
    let listed = manifest["files"].as_array().unwrap();
    assert_eq!(listed.len(), 5, "every file but the manifest itself");
    for file in listed {
        let bytes = &found[file["name"].as_str().unwrap()];
        assert_eq!(file["bytes"], bytes.len());
        assert_eq!(file["crc32"], format!("{:08x}", crc32fast::hash(bytes)));
    }
    assert_eq!(manifest["estimator"]["outcome"], "done");
    let after = |moment: &str| manifest["after_last_frame_s"][moment].as_f64().unwrap();
    assert!(0.0 < after("result") && after("result") < after("published"), "{manifest}");
    assert!(!manifest["estimator"]["decisions"].as_array().unwrap().is_empty());
    for process in ["capture", "estimator"] {
        assert!(manifest[process]["memory_peak_bytes"].as_u64().unwrap() > 1 << 20, "{process}");
    }

    // One line for every frame, under the colour frame's own time stamp.
    let expected: Vec<String> = (0..FRAMES).map(|i| format!("{:.6}", 1000.0 + i as f64 / 30.0)).collect();
    assert_eq!(stamps(&folder), expected);

    let scan = json(&["inspect", &arg(folder.join("scan.lscan")), "--json"]);
    assert_eq!((&scan["kind"], &scan["stats"]["tracked_pairs"]), (&"scan".into(), &FRAMES.into()));
    for count in ["vertices", "triangles", "keyframes"] {
        assert!(scan[count].as_u64().unwrap() > 0, "{count}: {scan}");
    }
    assert!(scan["witnesses"].is_u64());
    let result = json(&["inspect", &arg(folder.join("result.lres")), "--json"]);
    assert_eq!(result["kind"], "result");
    for count in ["vertices", "segments", "bands"] {
        assert!(result[count].as_u64().unwrap() > 0, "{count}: {result}");
    }
    assert!(["diffuse", "shade", "gi"].contains(&result["transfer"].as_str().unwrap()));
    for field in ["name", "choice", "evidence", "cost", "next_level"] {
        assert!(result["decisions"][0][field].is_string(), "{field}");
    }
    assert!(result["cuts"].is_array());
    let sheet = std::io::BufReader::new(std::fs::File::open(folder.join("preview.png")).unwrap());
    let sheet = png::Decoder::new(sheet).read_info().unwrap();
    assert!(sheet.info().width > 1000 && sheet.info().height > 500);
}

#[test]
fn no_estimate_stops_before_the_estimator() {
    let dir = tempfile::tempdir().unwrap();
    let (source, device) = (dir.path().join("table"), dir.path().join("device"));
    tum_folder(&source, FRAMES);
    let folder = replay(&source, &device, &["--no-estimate"]);
    let found: Vec<String> = files(&folder).into_keys().collect();
    assert_eq!(found, ["manifest.json", "scan.lscan", "trajectory.txt"]);
    let manifest: serde_json::Value = serde_json::from_slice(&files(&folder)["manifest.json"]).unwrap();
    let after = manifest["after_last_frame_s"].as_object().unwrap();
    assert!(after["published"].as_f64().unwrap() > 0.0 && !after.contains_key("result"), "{after:?}");

    // The same frames from a recording give the same trajectory, and the scan can be estimated later.
    let recording = dir.path().join("table.lrec");
    ok(&["import", "tum", &arg(&source), "-o", &arg(&recording)]);
    let again = replay(&recording, &device, &["--no-estimate"]);
    let trajectory = |folder: &Path| files(folder)["trajectory.txt"].clone();
    assert_eq!(trajectory(&folder), trajectory(&again));
    assert_eq!(scans(&device).len(), 2);
    let printed = ok(&["estimate", &arg(again.join("scan.lscan")), "--rounds", "1"]);
    assert_eq!(printed.trim(), arg(again.join("result.lres")));
}

#[test]
fn same_input_same_bytes_whatever_the_threads() {
    let dir = tempfile::tempdir().unwrap();
    let (source, device) = (dir.path().join("table"), dir.path().join("device"));
    tum_folder(&source, FRAMES);
    let runs = ["1", "2", "2"].map(|threads| replay(&source, &device, &["--rounds", "2", "--threads", threads]));
    let found = runs.map(|folder| files(&folder));
    for name in ["scan.lscan", "result.lres", "trajectory.txt", "preview.png"] {
        assert!(found[0][name] == found[1][name], "{name}: one thread and two");
        assert!(found[1][name] == found[2][name], "{name}: two runs");
    }
}

#[test]
fn loops_play_forward_and_backward_with_continuing_stamps() {
    let dir = tempfile::tempdir().unwrap();
    let (source, device) = (dir.path().join("table"), dir.path().join("device"));
    tum_folder(&source, FRAMES);
    let recording = dir.path().join("table.lrec");
    ok(&["import", "tum", &arg(&source), "-o", &arg(&recording)]);
    for source in [source, recording] {
        let folder = replay(&source, &device, &["--no-estimate", "--loop", "3"]);
        let stamps: Vec<f64> = stamps(&folder).iter().map(|t| t.parse().unwrap()).collect();
        // Frames at the turning points are played once.
        assert_eq!(stamps.len(), 3 * FRAMES - 2);
        assert!(stamps.windows(2).all(|w| (w[1] - w[0] - 1.0 / 30.0).abs() < 2e-6), "{stamps:?}");
        let position = |line: &str| -> Vec<f64> { line.split(' ').skip(1).map(|x| x.parse().unwrap()).collect() };
        let text = std::fs::read_to_string(folder.join("trajectory.txt")).unwrap();
        let lines: Vec<&str> = text.lines().filter(|l| !l.starts_with('#')).collect();
        let (first, turned) = (position(lines[0]), position(lines[2 * FRAMES - 2]));
        let distance: f64 = (0..3).map(|i| (first[i] - turned[i]).powi(2)).sum::<f64>().sqrt();
        assert!(distance < 0.01, "the camera comes back to where it began: {distance} m");
    }
}

/// Starts a replay that goes on for long.
fn endless(source: &Path, device: &Path, extra: &[&str]) -> Child {
    Command::new(EXECUTABLE)
        .args(["replay", &arg(source), "--device", &arg(device)])
        .args(COARSE)
        .args(extra)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// Longest wait; an emulated processor needs minutes for the few frames.
const PATIENCE: Duration = Duration::from_secs(900);

fn wait_for(what: &str, mut happened: impl FnMut() -> bool) {
    let started = Instant::now();
    while !happened() {
        assert!(started.elapsed() < PATIENCE, "{what} did not happen");
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn signal(name: &str, pid: u32) {
    assert!(Command::new("sh").args(["-c", &format!("kill -{name} {pid}")]).status().unwrap().success());
}

#[test]
#[cfg(target_os = "linux")]
fn signals_leave_nothing_behind() {
    let dir = tempfile::tempdir().unwrap();
    let (source, device) = (dir.path().join("table"), dir.path().join("device"));
    tum_folder(&source, FRAMES);
    for (name, code) in [("INT", 130), ("TERM", 143)] {
        let mut child = endless(&source, &device, &["--no-estimate", "--loop", "100000"]);
        wait_for("staging", || scans(&device).iter().any(|n| n.starts_with(".staging-")));
        signal(name, child.id());
        assert_eq!(child.wait().unwrap().code(), Some(code));
        assert_eq!(scans(&device), Vec::<String>::new(), "{name}");
    }
    // Nobody can clean up after SIGKILL but the next run.
    let mut child = endless(&source, &device, &["--no-estimate", "--loop", "100000"]);
    wait_for("staging", || scans(&device).iter().any(|n| n.starts_with(".staging-")));
    signal("KILL", child.id());
    child.wait().unwrap();
    let folder = replay(&source, &device, &["--no-estimate"]);
    assert_eq!(scans(&device), [folder.file_name().unwrap().to_str().unwrap()]);
}

#[test]
#[cfg(target_os = "linux")]
fn a_killed_estimator_does_not_take_the_scan_with_it() {
    let dir = tempfile::tempdir().unwrap();
    let (source, device) = (dir.path().join("table"), dir.path().join("device"));
    tum_folder(&source, FRAMES);
    let run = endless(&source, &device, &["--rounds", "100000"]);
    let mut estimator = None;
    wait_for("the estimator", || {
        estimator = child_of(run.id());
        estimator.is_some()
    });
    signal("KILL", estimator.unwrap());
    let output = run.wait_with_output().unwrap();
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("estimator ended early"), "{stderr}");
    let folder = PathBuf::from(text(&output.stdout).trim());
    let found = files(&folder);
    let manifest: serde_json::Value = serde_json::from_slice(&found["manifest.json"]).unwrap();
    assert_eq!(manifest["estimator"]["outcome"], "failed");
    assert!(manifest["estimator"]["problem"].as_str().unwrap().contains("signal"), "{manifest}");
    assert!(!found.contains_key("result.lres") && !found.keys().any(|n| n.ends_with(".part")), "{:?}", found.keys());
    // The scan is whole.
    assert_eq!(json(&["inspect", &arg(folder.join("scan.lscan")), "--json"])["kind"], "scan");
}

#[test]
#[cfg(target_os = "linux")]
fn a_signal_during_estimation_ends_the_estimator_too() {
    let dir = tempfile::tempdir().unwrap();
    let (source, device) = (dir.path().join("table"), dir.path().join("device"));
    tum_folder(&source, FRAMES);
    let mut run = endless(&source, &device, &["--rounds", "100000"]);
    let mut estimator = None;
    wait_for("the estimator", || {
        estimator = child_of(run.id());
        estimator.is_some()
    });
    signal("TERM", run.id());
    assert_eq!(run.wait().unwrap().code(), Some(143));
    assert_eq!(scans(&device), Vec::<String>::new());
    let stat = Path::new("/proc").join(estimator.unwrap().to_string());
    assert!(!stat.exists(), "the estimator still runs");
}
