//! `estimate --budget`, with the process halted from outside: the result stands in time.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "these are tests")]
#![cfg(unix)]

mod common;

use common::{EXECUTABLE, arg, fixture, ok, tum_folder};
use recordings::result::Estimate;
use rustix::process::{Pid, Signal, kill_process};
use std::io::{BufRead, BufReader};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant, SystemTime};

/// What the budget may be exceeded by.
const TOLERATED_S: f64 = 1.0;

/// A scan that takes some seconds.
fn scan(name: &str) -> PathBuf {
    let dir = fixture(name);
    let (source, device) = (dir.join("table"), dir.join("device"));
    tum_folder(&source, 24);
    let settings = ["--set", "fusion.voxel_size_m=0.006", "--no-estimate"];
    let folder = ok(&[&["replay", &arg(&source), "--device", &arg(&device)][..], &settings].concat());
    PathBuf::from(folder.trim()).join("scan.lscan")
}

/// The process, whose progress and log can be read.
fn estimate(scan: &Path, result: &Path, budget: f64) -> Child {
    let mut command = Command::new(EXECUTABLE);
    command.args(["--json", "estimate", &arg(scan), "-o", &arg(result), "--budget", &budget.to_string()]);
    command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Waits until the estimator works.
fn wait_for_work(child: &mut Child) {
    let stderr = BufReader::new(child.stderr.take().unwrap());
    let mut lines = stderr.lines().map_while(Result::ok);
    assert!(lines.any(|l| l.contains("first answer")), "the first answer begins");
    // Read to the end, so that the process never waits for a reader.
    std::thread::spawn(move || lines.for_each(drop));
}

fn send(child: &Child, signal: Signal) {
    // It may have ended.
    let _ = kill_process(Pid::from_child(child), signal);
}

fn seconds(s: f64) -> Duration {
    Duration::from_secs_f64(s)
}

/// Seconds from `start` until the file came to its place.
fn in_place_after(file: &Path, start: SystemTime) -> f64 {
    let metadata = std::fs::metadata(file).unwrap();
    let since_epoch = start.duration_since(SystemTime::UNIX_EPOCH).unwrap().as_secs_f64();
    metadata.ctime() as f64 + metadata.ctime_nsec() as f64 * 1e-9 - since_epoch
}

/// Nothing but the scan and the result is left.
fn assert_alone(result: &Path) {
    let names = std::fs::read_dir(result.parent().unwrap()).unwrap().map(|e| e.unwrap().file_name());
    let name = result.file_name().unwrap().to_string_lossy().into_owned();
    let beside: Vec<_> = names.filter(|n| n.to_string_lossy().starts_with(&name)).collect();
    assert_eq!(beside, [result.file_name().unwrap()]);
}

/// The machine is free at first, so that much is planned, and halted more and more: the plan does not hold, the budget does.
#[test]
fn a_plan_that_does_not_hold_is_no_late_result() {
    let scan = scan("budget_halted");
    let result = scan.with_file_name("halted.lres");
    let budget = 10.0;
    let (clock, start) = (Instant::now(), SystemTime::now());
    let mut child = estimate(&scan, &result, budget);
    wait_for_work(&mut child);
    std::thread::sleep(seconds(0.5));
    while child.try_wait().unwrap().is_none() {
        assert!(clock.elapsed() < seconds(3.0 * budget), "it ends");
        send(&child, Signal::STOP);
        std::thread::sleep(seconds(1.5));
        send(&child, Signal::CONT);
        std::thread::sleep(seconds(0.15));
    }
    let ended = clock.elapsed().as_secs_f64();
    assert_eq!(child.wait().unwrap().code(), Some(0));
    let after = in_place_after(&result, start);
    let found = Estimate::read(&result).unwrap();
    println!(
        "{} vertices after {after:.1} s, process after {ended:.1} s, cuts {:?}",
        found.mesh.positions.len(),
        found.cuts
    );
    assert!(after <= budget + TOLERATED_S, "{after} s of {budget}");
    assert!(found.albedo.iter().all(|a| a.is_finite()) && !found.cuts.is_empty(), "{:?}", found.cuts);
    assert_alone(&result);
}

/// Nothing can be in time: what there is comes as soon as it can, and the exit code tells.
#[test]
fn a_late_result_is_there_and_is_code_5() {
    let scan = scan("budget_late");
    let result = scan.with_file_name("late.lres");
    let mut child = estimate(&scan, &result, 0.05);
    wait_for_work(&mut child);
    send(&child, Signal::STOP);
    std::thread::sleep(seconds(3.0));
    send(&child, Signal::CONT);
    assert_eq!(child.wait().unwrap().code(), Some(5));
    let found = Estimate::read(&result).unwrap();
    assert!(found.confidence.iter().any(|c| *c > 0.1), "a result that tells something");
    assert_alone(&result);
}
