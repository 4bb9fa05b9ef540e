//! The daemon as a whole, on a simulated Kinect that plays a recording, and what may happen to it.

#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::daemon::{Daemon, PATIENCE, manifest, recording, scans, status_file, unfinished};
use common::{EXECUTABLE, arg, child_of, json, ok, run, text};
use serde_json::Value;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

#[test]
fn scans_follow_orders_and_counters_are_right() {
    let dir = tempfile::tempdir().unwrap();
    let table = recording();
    let device = dir.path().join("device");
    let mut d = Daemon::start(&device, &format!("{table},fast,loss=0.001"), &["--no-estimate", "--scans", "2"]);
    d.wait_for("ready");
    assert!(!d.order("stop"), "there is nothing to stop");
    for n in 1..=2 {
        let during = d.scan(2.0);
        assert!(!d.order("start"), "one scan at a time");
        assert!(during["drops"]["missing_packets"].as_u64().unwrap() > 0, "{during}");
        assert!(d.order("stop"));
        if n == 1 {
            d.wait("published", |s| s["finished_scans"] == 1 && s["state"] == "ready");
        }
    }
    assert_eq!(d.ended(), Some(0));
    let published = scans(&device);
    assert!(published.len() == 2 && published.iter().any(|s| s.ends_with("scan-0002")), "{published:?}");
    for scan in &published {
        let stats = &manifest(&device, scan)["capture"]["stats"];
        let n = |key: &str| stats[key].as_u64().unwrap();
        assert_eq!(n("depth_frames"), n("pairs") + n("unpaired_depth"), "{stats}");
        assert_eq!(n("color_frames"), n("pairs") + n("unpaired_color"), "{stats}");
        assert_eq!(n("pairs"), n("tracked_pairs") + n("lost_pairs") + n("dropped_pairs"), "{stats}");
        assert!(n("missing_packets") >= n("incomplete_frames") && n("incomplete_frames") > 0, "{stats}");
        assert_eq!(n("dropped_pairs"), 0, "a device on its own clock waits");
    }
    let status = status_file(&device).unwrap();
    assert!(status["memory_peak_bytes"].as_u64().unwrap() < status["memory_plan_bytes"].as_u64().unwrap(), "{status}");
}

#[test]
fn scans_start_and_end_by_themselves() {
    let dir = tempfile::tempdir().unwrap();
    let table = recording();
    let device = dir.path().join("device");
    // The first picture stands for three seconds and the last one for ever.
    let mut d = Daemon::start(&device, &format!("{table},fast,hold=90"), &["--auto", "--no-estimate", "--scans", "1"]);
    assert_eq!(d.ended(), Some(0));
    let stats = &manifest(&device, &scans(&device)[0])["capture"]["stats"];
    let seconds = stats["duration_s"].as_f64().unwrap();
    // The recording is 5.5 s long; the stillness behind it is 3 s.
    assert!((6.0..11.0).contains(&seconds), "{seconds} s");
}

#[test]
fn unplugging_ends_a_scan_and_plugging_in_makes_ready() {
    let dir = tempfile::tempdir().unwrap();
    let table = recording();
    let device = dir.path().join("device");
    let plan = format!("{table},fast,unplug_at_frame=60,replug_ms=1000");
    let mut d = Daemon::start(&device, &plan, &["--no-estimate"]);
    d.wait_for("ready");
    assert!(d.order("start"));
    let s = d.wait("published", |s| s["finished_scans"] == 1 && s["state"] == "ready");
    assert!(s["last_error"].as_str().unwrap().contains("unplugged"), "{s}");
    d.scan(1.0);
    assert!(d.order("stop"));
    d.wait("published", |s| s["finished_scans"] == 2);
    d.signal("-TERM");
    assert_eq!(d.ended(), Some(0));
}

#[test]
fn a_signal_in_a_scan_loses_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let table = recording();
    let device = dir.path().join("device");
    let mut d = Daemon::start(&device, &format!("{table},fast"), &["--no-estimate"]);
    d.wait_for("ready");
    d.signal("-USR1");
    d.wait("scanning", |s| s["scan"]["seconds"].as_f64().is_some_and(|t| t >= 1.5));
    d.signal("-TERM");
    assert_eq!(d.ended(), Some(0));
    // What was captured is there, and finished at the next start.
    assert_eq!(scans(&device).len(), 0);
    let mut d = Daemon::start(&device, "pattern,fast", &["--no-estimate", "--scans", "1"]);
    assert_eq!(d.ended(), Some(0));
    let published = scans(&device);
    assert!(published.len() == 1 && published[0].ends_with("scan-0001"), "{published:?}");
    ok(&["inspect", &arg(device.join("scans").join(&published[0]).join("scan.lscan"))]);
}

/// Killed at random moments of capture and publishing, and what was being written cut at random: the next start is
/// clean, finished scans are intact, and the next scan works.
#[test]
fn power_cuts_are_survived() {
    let dir = tempfile::tempdir().unwrap();
    let table = recording();
    let device = dir.path().join("device");
    let plan = format!("{table},fast,frames=45");
    let mut seed = 12345u64;
    let mut random = move |n: u64| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) % n
    };
    let mut finished = Vec::new();
    for _ in 0..6 {
        let mut d = Daemon::start(&device, &plan, &["--no-estimate"]);
        d.begin();
        std::thread::sleep(Duration::from_millis(random(4000)));
        d.signal("-KILL");
        let _ = d.child.wait();
        for folder in unfinished(&device) {
            for file in std::fs::read_dir(&folder).unwrap().flatten() {
                let length = file.metadata().unwrap().len();
                if file.file_name() != "scan.lscan" && length > 0 {
                    std::fs::File::options().write(true).open(file.path()).unwrap().set_len(random(length)).unwrap();
                }
            }
        }
        for scan in scans(&device) {
            ok(&["inspect", &arg(device.join("scans").join(&scan).join("scan.lscan"))]);
            finished.push(scan);
        }
        assert!(finished.iter().all(|s| device.join("scans").join(s).exists()));
    }
    let mut d = Daemon::start(&device, &plan, &["--no-estimate"]);
    let before = d.wait_for("ready")["finished_scans"].as_u64().unwrap();
    assert!(unfinished(&device).is_empty(), "all finished or set aside");
    assert!(d.order("start"));
    d.wait("published", |s| s["finished_scans"].as_u64().unwrap() > before);
}

/// The disk takes no more in the middle of a scan: that scan is lost and reported; the daemon goes on.
#[test]
fn a_full_disk_ends_the_scan_cleanly() {
    let dir = tempfile::tempdir().unwrap();
    let table = recording();
    let device = dir.path().join("device");
    // Files longer than 600 KiB are refused, as by a full disk.
    let mut shell = Command::new("bash");
    shell.args(["-c", "trap '' XFSZ; ulimit -f 600; exec \"$0\" \"$@\""]).arg(EXECUTABLE);
    let mut d = Daemon::start_by(shell, &device, &format!("{table},fast"), &["--no-estimate"]);
    d.wait_for("ready");
    assert!(d.order("start"));
    let s = d.wait("the error", |s| s["last_error"].is_string() && s["state"] == "ready");
    assert_eq!(s["finished_scans"], 0, "{s}");
    assert!(unfinished(&device).is_empty() && scans(&device).is_empty());
    // Little room is another matter: the scan ends early and is published.
    drop(d);
    let mut d = Daemon::start(&device, "pattern,fast", &["--no-estimate", "--set", "daemon.min_free_mb=1000000"]);
    d.wait_for("ready");
    assert!(d.order("start"));
    let s = d.wait("the error", |s| s["last_error"].is_string());
    assert!(s["last_error"].as_str().unwrap().contains("min_free_mb"), "{s}");
}

/// An estimator that wants more memory than it may have ends alone; the scan is published, with the reason.
#[test]
fn an_estimator_over_its_limit_ends_alone() {
    let dir = tempfile::tempdir().unwrap();
    let table = recording();
    let device = dir.path().join("device");
    let mut d = Daemon::start(&device, &format!("{table},fast"), &["--set", "daemon.estimator_limit_mb=60"]);
    d.scan(1.5);
    assert!(d.order("stop"));
    let s = d.wait("published", |s| s["finished_scans"] == 1 && s["state"] == "ready");
    assert!(s["last_error"].as_str().unwrap().contains("estimator"), "{s}");
    let m = manifest(&device, &scans(&device)[0]);
    // The answer that stood before memory ran out is the result.
    assert_eq!(m["estimator"]["outcome"], "partial", "{m}");
    assert!(m["estimator"]["cut_values"][0]["first_answer"].is_object(), "{m}");
    assert!(m["files"].as_array().unwrap().iter().any(|f| f["name"] == "result.lres"), "{m}");
    d.scan(0.5);
}

/// The estimator is killed, then the daemon ended while it estimates: both scans are published, the second at the next
/// start.
#[test]
#[cfg(target_os = "linux")]
fn publishing_survives_signals() {
    let dir = tempfile::tempdir().unwrap();
    let table = recording();
    let device = dir.path().join("device");
    let mut d = Daemon::start(&device, &format!("{table},fast"), &[]);
    let estimating = |d: &mut Daemon| {
        d.scan(1.0);
        assert!(d.order("stop"));
        d.wait_for("estimating");
        let began = Instant::now();
        loop {
            if let Some(child) = child_of(d.child.id()) {
                return child;
            }
            assert!(began.elapsed() < PATIENCE, "{}", d.log());
        }
    };
    let child = estimating(&mut d);
    assert!(Command::new("kill").args(["-KILL", &child.to_string()]).status().unwrap().success());
    let s = d.wait("published", |s| s["finished_scans"] == 1 && s["state"] == "ready");
    assert!(s["last_error"].as_str().unwrap().contains("estimator"), "{s}");
    assert_eq!(manifest(&device, &scans(&device)[0])["estimator"]["outcome"], "failed");
    estimating(&mut d);
    d.signal("-TERM");
    assert_eq!(d.ended(), Some(0));
    assert_eq!((scans(&device).len(), unfinished(&device).len()), (1, 1));
    let mut d = Daemon::start(&device, "pattern,fast", &["--no-estimate", "--scans", "1"]);
    assert_eq!(d.ended(), Some(0));
    assert_eq!((scans(&device).len(), unfinished(&device).len()), (2, 0));
}

/// A replay is killed as soon as its result is visible: what is there is whole, and the next start of the daemon makes what follows it.
#[test]
fn what_follows_a_result_survives_a_power_cut() {
    let dir = tempfile::tempdir().unwrap();
    let (source, device) = (dir.path().join("table"), dir.path().join("device"));
    common::tum_folder(&source, 24);
    let mut replay = Command::new(EXECUTABLE)
        .args(["replay", &arg(&source), "--device", &arg(&device), "--rounds", "1"])
        .args(["--set", "fusion.voxel_size_m=0.01"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let began = Instant::now();
    while scans(&device).is_empty() {
        assert!(began.elapsed() < PATIENCE, "nothing is published");
        std::thread::sleep(Duration::from_millis(2));
    }
    replay.kill().unwrap();
    replay.wait().unwrap();
    let scan = scans(&device).remove(0);
    let listed = |m: &Value| -> Vec<String> {
        m["files"].as_array().unwrap().iter().map(|f| f["name"].as_str().unwrap().to_owned()).collect()
    };
    let before = manifest(&device, &scan);
    assert_eq!(listed(&before), ["result.lres", "scan.lscan", "trajectory.txt"]);
    let after = before["after_last_frame_s"].as_object().unwrap();
    assert!(after["result"].is_f64() && !after.contains_key("published"), "{after:?}");
    ok(&["inspect", &arg(device.join("scans").join(&scan).join("result.lres"))]);

    let mut d = Daemon::start(&device, "pattern,fast", &["--no-estimate"]);
    d.wait_for("ready");
    let finished = manifest(&device, &scan);
    assert_eq!(listed(&finished), ["preview.png", "result.lres", "scan.lscan", "trajectory.txt", "viewer.html"]);
    assert_eq!(finished["after_last_frame_s"]["result"], before["after_last_frame_s"]["result"]);
    assert_eq!(finished["after_last_frame_s"].get("published"), Some(&Value::Null), "nobody knows when that was");
}

/// After a session with faults the daemon runs on, its counters report the faults, and the next scan is complete.
#[test]
fn the_scan_after_a_bad_one_is_good() {
    let table = recording();
    for (faults, counter) in [
        ("loss=0.5,burst=0.001", "missing_packets"),
        ("garbage=0.2,truncate=0.2,reorder=0.1,bad_status=0.1", "flagged_packets"),
        ("burst=0.002,burst_packets=300,stall_every=20,stall_frames=5", "missing_packets"),
    ] {
        let dir = tempfile::tempdir().unwrap();
        let device = dir.path().join("device");
        let mut d = Daemon::start(&device, &format!("{table},fast,sick_sessions=1,{faults}"), &["--no-estimate"]);
        d.begin();
        d.wait(faults, |s| s["drops"][counter].as_u64().unwrap() > 0 && s["scan"]["seconds"].as_f64() > Some(0.5));
        d.order("stop");
        let before = d.wait_for("ready")["finished_scans"].as_u64().unwrap();
        d.scan(1.0);
        assert!(d.order("stop"));
        let s = d.wait(faults, |s| s["finished_scans"].as_u64() == Some(before + 1) && s["state"] == "ready");
        assert!(s["drops"][counter] == 0 && s["drops"]["incomplete_frames"] == 0, "{s}");
        let last = scans(&device).pop().unwrap();
        let stats = &manifest(&device, &last)["capture"]["stats"];
        assert!(stats["tracked_pairs"].as_u64().unwrap() > 10 && stats["lost_pairs"] == 0, "{stats}");
        d.signal("-TERM");
        assert_eq!(d.ended(), Some(0));
    }
}

/// Colour of 1280×1024 becomes keyframes of that size.
#[test]
fn keyframes_may_be_large() {
    let dir = tempfile::tempdir().unwrap();
    let table = recording();
    let device = dir.path().join("device");
    let more = ["--no-estimate", "--set", "kinect.color_sxga=true"];
    let mut d = Daemon::start(&device, &format!("{table},fast"), &more);
    d.scan(2.0);
    assert!(d.order("stop"));
    d.wait("published", |s| s["finished_scans"] == 1 && s["state"] == "ready");
    let scan = &scans(&device)[0];
    let stats = &manifest(&device, scan)["capture"]["stats"];
    assert!(stats["tracked_pairs"].as_u64().unwrap() >= 8 && stats["lost_pairs"] == 0, "{stats}");
    let seen = json(&["--json", "inspect", &arg(device.join("scans").join(scan).join("scan.lscan"))]);
    let size = &seen["sensor"]["color"]["intrinsics"];
    assert!(size["width"] == 1280 && size["height"] == 1024 && seen["keyframes"].as_u64().unwrap() > 0, "{seen}");
}

/// Fusion is slower than the sensor: pairs give way and are counted, nothing else is lost.
#[test]
fn a_slow_consumer_loses_pairs_by_count_only() {
    let dir = tempfile::tempdir().unwrap();
    let table = recording();
    let device = dir.path().join("device");
    let more = ["--no-estimate", "--scans", "1"];
    let mut d = Daemon::start(&device, &format!("{table},fast,hasty,frames=300"), &more);
    d.begin();
    assert_eq!(d.ended(), Some(0));
    let stats = &manifest(&device, &scans(&device)[0])["capture"]["stats"];
    let n = |key: &str| stats[key].as_u64().unwrap();
    assert!(n("dropped_pairs") > 0, "{stats}");
    assert_eq!(n("pairs"), n("tracked_pairs") + n("lost_pairs") + n("dropped_pairs"), "{stats}");
    assert_eq!((n("depth_frames"), n("missing_packets")), (n("pairs") + n("unpaired_depth"), 0), "{stats}");
}

#[test]
fn two_daemons_do_not_share_a_device() {
    let dir = tempfile::tempdir().unwrap();
    let mut d = Daemon::start(dir.path(), "pattern,fast", &[]);
    d.wait_for("ready");
    let second = run(&["capture", "--device", &arg(dir.path()), "--simulate", "pattern,fast"]);
    assert_eq!(second.status.code(), Some(2), "{}", text(&second.stderr));
    assert!(text(&second.stderr).contains("another"));
    d.signal("-TERM");
    assert_eq!(d.ended(), Some(0));
    assert!(!dir.path().join("control").exists());
}

#[test]
fn a_dead_device_is_waited_out() {
    for fault in ["dead", "never_ready", "bad_magic"] {
        let dir = tempfile::tempdir().unwrap();
        let mut d = Daemon::start(dir.path(), &format!("pattern,fast,{fault}"), &[]);
        let s = d.wait("the error", |s| s["last_error"].is_string());
        assert_eq!(s["state"], "waiting", "{s}");
        assert!(!d.order("start"));
        d.signal("-TERM");
        assert_eq!(d.ended(), Some(0));
    }
}

#[test]
fn depth_without_colour_makes_no_scan_and_no_trouble() {
    let dir = tempfile::tempdir().unwrap();
    let mut d = Daemon::start(dir.path(), "pattern,fast,no_color,frames=100", &["--no-estimate"]);
    d.wait_for("ready");
    assert!(d.order("start"));
    let s = d.wait("the error", |s| s["last_error"].is_string() && s["state"] == "ready");
    assert_eq!(s["finished_scans"], 0);
    assert!(unfinished(dir.path()).is_empty() && scans(dir.path()).is_empty());
}

/// Messages to systemd.
#[test]
fn the_service_manager_is_kept_informed() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("notify");
    let socket = std::os::unix::net::UnixDatagram::bind(&path).unwrap();
    socket.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut command = Command::new(EXECUTABLE);
    command
        .args(["capture", "--device", &arg(dir.path()), "--simulate", "pattern,fast"])
        .env("NOTIFY_SOCKET", &path)
        .stderr(Stdio::null());
    let mut child = command.spawn().unwrap();
    let (mut said, mut buffer) = (String::new(), [0; 512]);
    while !["READY=1", "STATUS=ready", "WATCHDOG=1"].iter().all(|line| said.contains(line)) {
        let n = socket.recv(&mut buffer).unwrap();
        said += &format!("{}\n", text(&buffer[..n]));
    }
    child.kill().unwrap();
    child.wait().unwrap();
}
