//! The daemon for hours of device time, with everything that may happen to a scan: what becomes of each scan, and what the daemon uses.

#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::daemon::{Daemon, check_files, recording, scans, status_file, unfinished};
use common::usage::{Usage, command_line, processes_with, slope};
use common::{EXECUTABLE, arg, child_of, ok};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

/// Frames of motion after which a Kinect is unplugged.
const UNPLUG_AFTER: u64 = 45;
/// What files may gain beyond the length of the log while the disk is "full", in bytes: less than a scan, more than `status.json`.
const FULL_DISK: u64 = 200_000;
/// Memory that may be gained a scan, in KiB: as much as one leaked colour frame of 640×480 bytes.
const TOLERATED_KIB: f64 = 300.0;
/// Upper bound of every wait; the longest is for motion.
const PATIENCE: Duration = Duration::from_secs(3600);
/// Samples that memory needs to settle: pools, caches and the allocator's arenas fill in the first scans.
const WARM_UP: usize = 3;

/// What happens to a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fate {
    /// Nothing but lost packets.
    Ordinary,
    /// The Kinect is unplugged in the scan, and plugged in again. Only for the first scans of a process.
    Unplugged,
    /// The estimator gets SIGKILL.
    EstimatorKilled,
    /// The disk takes no more.
    DiskFull,
    /// The daemon gets SIGKILL while it scans.
    KilledScanning,
    /// The daemon gets SIGKILL while the estimator runs.
    KilledEstimating,
    /// The daemon gets SIGTERM while it scans.
    Terminated,
}

use Fate::{DiskFull, EstimatorKilled, KilledEstimating, KilledScanning, Ordinary, Terminated, Unplugged};

/// Every fate once; no more descriptors and threads after the third estimate of a process than at the first.
#[test]
fn every_scan_is_accounted_for_and_nothing_leaks() {
    let mut soak = Soak::new(90, "1");
    soak.run(&[Unplugged, EstimatorKilled, DiskFull, Ordinary, KilledScanning]);
    soak.run(&[KilledEstimating]);
    soak.run(&[Terminated]);
    soak.finish();
}

/// The same for SOAK_SCANS scans (40) in SOAK_HOURS hours of device time (24), with the slope of memory:
/// `cargo test --release -p capture --test soak -- --ignored --nocapture`.
#[test]
#[ignore = "takes an hour of processor time: 24 hours of device time"]
fn a_day_of_forty_scans() {
    let number = |name: &str, default: f64| std::env::var(name).map_or(default, |v| v.parse().unwrap());
    let (scans, hours) = (number("SOAK_SCANS", 40.0), number("SOAK_HOURS", 24.0));
    let still = (hours * 3600.0 * 30.0 / scans) as u64;
    let mut soak = Soak::new(still, "2");
    let others = [vec![Unplugged, Ordinary, KilledEstimating], vec![EstimatorKilled, Ordinary, Terminated]];
    let rest = scans as usize - others.iter().map(Vec::len).sum::<usize>();
    let mut longest = vec![Unplugged, Unplugged];
    longest.extend([Ordinary, EstimatorKilled, Ordinary, DiskFull, Ordinary].iter().cycle().take(rest - 3));
    longest.push(KilledScanning);
    soak.run(&longest);
    others.iter().for_each(|fates| soak.run(fates));
    soak.finish();
}

/// A scan, and what the daemon used while its estimator ran.
struct Row {
    fate: Fate,
    process: usize,
    used: Option<Usage>,
}

/// A device folder, and what happened in it.
struct Soak {
    dir: tempfile::TempDir,
    /// Frames before the camera moves.
    still: u64,
    more: Vec<String>,
    rows: Vec<Row>,
    /// Of each process.
    peaks: Vec<Usage>,
}

impl Soak {
    fn new(still: u64, budget_s: &str) -> Self {
        let mut more: Vec<String> = vec!["--auto".into()];
        for setting in ["fusion.voxel_size_m=0.02", "daemon.max_scan_s=4", &format!("daemon.budget_s={budget_s}")] {
            more.extend(["--set".into(), setting.into()]);
        }
        let dir = tempfile::tempdir().unwrap();
        Self { dir, still, more, rows: Vec::new(), peaks: Vec::new() }
    }

    fn device(&self) -> PathBuf {
        self.dir.path().join("device")
    }

    /// A process of the daemon, and scans until all fates have come.
    fn run(&mut self, fates: &[Fate]) {
        let unplugs = fates.iter().filter(|f| **f == Unplugged).count();
        assert!(fates[..unplugs].iter().all(|f| *f == Unplugged), "the simulator unplugs in the first sessions");
        let mut plan = format!("{},fast,hold={},loss=0.0005,burst=0.00001,burst_packets=300", recording(), self.still);
        plan += &format!(",seed={},clock_start=0,not_ready=1,replug_ms=1000", self.peaks.len() + 1);
        if unplugs > 0 {
            plan += &format!(",unplugs={unplugs},unplug_at_frame={}", self.still + UNPLUG_AFTER);
        }
        let mut process = Process::start(&self.device(), &plan, &self.more);
        for fate in fates {
            let used = process.scan(*fate);
            println!("scan {}, {fate:?}: {used:?}", self.rows.len() + 1);
            self.rows.push(Row { fate: *fate, process: self.peaks.len(), used });
        }
        if process.daemon.child.try_wait().unwrap().is_none() {
            process.daemon.signal("-TERM");
            assert_eq!(process.daemon.ended(), Some(0));
        }
        self.peaks.push(process.peak);
    }

    /// Lets the daemon finish what was interrupted, then prints what became of each scan, and fails if one is missing or something leaked.
    fn finish(&self) {
        let device = self.device();
        let _ = std::fs::remove_file(device.join("status.json"));
        let mut d = Daemon::start(&device, "pattern,fast", &["--no-estimate"]);
        d.wait_for("ready");
        d.signal("-TERM");
        assert_eq!(d.ended(), Some(0));
        assert!(unfinished(&device).is_empty(), "{}", d.log());
        let left = processes_with(&arg(&device));
        assert!(left.is_empty(), "processes {left:?} are left: {:?}", left.iter().map(|p| command_line(*p)));
        self.print();
        let found: Vec<String> =
            self.rows.iter().enumerate().filter_map(|(i, row)| wrong(&device, i + 1, row.fate)).collect();
        assert!(found.is_empty(), "{}\n{}", found.join("\n"), d.log());
        let counter = std::fs::read_to_string(device.join("counter")).unwrap();
        assert_eq!(counter.trim(), self.rows.len().to_string(), "a number for each scan");
        let leaks: Vec<String> = (0..self.peaks.len()).flat_map(|process| self.leaks(process)).collect();
        assert!(leaks.is_empty(), "{}", leaks.join("\n"));
    }

    fn print(&self) {
        let device = self.device();
        let mut seconds = 0.0;
        println!("\n| scan | process | what happened | found in | device time | memory, KiB | descriptors | threads |");
        println!("|---|---|---|---|---|---|---|---|");
        for (i, Row { fate, process, used }) in self.rows.iter().enumerate() {
            let found = places(&device, i + 1).join(", ");
            let used = used.map_or("| |".into(), |u| format!("{} | {} | {}", u.resident_kib, u.descriptors, u.threads));
            seconds += device_seconds(&device, i + 1);
            println!("| {} | {} | {fate:?} | {found} | {:.3} h | {used} |", i + 1, process + 1, seconds / 3600.0);
        }
        println!("\n{} scans, time stamps over {:.2} h", self.rows.len(), seconds / 3600.0);
        for (process, peak) in self.peaks.iter().enumerate() {
            print!("process {}: at most {} KiB, ", process + 1, peak.resident_kib);
            print!("{} descriptors, {} threads", peak.descriptors, peak.threads);
            let settled = self.settled(process);
            if let ([first, .., last], true) = (&settled[..], settled.len() > 2) {
                print!(
                    "; memory {:+.1} KiB a scan, {:+.1} KiB an hour of device time",
                    a_scan(&settled),
                    slope(&settled)
                );
                print!(" ({} KiB at scan {WARM_UP}, {} at the last)", first.1, last.1);
            }
            println!();
        }
    }

    /// Hours of device time and KiB of memory at the estimates of a process, without those of the warm-up.
    fn settled(&self, process: usize) -> Vec<(f64, f64)> {
        let device = self.device();
        let mut hours = 0.0;
        let rows = self.rows.iter().enumerate().filter(|(_, row)| row.process == process);
        let samples = rows.filter_map(|(i, row)| {
            hours += device_seconds(&device, i + 1) / 3600.0;
            Some((hours, row.used?.resident_kib as f64))
        });
        samples.skip(WARM_UP).collect()
    }

    /// What leaked in a process.
    fn leaks(&self, process: usize) -> Vec<String> {
        let used: Vec<Usage> = self.rows.iter().filter(|r| r.process == process).filter_map(|r| r.used).collect();
        let [first, .., last] = used[..] else { return Vec::new() };
        let mut leaks = Vec::new();
        for (what, first, last) in
            [("descriptors", first.descriptors, last.descriptors), ("threads", first.threads, last.threads)]
        {
            if last > first {
                leaks
                    .push(format!("process {}: {first} {what} at the first estimate, {last} at the last", process + 1));
            }
        }
        let settled = self.settled(process);
        if settled.len() > 2 && a_scan(&settled) > TOLERATED_KIB {
            leaks.push(format!("process {}: {:.0} KiB a scan", process + 1, a_scan(&settled)));
        }
        leaks
    }
}

/// A running daemon.
struct Process {
    daemon: Daemon,
    /// Length of the log when it began.
    log_from: usize,
    /// Scans finished, as the status counts them.
    finished: u64,
    peak: Usage,
}

impl Process {
    /// Starts it; returns when what an earlier one left is finished.
    fn start(device: &Path, plan: &str, more: &[String]) -> Self {
        let _ = std::fs::remove_file(device.join("status.json"));
        let log_from = std::fs::metadata(device.join("log")).map_or(0, |m| m.len() as usize);
        // Without the signal of too long files, their writes fail with an error.
        let mut shell = Command::new("bash");
        shell.args(["-c", "trap '' XFSZ; exec \"$0\" \"$@\""]).arg(EXECUTABLE);
        let more: Vec<&str> = more.iter().map(String::as_str).collect();
        let daemon = Daemon::start_by(shell, device, plan, &more);
        let mut own = Self { daemon, log_from, finished: 0, peak: Usage::default() };
        own.until("a Kinect", |own| status_file(&own.daemon.device).is_some_and(|s| s["sensor"].is_string()));
        own.finished = own.finished_scans();
        own
    }

    /// Waits for the next scan to end as it is meant to; returns what was used while its estimator ran.
    fn scan(&mut self, fate: Fate) -> Option<Usage> {
        match fate {
            DiskFull => {
                self.limit_files(&format!("{}:", self.log_length() + FULL_DISK));
                let errors = self.errors().len();
                self.until("the error of a full disk", |own| own.errors().len() > errors);
                self.limit_files("unlimited:");
                return None;
            }
            KilledScanning | Terminated => {
                self.until("scanning", |own| own.fused_pairs() > 10);
                self.end(if fate == Terminated { "-TERM" } else { "-KILL" });
                return None;
            }
            _ => {}
        }
        let errors = self.errors().len();
        let estimator = self.estimator();
        let used = self.at_rest();
        match fate {
            KilledEstimating => {
                self.end("-KILL");
                return Some(used);
            }
            EstimatorKilled => drop(Command::new("kill").args(["-KILL", &estimator.to_string()]).status().unwrap()),
            Unplugged => {
                let last = self.errors().pop().unwrap_or_default();
                assert!(last.contains("unplugged"), "the last error is {last:?}");
            }
            _ => {}
        }
        self.until("published", |own| own.finished_scans() > own.finished);
        self.finished += 1;
        let reported = self.errors().len() - errors;
        assert!(fate != EstimatorKilled || reported > 0, "a killed estimator is reported\n{}", self.daemon.log());
        Some(used)
    }

    /// Waits for the estimator of the scan.
    fn estimator(&mut self) -> u32 {
        let mut found = None;
        self.until("the estimator", |own| {
            let child = child_of(own.daemon.child.id());
            found = child.filter(|pid| command_line(*pid).is_some_and(|line| line.contains(" estimate ")));
            found.is_some()
        });
        found.unwrap()
    }

    /// What the daemon uses while it waits for the estimator: the least of a few samples, since the control socket and the status file
    /// are opened now and then.
    fn at_rest(&self) -> Usage {
        let sample = || {
            std::thread::sleep(Duration::from_millis(10));
            Usage::of(self.daemon.child.id()).unwrap()
        };
        (0..5).fold(sample(), |lowest, _| lowest.lowest(sample()))
    }

    /// Waits, and keeps the highest usage.
    fn until(&mut self, what: &str, mut is_so: impl FnMut(&Self) -> bool) {
        let began = Instant::now();
        while !is_so(self) {
            if let Some(used) = Usage::of(self.daemon.child.id()) {
                self.peak = self.peak.highest(used);
            }
            let ended = self.daemon.child.try_wait().unwrap();
            assert!(ended.is_none() && began.elapsed() < PATIENCE, "{what}: {ended:?}\n{}", self.daemon.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Ends the daemon by a signal.
    fn end(&mut self, signal: &str) {
        self.daemon.signal(signal);
        if signal == "-TERM" {
            assert_eq!(self.daemon.ended(), Some(0));
        } else {
            self.daemon.child.wait().unwrap();
        }
    }

    fn limit_files(&self, bytes: &str) {
        let limit = [format!("--pid={}", self.daemon.child.id()), format!("--fsize={bytes}")];
        assert!(Command::new("prlimit").args(limit).status().unwrap().success());
    }

    fn log_length(&self) -> u64 {
        std::fs::metadata(self.daemon.device.join("log")).map_or(0, |m| m.len())
    }

    /// Pairs fused in the scan in progress.
    fn fused_pairs(&self) -> u64 {
        let status = self.daemon.status().filter(|s| s["state"] == "scanning");
        status.and_then(|s| s["scan"]["fused_pairs"].as_u64()).unwrap_or(0)
    }

    fn finished_scans(&self) -> u64 {
        status_file(&self.daemon.device).and_then(|s| s["finished_scans"].as_u64()).unwrap_or(0)
    }

    /// What this process has logged so far.
    fn log(&self) -> String {
        self.daemon.log().get(self.log_from..).unwrap_or_default().into()
    }

    fn errors(&self) -> Vec<String> {
        self.log().lines().filter(|l| l.contains("ERROR")).map(Into::into).collect()
    }
}

/// Slope of memory in KiB a scan; `settled` as [`Soak::settled`] gives it.
fn a_scan(settled: &[(f64, f64)]) -> f64 {
    slope(&settled.iter().enumerate().map(|(i, p)| (i as f64, p.1)).collect::<Vec<_>>())
}

/// True if this is the name of scan number `number`.
fn is_number(name: &str, number: usize) -> bool {
    name.contains(&format!("-scan-{number:04}"))
}

/// Seconds of device time from the start of the streams to the last pair of scan number `number`, by the time stamps of its trajectory;
/// none where it was lost.
fn device_seconds(device: &Path, number: usize) -> f64 {
    let all = scans(device);
    let scan = all.iter().find(|s| is_number(s, number));
    let text = scan.and_then(|s| std::fs::read_to_string(device.join("scans").join(s).join("trajectory.txt")).ok());
    let stamp = |text: String| text.lines().last()?.split(' ').next()?.parse().ok();
    text.and_then(stamp).unwrap_or(0.0)
}

/// Where scan number `number` is.
fn places(device: &Path, number: usize) -> Vec<&'static str> {
    let named = |folder: &str| {
        let names = std::fs::read_dir(device.join(folder)).into_iter().flatten().flatten();
        names.filter(|e| is_number(&e.file_name().to_string_lossy(), number)).count()
    };
    ["scans", "aside"].into_iter().flat_map(|folder| vec![folder; named(folder)]).collect()
}

/// What is wrong with scan number `number`: it is not where it should be. Fails if it is not whole.
fn wrong(device: &Path, number: usize, fate: Fate) -> Option<String> {
    for scan in scans(device).iter().filter(|s| is_number(s, number)) {
        check_files(device, scan, &format!("{fate:?}"));
        ok(&["inspect", &arg(device.join("scans").join(scan).join("scan.lscan"))]);
    }
    let places = places(device, number);
    let is_right = match fate {
        // It was reported.
        DiskFull => places.is_empty(),
        // Its file may have been complete.
        KilledScanning => places.len() == 1,
        _ => places == ["scans"],
    };
    (!is_right).then(|| format!("scan {number}, {fate:?}, is in {places:?}"))
}
