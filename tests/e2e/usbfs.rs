//! The executable with its real libusb on an emulated usbfs: `tests/usbfs/kinect_usbfs.c`, built here and preloaded,
//! answers its system calls as Linux and a Kinect would, and plays packets that the simulated Kinect was recorded with.

#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::{EXECUTABLE, arg, ok, preload, text};
use recordings::recording::{Event, RecordingReader};
use recordings::types::UsbPacket;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(120);

/// What every test uses: the library and the packets it plays.
struct Stage {
    _folder: tempfile::TempDir,
    library: PathBuf,
    play: PathBuf,
    /// Control traffic first, then packets of both endpoints.
    packets: Vec<UsbPacket>,
}

fn stage() -> &'static Stage {
    static STAGE: OnceLock<Stage> = OnceLock::new();
    STAGE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let (library, play) = (preload("usbfs/kinect_usbfs.c", folder.path()), folder.path().join("play"));
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        let source = arg(folder.path().join("packets.lrec"));
        let plan = format!("{},fast", arg(here.join("../recordings/data/tabletop.lrec")));
        ok(&["record", &source, "--raw", "--seconds", "3.6", "--simulate", &plan]);
        let packets = packets(Path::new(&source));
        let mut bytes = Vec::new();
        for p in &packets {
            bytes.extend_from_slice(&[p.endpoint, 0]);
            bytes.extend_from_slice(&(p.data.len() as u16).to_le_bytes());
            bytes.extend_from_slice(&p.data);
        }
        std::fs::write(&play, bytes).unwrap();
        std::fs::remove_file(source).unwrap();
        Stage { _folder: folder, library, play, packets }
    })
}

fn packets(path: &Path) -> Vec<UsbPacket> {
    let mut reader = RecordingReader::open(path).unwrap();
    let mut packets = Vec::new();
    while let Some(event) = reader.next_event().unwrap() {
        if let Event::Packet(p) = event {
            packets.push(p);
        }
    }
    packets
}

/// A machine with a Kinect 1414 below a hub, and what goes wrong with it.
struct Machine {
    root: tempfile::TempDir,
    faults: &'static str,
}

impl Machine {
    fn new(faults: &'static str) -> Self {
        let machine = Self { root: tempfile::tempdir().unwrap(), faults };
        let nodes = machine.root.path().join("dev/bus/usb/001");
        std::fs::create_dir_all(&nodes).unwrap();
        // Root hub, hub, camera (two isochronous endpoints of 2 × 960 bytes), motor.
        let stream = |endpoint| [7, 5, endpoint, 0x01, 0xc0, 0x0b, 1];
        let endpoints = [stream(0x81), stream(0x82)].concat();
        machine.plug("usb1", 1, &device(0x1d6b, 0x0002, 0x0510, 9, 0), &configuration(9, &[], &[]));
        machine.plug("1-1", 2, &device(0x0409, 0x005a, 0x0100, 9, 0), &configuration(9, &[], &[]));
        if faults.contains("k4w") {
            // Streams on an alternate setting; the audio part waits for firmware.
            let streams = [&[9, 4, 0, 1, 2, 0xff, 0xff, 0xff, 0][..], &endpoints].concat();
            machine.plug("1-1.1", 3, &device(0x045e, 0x02bf, 0x010a, 0, 3), &configuration(0xff, &[], &streams));
            machine.plug("1-1.2", 4, &device(0x045e, 0x02be, 0x0100, 0, 0), &configuration(0xff, &[], &[]));
        } else {
            machine.plug("1-1.1", 3, &device(0x045e, 0x02ae, 0x010b, 0, 3), &configuration(0xff, &endpoints, &[]));
            machine.plug("1-1.2", 4, &device(0x045e, 0x02b0, 0x0105, 0, 0), &configuration(0xff, &[], &[]));
        }
        machine
    }

    fn plug(&self, name: &str, number: u8, device: &[u8], configuration: &[u8]) {
        let folder = self.root.path().join("sys/bus/usb/devices").join(name);
        std::fs::create_dir_all(&folder).unwrap();
        let write = |file: &str, content: &[u8]| std::fs::write(folder.join(file), content).unwrap();
        write("busnum", b"1\n");
        write("devnum", format!("{number}\n").as_bytes());
        write("speed", b"480\n");
        write("bConfigurationValue", b"1\n");
        write("bDeviceClass", format!("{:02x}\n", device[4]).as_bytes());
        write("idVendor", format!("{:02x}{:02x}\n", device[9], device[8]).as_bytes());
        write("descriptors", &[device, configuration].concat());
        std::fs::write(self.root.path().join(format!("dev/bus/usb/001/{number:03}")), b"").unwrap();
    }

    fn command(&self, args: &[&str]) -> Command {
        let stage = stage();
        let mut command = Command::new(EXECUTABLE);
        command
            .args(args)
            .env("LD_PRELOAD", &stage.library)
            .env("KINECT_PLAY", &stage.play)
            .env("KINECT_ROOT", self.root.path())
            .env("KINECT_LOG", self.root.path().join("log"))
            .env("KINECT_FAULTS", self.faults)
            .env_remove("LUMISCAN_DEVICE")
            .env_remove("NOTIFY_SOCKET")
            .stdin(Stdio::null());
        command
    }

    fn run(&self, args: &[&str]) -> Output {
        let output = self.command(args).output().unwrap();
        assert!(!text(&output.stderr).contains("panicked"), "{}", text(&output.stderr));
        output
    }

    fn json(&self, args: &[&str]) -> Value {
        let output = self.run(args);
        assert!(output.status.success(), "{}", text(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    }

    /// What the Kinect and the kernel saw; nothing of it may be a complaint.
    fn log(&self) -> Vec<String> {
        let log = std::fs::read_to_string(self.root.path().join("log")).unwrap_or_default();
        assert!(!log.contains("complaint"), "{log}");
        log.lines().map(str::to_owned).collect()
    }
}

fn device(vendor: u16, product: u16, release: u16, class: u8, serial: u8) -> [u8; 18] {
    let ([v0, v1], [p0, p1], [r0, r1]) = (vendor.to_le_bytes(), product.to_le_bytes(), release.to_le_bytes());
    [18, 1, 0x00, 0x02, class, 0, 0, 64, v0, v1, p0, p1, r0, r1, 2, 1, serial, 1]
}

/// One interface with these endpoints, and further settings of it.
fn configuration(class: u8, endpoints: &[u8], settings: &[u8]) -> Vec<u8> {
    let length = (18 + endpoints.len() + settings.len()) as u8;
    let interface = [9, 4, 0, 0, endpoints.len() as u8 / 7, class, class, class, 0];
    [&[9, 2, length, 0, 1, 1, 0, 0xc0, 8][..], &interface, endpoints, settings].concat()
}

/// A session as it should be: found by its descriptors and its string, the kernel's driver detached and given back,
/// registers in order, transfers before them, and every packet as it was sent.
#[test]
fn a_session_on_usbfs_is_right_in_every_step() {
    let machine = Machine::new("");
    let listed = machine.json(&["--json", "list"]);
    assert_eq!(listed[0]["serial"], "A00366A08793039A", "{listed}");
    assert_eq!((&listed[0]["model"], &listed[0]["path"]), (&"Kinect V1 (1414)".into(), &"1.1".into()), "{listed}");
    let path = machine.root.path().join("a.lrec");
    let c = machine.json(&["--json", "record", &arg(&path), "--raw", "--seconds", "2"]);
    let log = machine.log();
    let writes: Vec<_> = log.iter().filter_map(|l| l.strip_prefix("write ")).collect();
    assert_eq!(writes[..7], ["105=0", "6=0", "12=3", "13=1", "14=1e", "6=2", "17=0"]);
    assert_eq!(writes[7..], ["5=0", "c=0", "d=1", "e=1e", "5=1", "47=0", "6=0", "5=0"]);
    let rest: Vec<_> = log.iter().filter(|l| !l.starts_with("write ")).collect();
    assert_eq!(rest, ["detached", "claimed", "led 4", "led 1", "released", "attached"]);

    let recorded = packets(&path);
    let dropped = c["counters"]["dropped_packets"].as_u64().unwrap();
    for endpoint in [0x81, 0x82] {
        let mut sent = stage().packets.iter().filter(|p| p.endpoint == endpoint);
        let got: Vec<_> = recorded.iter().filter(|p| p.endpoint == endpoint).collect();
        assert!(got.len() > 4500 || dropped > 0, "{c}");
        // In order, byte for byte; a machine that is far too busy may lose some, but none silently.
        let mut skipped = 0;
        for packet in &got {
            skipped += sent.by_ref().take_while(|s| s.data != packet.data).count() as u64;
        }
        assert!(skipped <= dropped, "{skipped} of endpoint {endpoint:#x} are missing, {dropped} are said to be");
    }
    // Commands and their replies stand in the recording, so that it can be replayed.
    assert_eq!(recorded.iter().filter(|p| p.endpoint == 0x00).count(), 4 + 13);
}

/// Lost packets, both kinds of "not ready", and replies of a session before.
#[test]
fn losses_are_counted_and_slow_replies_waited_for() {
    let machine = Machine::new("loss=97 not_ready=5 stale=3");
    let path = arg(machine.root.path().join("a.lrec"));
    let c = machine.json(&["--json", "record", &path, "--seconds", "2"])["counters"].clone();
    let log = machine.log();
    let lost = |what: &str| log.iter().filter(|l| l.starts_with(what)).count() as i64;
    let n = |stream: &str, key: &str| c[stream][key].as_i64().unwrap();
    assert!(lost("lost") > 100, "{c}");
    // The last transfers came back after the count was taken.
    let flagged = c["bad_status"].as_i64().unwrap();
    assert!((0..=10).contains(&(lost("lost") - flagged)), "{flagged} of {}", lost("lost"));
    for (stream, name) in [("color", "lost 81"), ("depth", "lost 82")] {
        let unseen = lost(name) - n(stream, "missing");
        assert!((0..=10).contains(&unseen), "{stream}: {} {c}", lost(name));
        assert!(n(stream, "incomplete_frames") > 20 && n(stream, "resyncs") == 0, "{c}");
    }
}

/// A Kinect for Windows streams on another setting of its interface, and its audio part, which has no firmware, is left
/// alone.
#[test]
fn another_model_is_driven_by_its_descriptors() {
    let machine = Machine::new("k4w");
    let path = arg(machine.root.path().join("a.lrec"));
    let c = machine.json(&["--json", "record", &path, "--seconds", "1"]);
    assert!(c["counters"]["depth"]["frames"].as_u64().unwrap() >= 15, "{c}");
    let log = machine.log();
    let steps: Vec<_> = log.iter().filter(|l| !l.starts_with("write ")).collect();
    assert_eq!(steps, ["detached", "claimed", "alternate 1", "released", "attached"]);
}

/// `check` sees the machine as it is: sensor, controller, and what is plugged in beside.
#[test]
fn check_looks_at_the_bus() {
    let machine = Machine::new("");
    let findings = |what: &str| -> Value {
        let folder = arg(machine.root.path());
        let all: Value =
            serde_json::from_slice(&machine.run(&["--json", "check", "--device", &folder]).stdout).unwrap();
        all.as_array().unwrap().iter().find(|f| f["what"] == what).unwrap().clone()
    };
    assert_eq!(findings("kinect")["verdict"], "ok");
    assert_eq!(findings("controller")["verdict"], "ok");
    machine.plug("1-2", 9, &device(0x0951, 0x1666, 0x0100, 0, 0), &configuration(8, &[], &[]));
    let shared = findings("controller");
    assert!(shared["verdict"] == "warning" && shared["detail"].as_str().unwrap().contains("0951"), "{shared}");
    assert!(shared["remedy"].as_str().unwrap().contains("of its own"), "{shared}");
}

/// A Kinect so slow to answer that its frames overflow the queue while it is started: what is taken has no hole.
#[test]
fn a_slow_start_loses_no_packet() {
    let machine = Machine::new("not_ready=60");
    let path = arg(machine.root.path().join("a.lrec"));
    let c = machine.json(&["--json", "record", &path, "--seconds", "1"])["counters"].clone();
    assert_eq!((&c["depth"]["incomplete_frames"], &c["color"]["incomplete_frames"]), (&0.into(), &0.into()), "{c}");
    assert!(c["depth"]["dropped_frames"] == 0 && c["depth"]["resyncs"] == 0, "{c}");
    machine.log();
}

#[test]
fn pulling_the_plug_leaves_a_complete_recording() {
    let machine = Machine::new("unplug=8000");
    let path = arg(machine.root.path().join("a.lrec"));
    let output = machine.run(&["record", &path]);
    assert_eq!(output.status.code(), Some(3), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("unplugged"), "{}", text(&output.stderr));
    ok(&["inspect", &path]);
    assert!(machine.log().iter().any(|l| l == "unplugged"));
    // All parts are gone.
    let output = machine.run(&["list"]);
    assert!(output.status.code() == Some(3) && text(&output.stderr).contains("no Kinect"), "{}", text(&output.stderr));
}

#[test]
fn what_keeps_a_kinect_from_working_is_named() {
    for (faults, words) in
        [("deaf", "did not answer"), ("full", "no bandwidth"), ("busy", "another program uses the Kinect")]
    {
        let machine = Machine::new(faults);
        let output = machine.run(&["record", &arg(machine.root.path().join("a.lrec"))]);
        assert_eq!(output.status.code(), Some(3), "{faults}: {}", text(&output.stderr));
        assert!(text(&output.stderr).contains(words), "{faults}: {}", text(&output.stderr));
        machine.log();
    }
    let unpowered = Machine::new("");
    std::fs::remove_dir_all(unpowered.root.path().join("sys/bus/usb/devices/1-1.1")).unwrap();
    let output = unpowered.run(&["list"]);
    assert!(output.status.code() == Some(3) && text(&output.stderr).contains("12 V"), "{}", text(&output.stderr));
}

/// The daemon scans, loses its Kinect, publishes what there is, finds it again, and scans again.
#[test]
fn the_daemon_survives_the_plug_on_usbfs() {
    let machine = Machine::new("unplug=14000 replug=300 not_ready=2");
    let device = machine.root.path().join("device");
    let device_text = arg(&device);
    let args = ["capture", "--device", &device_text, "--no-estimate", "--set", "daemon.min_free_mb=1"];
    let log = std::fs::File::create(machine.root.path().join("err")).unwrap();
    let mut daemon = Running(machine.command(&args).stdout(Stdio::null()).stderr(log).spawn().unwrap());
    let status = || {
        let output = machine.command(&["scan", "status", "--device", &device_text]).output().unwrap();
        serde_json::from_slice::<Value>(&output.stdout).unwrap_or_default()
    };
    let mut wait = |what: &str, wanted: &dyn Fn(&Value) -> bool| {
        let began = Instant::now();
        while !wanted(&status()) {
            let ended = daemon.0.try_wait().unwrap();
            let said = std::fs::read_to_string(machine.root.path().join("err")).unwrap();
            assert!(ended.is_none() && began.elapsed() < PATIENCE, "{what}: {ended:?} {} {said}", status());
            std::thread::sleep(Duration::from_millis(50));
        }
        status()
    };
    let order = |word| machine.run(&["scan", word, "--device", &device_text]).status.success();
    wait("ready", &|s| s["state"] == "ready");
    assert!(order("start"));
    let s = wait("published", &|s| s["finished_scans"] == 1 && s["state"] == "ready");
    assert!(s["last_error"].as_str().unwrap().contains("unplugged"), "{s}");
    assert!(order("start"));
    wait("scanning", &|s| s["scan"]["fused_pairs"].as_u64().is_some_and(|n| n >= 3));
    assert!(order("stop"));
    wait("published", &|s| s["finished_scans"] == 2 && s["state"] == "ready");
    let log = machine.log();
    let steps: Vec<_> = log.iter().filter(|l| !l.starts_with("write ")).collect();
    // Red until the next scan begins.
    let expected = ["unplugged", "plugged", "detached", "claimed", "led 2", "led 4", "led 3", "released", "attached"];
    let start = steps.iter().position(|l| *l == "unplugged").unwrap();
    let said = std::fs::read_to_string(machine.root.path().join("err")).unwrap();
    assert_eq!(steps[start..start + expected.len()], expected, "{} {said}", status());
}

struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
