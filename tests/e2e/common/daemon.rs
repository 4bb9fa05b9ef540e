//! A daemon on a simulated Kinect.

use super::{EXECUTABLE, arg, run, text};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Upper bound of every wait.
pub const PATIENCE: Duration = Duration::from_secs(300);

/// A daemon; killed at the end if it still runs.
pub struct Daemon {
    pub child: Child,
    pub device: PathBuf,
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Daemon {
    pub fn start(device: &Path, plan: &str, more: &[&str]) -> Self {
        Self::start_by(Command::new(EXECUTABLE), device, plan, more)
    }

    pub fn start_by(mut command: Command, device: &Path, plan: &str, more: &[&str]) -> Self {
        std::fs::create_dir_all(device).unwrap();
        let log = std::fs::File::options().create(true).append(true).open(device.join("log")).unwrap();
        let child = command
            .args(["capture", "--device", &arg(device), "--simulate", plan, "--set", "daemon.min_free_mb=1"])
            .args(more)
            .env_remove("LUMISCAN_DEVICE")
            .env_remove("NOTIFY_SOCKET")
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()
            .unwrap();
        Self { child, device: device.into() }
    }

    pub fn log(&self) -> String {
        std::fs::read_to_string(self.device.join("log")).unwrap_or_default()
    }

    pub fn order(&self, order: &str) -> bool {
        run(&["scan", order, "--device", &arg(&self.device)]).status.success()
    }

    pub fn status(&self) -> Option<Value> {
        let output = run(&["scan", "status", "--device", &arg(&self.device)]);
        serde_json::from_str(&text(&output.stdout)).ok()
    }

    /// Waits until the status is as wanted.
    pub fn wait(&mut self, what: &str, wanted: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        loop {
            if let Some(s) = self.status().filter(&wanted) {
                return s;
            }
            let ended = self.child.try_wait().unwrap();
            assert!(
                ended.is_none() && began.elapsed() < PATIENCE,
                "{what}: {ended:?} {:?}\n{}",
                self.status(),
                self.log()
            );
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    pub fn wait_for(&mut self, state: &str) -> Value {
        self.wait(state, |s| s["state"] == state)
    }

    /// Starts a scan as soon as that is possible.
    pub fn begin(&mut self) {
        let began = Instant::now();
        while !self.order("start") {
            assert!(began.elapsed() < PATIENCE, "{}", self.log());
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Starts a scan and waits until so many seconds of it are in.
    pub fn scan(&mut self, seconds: f64) -> Value {
        self.begin();
        self.wait("scanning", |s| s["scan"]["seconds"].as_f64().is_some_and(|t| t >= seconds))
    }

    pub fn signal(&self, name: &str) {
        assert!(Command::new("kill").args([name, &self.child.id().to_string()]).status().unwrap().success());
    }

    pub fn ended(&mut self) -> Option<i32> {
        let began = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                assert!(!self.log().contains("panicked"), "{}", self.log());
                return status.code();
            }
            assert!(began.elapsed() < PATIENCE, "it does not end\n{}", self.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// The recording that comes with the repository: 5.5 s of a table.
pub fn recording() -> String {
    arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("../recordings/data/tabletop.lrec"))
}

/// Published scans.
pub fn scans(device: &Path) -> Vec<String> {
    super::scans(device).into_iter().filter(|name| !name.starts_with('.')).collect()
}

pub fn manifest(device: &Path, scan: &str) -> Value {
    let path = device.join("scans").join(scan).join("manifest.json");
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

pub fn unfinished(device: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(device.join("scans")).into_iter().flatten().flatten();
    entries.map(|e| e.path()).filter(|p| p.file_name().unwrap().to_string_lossy().starts_with(".capture-")).collect()
}

/// Fails unless the files of a published scan are those that its manifest lists.
pub fn check_files(device: &Path, scan: &str, what: &str) {
    let folder = device.join("scans").join(scan);
    for file in manifest(device, scan)["files"].as_array().unwrap() {
        let bytes = std::fs::read(folder.join(file["name"].as_str().unwrap())).unwrap();
        assert_eq!(file["crc32"], format!("{:08x}", crc32fast::hash(&bytes)), "{what}: {scan}/{file}");
    }
}

/// The contents of `status.json`; `None` until it is there.
pub fn status_file(device: &Path) -> Option<Value> {
    serde_json::from_slice(&std::fs::read(device.join("status.json")).ok()?).ok()
}
