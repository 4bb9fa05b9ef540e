//! The executable with a simulated Kinect, and without any.

#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::{EXECUTABLE, arg, fails, json, ok, run, text};
use std::path::Path;
use tests::shared;

/// Records from a simulated Kinect; the report.
fn recorded(dir: &Path, name: &str, plan: &str, more: &[&str]) -> serde_json::Value {
    let mut args = vec!["--json".into(), "record".into(), arg(dir.join(name)), "--simulate".into(), plan.into()];
    args.extend(more.iter().map(|s| (*s).to_owned()));
    json(&args)
}

#[test]
fn without_a_kinect_the_exit_code_is_3() {
    let dir = tempfile::tempdir().unwrap();
    assert!(fails(3, &["list"]).contains("plug one in"));
    let output = arg(dir.path().join("x.lrec"));
    assert!(fails(3, &["record", &output]).contains("no Kinect is plugged in"));
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn plans_that_are_not_understood_are_named() {
    let error = fails(2, &["list", "--simulate", "pattern,lost=1"]);
    assert!(error.contains("lost=1"), "{error}");
}

#[test]
fn a_simulated_kinect_is_listed() {
    let line = ok(&["list", "--simulate", "pattern,model=1473"]);
    assert!(line.contains("1473") && line.contains("SIMULATED0000001"), "{line}");
}

#[test]
fn frames_are_recorded_and_counted() {
    let dir = tempfile::tempdir().unwrap();
    let c = recorded(dir.path(), "a.lrec", "pattern,fast,loss=0.01", &["--seconds", "2"]);
    let depth = &c["counters"]["depth"];
    assert!(depth["frames"].as_u64().unwrap() >= 60 && depth["missing"].as_u64().unwrap() > 50, "{c}");
    assert_eq!(c["counters"]["depth"]["dropped_frames"], 0);
    let seen = json(&["--json", "inspect", &arg(dir.path().join("a.lrec"))]);
    assert!(seen.to_string().contains("SIMULATED0000001"), "{seen}");
}

#[test]
fn unplugging_leaves_a_complete_recording() {
    let dir = tempfile::tempdir().unwrap();
    let path = arg(dir.path().join("a.lrec"));
    let output = run(&["record", &path, "--simulate", "pattern,fast,unplug_at_frame=40"]);
    assert_eq!(output.status.code(), Some(3), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("unplugged"));
    ok(&["inspect", &path]);
}

#[test]
fn a_device_that_makes_no_sense_ends_in_time() {
    let dir = tempfile::tempdir().unwrap();
    let path = arg(dir.path().join("a.lrec"));
    for fault in ["dead", "never_ready", "bad_magic"] {
        let error = fails(3, &["record", &path, "--simulate", &format!("pattern,fast,{fault}")]);
        assert!(error.contains("unplug"), "{error}");
    }
}

#[test]
fn a_disk_without_room_is_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    let path = arg(dir.path().join("a.lrec"));
    let error = fails(1, &["record", &path, "--raw", "--seconds", "900000", "--simulate", "pattern,fast"]);
    assert!(error.contains("are free"), "{error}");
}

/// The same device, recorded as packets and as frames, gives the same scan, byte for byte.
#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: data/tum_fr1_xyz_400")]
fn packets_replay_bit_for_bit() {
    let shared = shared();
    let dir = tempfile::tempdir().unwrap();
    let source = dir.path().join("desk.lrec");
    ok(&["import", "tum", &arg(shared.join("data/tum_fr1_xyz_400")), "-o", &arg(&source)]);
    let plan = format!("{},fast,loss=0.001,seed=3", arg(&source));
    let mut scans = Vec::new();
    for (name, raw) in [("frames.lrec", &[][..]), ("packets.lrec", &["--raw"][..])] {
        let c = recorded(dir.path(), name, &plan, &[&["--seconds", "2.2"], raw].concat());
        assert!(c["counters"]["depth"]["missing"].as_u64().unwrap() > 0, "{c}");
        let device = dir.path().join(format!("{name}-device"));
        // The frames end where the recording does, on a packet; both end on the same pair by time.
        let folder = ok(&["replay", &arg(dir.path().join(name)), "--no-estimate", "--device", &arg(&device)]);
        let seen = json(&["--json", "inspect", &arg(dir.path().join(name))]);
        assert!(seen["accelerometer"].as_u64() > Some(5) && seen["duration_s"].as_f64() < Some(2.5), "{seen}");
        scans.push(std::fs::read_to_string(Path::new(folder.trim()).join("trajectory.txt")).unwrap());
    }
    let lines = scans.iter().map(|s| s.lines().count()).min().unwrap();
    // The recording's depth is in fifths of a millimetre, its first frame has no partner.
    assert!(lines >= 60, "{lines} poses");
    let [a, b] = [0, 1].map(|i| scans[i].lines().take(lines).collect::<Vec<_>>());
    assert_eq!(a, b);
}

#[test]
fn ctrl_c_completes_the_recording() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lrec");
    let mut child = std::process::Command::new(EXECUTABLE)
        .args(["record", &arg(&path), "--simulate", "pattern"])
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let part = path.with_file_name("a.lrec.part");
    while std::fs::metadata(&part).map_or(0, |m| m.len()) < 1 << 20 {
        std::thread::sleep(std::time::Duration::from_millis(50));
        assert!(child.try_wait().unwrap().is_none(), "it still runs");
    }
    let killed = std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());
    assert!(child.wait().unwrap().success());
    assert!(path.exists() && !part.exists());
    ok(&["inspect", &arg(&path)]);
}
