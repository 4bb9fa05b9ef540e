//! The hand-off to another machine: this one, by `sshd` on loopback. Where rsync or sshd is not installed the tests print that they were
//! skipped; `.ci/run` installs both.

#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::daemon::{check_files, manifest};
use common::{arg, json, ok, run, small_scan, text};
use serde_json::Value;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A box with one scan, and a machine that it hands its scans to.
struct Pair {
    dir: tempfile::TempDir,
    sshd: Child,
    port: u16,
    scan: PathBuf,
}

impl Drop for Pair {
    fn drop(&mut self) {
        let _ = self.sshd.kill();
        let _ = self.sshd.wait();
    }
}

impl Pair {
    /// `None`, and says why, where something is not installed.
    fn start(effort: &[&str]) -> Option<Self> {
        let sshd = PathBuf::from("/usr/sbin/sshd");
        let found = |program: &Path, option: &str| Command::new(program).arg(option).output().is_ok();
        if !sshd.exists() || !found(Path::new("rsync"), "--version") || !found(Path::new("ssh-keygen"), "-?") {
            eprintln!("skipped: rsync, sshd or ssh-keygen is not installed");
            return None;
        }
        // The folder of privilege separation, which the service would make.
        let _ = std::fs::create_dir_all("/run/sshd");
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        for key in ["host", "box"] {
            let made =
                Command::new("ssh-keygen").args(["-q", "-t", "ed25519", "-N", "", "-f"]).arg(at(key)).status().unwrap();
            assert!(made.success());
        }
        std::fs::copy(at("box.pub"), at("authorized_keys")).unwrap();
        std::fs::create_dir(at("far")).unwrap();
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let config = format!(
            "Port {port}\nListenAddress 127.0.0.1\nHostKey {}\nAuthorizedKeysFile {}\nPidFile none\nStrictModes no\nUsePAM no\n\
             PasswordAuthentication no\n",
            arg(at("host")),
            arg(at("authorized_keys"))
        );
        std::fs::write(at("sshd_config"), config).unwrap();
        let mut server = Command::new(sshd);
        let server = server.args(["-D", "-e", "-f"]).arg(at("sshd_config")).stderr(Stdio::null());
        let sshd = server.spawn().unwrap();
        let began = Instant::now();
        while std::net::TcpStream::connect(("127.0.0.1", port)).is_err() {
            assert!(began.elapsed() < Duration::from_secs(30), "sshd does not answer");
            std::thread::sleep(Duration::from_millis(50));
        }
        let scan = small_scan(&at("device"), effort);
        Some(Self { dir, sshd, port, scan })
    }

    fn at(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// The copy of a file of the scan.
    fn far(&self, name: &str) -> PathBuf {
        self.at("far/scans").join(self.scan.file_name().unwrap()).join(name)
    }

    /// A remote shell: `{ssh}` in the script is the real one.
    fn shell(&self, script: &str) -> String {
        let ssh = format!(
            "ssh -F none -i {} -p {} -o BatchMode=yes -o StrictHostKeyChecking=no -o UserKnownHostsFile=/dev/null -o LogLevel=ERROR",
            arg(self.at("box")),
            self.port
        );
        let path = self.at("shell");
        std::fs::write(&path, format!("#!/bin/sh\n{}\n", script.replace("{ssh}", &ssh))).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        arg(path)
    }

    fn handoff(&self, script: &str) -> (Option<i32>, String) {
        let user = text(&Command::new("id").arg("-un").output().unwrap().stdout);
        let destination = format!("handoff.destination={}@127.0.0.1:{}", user.trim(), arg(self.at("far")));
        let ssh = format!("handoff.ssh={}", self.shell(script));
        let settings = ["--set", &destination, "--set", &ssh, "--set", "handoff.timeout_s=20"];
        let output = run(&[&["handoff", "--device", &arg(self.at("device"))], &settings[..]].concat());
        (output.status.code(), text(&output.stdout) + &text(&output.stderr))
    }

    fn hands_off(&self, expected: &str) {
        let (code, printed) = self.handoff(PLAIN);
        assert!(code == Some(0) && printed.contains(expected), "{printed}");
    }

    fn is_confirmed(&self) -> bool {
        self.at("device/handoff/confirmed").join(self.scan.file_name().unwrap()).exists()
    }

    fn is_same(&self, name: &str) -> bool {
        std::fs::read(self.far(name)).ok() == Some(std::fs::read(self.scan.join(name)).unwrap())
    }
}

const PLAIN: &str = "exec {ssh} \"$@\"";

#[test]
fn scans_go_and_results_come_back() {
    let Some(pair) = Pair::start(&["--rounds", "1"]) else { return };
    pair.hands_off("1 scans handed off, 0 waiting, 0 results replaced");
    for name in ["scan.lscan", "result.lres", "manifest.json", "trajectory.txt"] {
        assert!(pair.is_same(name), "{name}");
    }
    assert!(pair.is_confirmed() && pair.scan.join("scan.lscan").exists(), "the box keeps its copy");
    pair.hands_off("0 scans handed off, 0 waiting, 0 results replaced");

    // The other machine estimates with more effort.
    let results = pair.at("far/results").join(pair.scan.file_name().unwrap());
    std::fs::create_dir_all(&results).unwrap();
    let place = |name: &str| arg(results.join(name));
    let (result, preview, viewer) = (place("result.lres"), place("preview.png"), place("viewer.html"));
    let estimate = ["estimate", &arg(pair.far("scan.lscan")), "--if-changed", "--rounds", "2", "-o", &result];
    ok(&[&estimate[..], &["--preview", &preview, "--viewer", &viewer]].concat());
    let old = std::fs::read(pair.scan.join("result.lres")).unwrap();
    // A run that was killed left its work.
    let (device, scan) = (pair.at("device"), pair.scan.file_name().unwrap().to_str().unwrap());
    let left = pair.scan.with_file_name(format!(".replacement-{scan}"));
    std::fs::create_dir(&left).unwrap();
    std::fs::write(left.join("result.lres"), b"half").unwrap();
    pair.hands_off("1 results replaced");
    let new = std::fs::read(pair.scan.join("result.lres")).unwrap();
    assert!(new != old && new == std::fs::read(&result).unwrap());
    assert_eq!(std::fs::read(pair.scan.join("viewer.html")).unwrap(), std::fs::read(&viewer).unwrap());
    let manifest = manifest(&device, scan);
    assert_eq!(manifest["files"].as_array().unwrap().len(), 5, "{manifest}");
    check_files(&device, scan, "replaced");
    assert_eq!(manifest["estimator"]["outcome"], "done");
    assert_eq!(manifest["estimator"]["origin"]["scan"].as_str().unwrap().len(), 64);
    assert!(manifest["capture"]["keyframes"].is_u64(), "what is not the estimator's stays");
    assert_eq!(json(&["inspect", &arg(pair.scan.join("result.lres")), "--json"])["kind"], "result");
    pair.hands_off("0 scans handed off, 0 waiting, 0 results replaced");
    assert_eq!(common::scans(&device).len(), 1, "no staging folder is left");

    // A result of another scan, and one that is damaged, are not used.
    let mut other = new.clone();
    let end = other.len() - 100;
    other[end] ^= 1;
    std::fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/../recordings/data/tiny.lscan"), pair.at("tiny.lscan"))
        .unwrap();
    ok(&["estimate", &arg(pair.at("tiny.lscan")), "--rounds", "1"]);
    for bytes in [other, std::fs::read(pair.at("tiny.lres")).unwrap()] {
        std::fs::write(&result, bytes).unwrap();
        let (code, printed) = pair.handoff(PLAIN);
        assert!(code == Some(1) && printed.contains("result.lres"), "{printed}");
        assert!(std::fs::read(pair.scan.join("result.lres")).unwrap() == new);
    }
}

#[test]
fn what_is_cut_in_the_middle_goes_on_later() {
    let Some(pair) = Pair::start(&["--no-estimate"]) else { return };
    let (code, printed) = pair.handoff("head -c 20000 | {ssh} \"$@\"");
    assert!(code == Some(1) && printed.contains("rsync"), "{printed}");
    assert!(!pair.is_confirmed() && !pair.far("scan.lscan").exists(), "half a scan is not a scan");
    pair.hands_off("1 scans handed off");
    assert!(pair.is_confirmed() && pair.is_same("scan.lscan"));
}

#[test]
fn a_copy_that_differs_is_not_confirmed() {
    let Some(pair) = Pair::start(&["--no-estimate"]) else { return };
    // After each transfer a byte of the copy is another.
    let spoil = format!(
        "{{ssh}} \"$@\"; code=$?; printf X | dd of={} bs=1 seek=5000 conv=notrunc 2>&-; exit $code",
        arg(pair.far("scan.lscan"))
    );
    let (code, printed) = pair.handoff(&spoil);
    assert!(code == Some(1) && printed.contains("differs") && printed.contains("scan.lscan"), "{printed}");
    assert!(!pair.is_confirmed());
    // Clocks that are wrong make it look the same: size and time agree.
    let stamp = |path: &Path| Command::new("touch").args(["-d", "@86400"]).arg(path).status().unwrap().success();
    assert!(!pair.is_same("scan.lscan") && stamp(&pair.far("scan.lscan")) && stamp(&pair.scan.join("scan.lscan")));
    pair.hands_off("1 scans handed off");
    assert!(pair.is_confirmed() && pair.is_same("scan.lscan"));
}

#[test]
fn a_key_that_is_revoked_is_said() {
    let Some(pair) = Pair::start(&["--no-estimate"]) else { return };
    std::fs::write(pair.at("authorized_keys"), "").unwrap();
    let (code, printed) = pair.handoff(PLAIN);
    assert!(code == Some(1) && printed.contains("Permission denied") && printed.contains("1 waiting"), "{printed}");
    assert!(!pair.is_confirmed() && pair.scan.join("scan.lscan").exists());
    let status: Value = serde_json::from_slice(&std::fs::read(pair.at("device/handoff/status.json")).unwrap()).unwrap();
    assert_eq!(status["pushed"]["waiting"], 1, "{status}");
    std::fs::copy(pair.at("box.pub"), pair.at("authorized_keys")).unwrap();
    pair.hands_off("1 scans handed off");
}

#[test]
fn without_a_destination_it_says_how_to_name_one() {
    let message = common::fails(2, &["handoff"]);
    assert!(message.contains("handoff.destination"), "{message}");
}
