//! A box without a battery: its clock is not set when it starts, and its power may be cut at any moment.

#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::daemon::{Daemon, PATIENCE, check_files, manifest, recording, scans, status_file, unfinished};
use common::{EXECUTABLE, arg, ok, preload, tiny_recording};
use std::collections::BTreeMap;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

/// Two scans before the clock is set; the second is dated when it is, the first was published in an earlier run of the system.
#[test]
fn scans_of_a_box_without_a_clock_get_their_date() {
    let dir = tempfile::tempdir().unwrap();
    let (device, is_set) = (dir.path().join("device"), dir.path().join("set"));
    let library = preload("preload/clock.c", dir.path());
    let plan = format!("{},fast", recording());
    let mut command = Command::new(EXECUTABLE);
    command.env("LD_PRELOAD", &library).env("CLOCK_IS_SET", &is_set);
    let mut d = Daemon::start_by(command, &device, &plan, &["--no-estimate"]);
    for n in 1..=2 {
        d.scan(0.5);
        assert!(d.order("stop"));
        d.wait("published", |s| s["finished_scans"] == n && s["state"] == "ready");
    }
    let names = ["undated-scan-0001", "undated-scan-0002"];
    assert_eq!(scans(&device), names);
    for name in names {
        let m = manifest(&device, name);
        assert!(m["published"].is_null() && m["began"].is_null() && m["undated"].is_array(), "{m}");
    }
    let first = device.join("scans").join(names[0]).join("manifest.json");
    let text = std::fs::read_to_string(&first).unwrap();
    let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap();
    std::fs::write(&first, text.replace(boot.trim(), "an-earlier-run")).unwrap();

    std::fs::write(&is_set, "").unwrap();
    let s = d.wait("the date", |s| s["last_scan"].as_str().is_some_and(|l| !l.contains("undated")));
    let names = scans(&device);
    assert!(names.len() == 2 && names[1] == "undated-scan-0001", "{names:?}");
    // The year of the machine that runs this, from another source.
    let today = Command::new("date").args(["-u", "+%Y%m%d"]).output().unwrap().stdout;
    let today = String::from_utf8(today).unwrap();
    assert!(names[0].starts_with(today.trim()) && names[0].ends_with("Z-scan-0002"), "{names:?}");
    assert!(s["last_scan"].as_str().unwrap().ends_with(&names[0]), "{s}");
    let m = manifest(&device, &names[0]);
    assert!(names[0].starts_with(m["began"].as_str().unwrap()) && m["undated"].is_null(), "{m}");
    assert!(m["published"].as_str() >= m["began"].as_str(), "{m}");
    // The next one has its date from the beginning, and the next number.
    d.scan(0.5);
    assert!(d.order("stop"));
    d.wait("published", |s| s["finished_scans"] == 3 && s["state"] == "ready");
    assert!(scans(&device)[1].ends_with("Z-scan-0003") && scans(&device)[1].starts_with(today.trim()));
    d.signal("-TERM");
    assert_eq!(d.ended(), Some(0));
}

/// The power is cut at every few writes, syncs and changes of a name in the life of a scan.
#[test]
fn a_cut_now_and_then_is_survived() {
    let scanner = Scanner::new();
    let last = scanner.operations();
    for at in (1..=last).step_by((last / 6).max(1)) {
        scanner.cut(at);
    }
}

/// The same at all of them. Prints their number.
#[test]
#[ignore = "takes minutes: every write, sync and change of a name"]
fn a_cut_at_every_write_is_survived() {
    let scanner = Scanner::new();
    let last = scanner.operations();
    for at in 1..=last {
        scanner.cut(at);
    }
    println!("{last} operations, each cut with three states of the disk");
}

/// How much of what was not synced has reached the disk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Reached {
    All,
    /// Names, but no contents.
    Names,
    Nothing,
}

/// A device folder with two finished scans, of which the older has to make room for the next one.
struct Scanner {
    dir: tempfile::TempDir,
    library: PathBuf,
}

const OLD: [&str; 2] = ["20260101T000000Z-scan-0001", "20260101T000100Z-scan-0002"];

impl Scanner {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let library = preload("preload/power_cut.c", dir.path());
        let template = dir.path().join("template");
        let made = ok(&["replay", &arg(tiny_recording()), "--no-estimate", "--device", &arg(&template)]);
        let scans = template.join("scans");
        std::fs::rename(made.trim(), scans.join(OLD[1])).unwrap();
        std::fs::create_dir(scans.join(OLD[0])).unwrap();
        std::fs::write(scans.join(OLD[0]).join("scan.lscan"), vec![0; 3_000_000]).unwrap();
        std::fs::write(template.join("counter"), "2\n").unwrap();
        Self { dir, library }
    }

    /// Makes a scan with the power cut at operation `at` (0 = never); returns the device folder as it was left, and the log.
    fn run(&self, at: usize) -> (PathBuf, Vec<Vec<String>>) {
        let path = |name: &str| self.dir.path().join(name);
        let (device, kept, log) = (path("device"), path("kept"), path("operations"));
        for folder in [&device, &kept] {
            let _ = std::fs::remove_dir_all(folder);
        }
        let _ = std::fs::remove_file(&log);
        copy(&path("template"), &device);
        std::fs::create_dir(&kept).unwrap();
        let mut command = Command::new(EXECUTABLE);
        command.env("LD_PRELOAD", &self.library).env("CUT_ROOT", &device).env("CUT_KEEP", &kept);
        command.env("CUT_LOG", &log).env("CUT_AT", at.to_string()).process_group(0);
        let plan = format!("{},fast,unplug_at_frame=20", recording());
        let more =
            ["--no-estimate", "--scans", "1", "--set", "daemon.max_folder_mb=3", "--set", "fusion.voxel_size_m=0.02"];
        let mut d = Daemon::start_by(command, &device, &plan, &more);
        let began = Instant::now();
        let mut is_started = false;
        let ended = loop {
            if let Some(ended) = d.child.try_wait().unwrap() {
                break ended;
            }
            if !is_started && state(&device).is_some_and(|s| s == "ready") {
                d.signal("-USR1");
                is_started = true;
            }
            assert!(began.elapsed() < PATIENCE, "{}", d.log());
            std::thread::sleep(Duration::from_millis(10));
        };
        assert!(ended.success() || at > 0, "{}", d.log());
        let text = std::fs::read_to_string(&log).unwrap_or_default();
        (device, text.lines().map(|l| l.split('\t').map(Into::into).collect()).collect())
    }

    /// Number of operations in the life of a scan.
    fn operations(&self) -> usize {
        let (device, log) = self.run(0);
        let names = scans(&device);
        assert!(names.len() == 2 && names.contains(&OLD[1].into()), "the older one is gone: {names:?}");
        assert!(log.iter().any(|l| l[0] == "rename" && l[2].contains("/scans/2")), "publishing is among them: {log:?}");
        log.len()
    }

    fn cut(&self, at: usize) {
        for reached in [Reached::All, Reached::Names, Reached::Nothing] {
            let (device, log) = self.run(at);
            let what = format!("cut at {at} after {:?}, {reached:?} reached the disk", log.last());
            lose(&log, reached);
            restart(&device, &what);
            check(&device, &log, &what);
        }
    }
}

fn state(device: &Path) -> Option<String> {
    Some(status_file(device)?["state"].as_str()?.into())
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap().flatten() {
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy(&entry.path(), &target);
        } else {
            std::fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// Takes back what the power cut lost. Contents are lost down to the length that was synced, names where their folder was not.
fn lose(log: &[Vec<String>], reached: Reached) {
    let mut synced: BTreeMap<PathBuf, u64> = BTreeMap::new();
    let mut dirty: BTreeMap<PathBuf, bool> = BTreeMap::new();
    let mut names: Vec<&[String]> = Vec::new();
    let parent = |path: &str| Path::new(path).parent().unwrap().to_path_buf();
    for line in log {
        let path = PathBuf::from(&line[1]);
        match line[0].as_str() {
            "write" => drop(dirty.insert(path, true)),
            "cut" => {
                let length = synced.entry(path.clone()).or_default();
                *length = (*length).min(line[2].parse().unwrap());
                dirty.insert(path, true);
            }
            "sync" => {
                synced.insert(path.clone(), line[2].parse().unwrap());
                dirty.insert(path, false);
            }
            "syncdir" => {
                // What was in a folder that is gone for good is gone with it.
                let gone: Vec<&String> =
                    names.iter().filter(|l| l[0] == "rmdir" && parent(&l[1]) == path).map(|l| &l[1]).collect();
                names.retain(|l| parent(&l[1]) != path && !gone.iter().any(|g| Path::new(&l[1]).starts_with(g)));
            }
            _ => {
                if line[0] == "rename" {
                    let new = PathBuf::from(&line[2]);
                    let moved = |p: &PathBuf| {
                        p.strip_prefix(&path).map_or(p.clone(), |rest| {
                            if rest.as_os_str().is_empty() { new.clone() } else { new.join(rest) }
                        })
                    };
                    synced = synced.iter().map(|(p, n)| (moved(p), *n)).collect();
                    dirty = dirty.iter().map(|(p, d)| (moved(p), *d)).collect();
                }
                names.push(line);
            }
        }
    }
    if reached == Reached::All {
        return;
    }
    for (path, _) in dirty.iter().filter(|(_, dirty)| **dirty) {
        if let Ok(file) = std::fs::File::options().write(true).open(path) {
            file.set_len(synced.get(path).copied().unwrap_or(0).min(file.metadata().unwrap().len())).unwrap();
        }
    }
    if reached == Reached::Names {
        return;
    }
    for line in names.iter().rev() {
        let restore = |kept: &str, path: &str| {
            if kept != "-" {
                std::fs::hard_link(kept, path).unwrap()
            }
        };
        match line[0].as_str() {
            "create" => std::fs::remove_file(&line[1]).unwrap(),
            "mkdir" => std::fs::remove_dir_all(&line[1]).unwrap(),
            "rmdir" => std::fs::create_dir(&line[1]).unwrap(),
            "unlink" => restore(&line[2], &line[1]),
            _ => {
                std::fs::rename(&line[2], &line[1]).unwrap();
                restore(&line[3], &line[2]);
            }
        }
    }
}

/// Starts the daemon once more; it is ready when what was left is finished or set aside.
fn restart(device: &Path, what: &str) {
    let _ = std::fs::remove_file(device.join("status.json"));
    let mut d = Daemon::start(device, "pattern,fast", &["--no-estimate"]);
    let began = Instant::now();
    while state(device).is_none_or(|s| s != "ready") {
        assert!(d.child.try_wait().unwrap().is_none() && began.elapsed() < PATIENCE, "{what}\n{}", d.log());
        std::thread::sleep(Duration::from_millis(10));
    }
    d.signal("-TERM");
    assert_eq!(d.ended(), Some(0), "{what}");
}

/// Finished scans are whole, nothing is left over, and the scan that was being made is finished or set aside, unless the cut came
/// before it had a folder.
fn check(device: &Path, log: &[Vec<String>], what: &str) {
    assert!(unfinished(device).is_empty(), "{what}");
    let all = common::scans(device);
    let left: Vec<_> = all.iter().filter(|n| n.starts_with('.')).collect();
    assert!(left.is_empty(), "{what}: {left:?} are left");
    assert!(all.contains(&OLD[1].into()), "{what}: {all:?}");
    for name in all.iter().filter(|n| *n != OLD[0]) {
        check_files(device, name, what);
    }
    let is = |line: &Vec<String>, kind: &str, name: &str| {
        line[0] == kind && line[1].contains("/.capture-") && line[1].ends_with(name)
    };
    let named = |folder: PathBuf| {
        let names = std::fs::read_dir(folder).into_iter().flatten().flatten();
        names.filter(|e| e.file_name().to_string_lossy().contains("-scan-0003")).count()
    };
    let (published, aside) = (named(device.join("scans")), named(device.join("aside")));
    let begun = log.iter().position(|l| l[0] == "mkdir" && l[1].contains("/.capture-"));
    let is_begun = begun.is_some_and(|i| log[i..].iter().any(|l| l[0] == "syncdir" && l[1].ends_with("/scans")));
    assert!(
        published + aside <= 1 && (published + aside == 1 || !is_begun),
        "{what}: {published} published, {aside} aside"
    );
    // A scan file that was complete is never set aside.
    let complete = log.iter().position(|l| is(l, "rename", "scan.lscan.part"));
    if complete.is_some_and(|i| log[i..].iter().any(|l| l[0] == "syncdir" && l[1].contains("/.capture-"))) {
        assert_eq!(published, 1, "{what}");
    }
}
