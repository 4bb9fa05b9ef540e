//! `lumiscan check`: tests whether this machine is fit for scanning, and names remedies.

use crate::cli;
use crate::commands::output::print;
use crate::commands::output::print_json;
use crate::commands::settings::load;
use crate::device_folder::disk;
use crate::failure::Failure;
use crate::kinect::transport::{Found, UsbError};
use crate::memory;
use crate::sources::sensor;
use estimator::Options;
use estimator::budget::cost_model::Size;
use estimator::budget::{Done, Plan, WallClock, at_quality};
use firmware_config::kinect_models::{MAX_ISO_PACKET, PACKETS_PER_TRANSFER, TRANSFERS};
use firmware_config::{Config, memory_plan};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Verdict of one test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Verdict {
    /// Good.
    Ok,
    /// Works, but could be better.
    Warning,
    /// Does not work.
    Failed,
}

/// Result of one test.
#[derive(Debug, Serialize)]
struct Finding {
    what: &'static str,
    verdict: Verdict,
    detail: String,
    /// What to do about it.
    #[serde(skip_serializing_if = "String::is_empty")]
    remedy: String,
}

fn finding(what: &'static str, verdict: Verdict, detail: impl Into<String>, remedy: impl Into<String>) -> Finding {
    let remedy = if verdict == Verdict::Ok { String::new() } else { remedy.into() };
    Finding { what, verdict, detail: detail.into(), remedy }
}

/// Memory that the kernel must grant for isochronous transfers, in MB.
const USBFS_MB: u64 = (2 * TRANSFERS * PACKETS_PER_TRANSFER * MAX_ISO_PACKET) as u64 / 1_000_000 + 1;
/// Typical upper bound of a published scan in bytes.
const SCAN_BYTES: u64 = 150_000_000;
/// A typical scan, for the estimate of the estimator's time.
const TYPICAL_SCAN: Size = Size {
    scanned: 60_000.0,
    remeshed: true,
    vertices: 60_000.0,
    keyframes: 60.0,
    pixels: 640.0 * 480.0,
    witnesses: 5.0,
};

/// Runs the command.
pub fn run(args: &cli::Check, as_json: bool) -> Result<(), Failure> {
    let config = load(&args.settings)?;
    let mut bus = sensor::bus(args.simulate.as_ref())?;
    let listed = bus.list();
    let mut findings = vec![sensor_found(&listed)];
    let found = listed.clone().unwrap_or_default();
    if let Some(kinect) = found.first() {
        findings.push(camera_settings(kinect, &config));
        findings.push(controller(kinect, Path::new("/sys/bus/usb/devices")));
    }
    findings.push(usbfs_memory(Path::new("/sys/module/usbcore/parameters/usbfs_memory_mb")));
    findings.extend(disk_findings(&args.device, &config));
    findings.push(memory_finding(&config));
    findings.push(speed(&config));

    if as_json {
        print_json(&findings)?;
    } else {
        for f in &findings {
            let mark = match f.verdict {
                Verdict::Ok => "ok     ",
                Verdict::Warning => "warning",
                Verdict::Failed => "FAILED ",
            };
            print(&format!("{mark}  {:<12} {}", f.what, f.detail))?;
            if !f.remedy.is_empty() {
                print(&format!("         {:<12} → {}", "", f.remedy))?;
            }
        }
        print("\nmemory plan of the capture process:")?;
        for part in memory_plan(&config) {
            print(&format!("  {:>8.1} MB  {}", part.bytes as f64 / 1e6, part.name))?;
        }
    }
    if found.is_empty() {
        return Err(sensor::failure(listed.err().unwrap_or(UsbError::NoDevice)));
    }
    let failed: Vec<_> = findings.iter().filter(|f| f.verdict == Verdict::Failed).map(|f| f.what).collect();
    if failed.is_empty() { Ok(()) } else { Err(Failure::Internal(format!("not ready: {}", failed.join(", ")))) }
}

fn sensor_found(listed: &Result<Vec<Found>, UsbError>) -> Finding {
    let found = match listed {
        Ok(found) => found.as_slice(),
        Err(e) => return finding("kinect", Verdict::Failed, e.problem(), e.remedy()),
    };
    let remedy = "plug in a Kinect V1 and its power supply; without its 12 V only the motor shows";
    let Some(k) = found.first() else { return finding("kinect", Verdict::Failed, "no Kinect is plugged in", remedy) };
    let name = format!("{} {} on bus {}", k.model.name(), k.serial, k.bus);
    if !k.accessible {
        let remedy = "install 60-lumiscan.rules and join group lumiscan (firmware-config/appliance/INSTALL.md)";
        return finding("kinect", Verdict::Failed, format!("this user may not open {name}"), remedy);
    }
    if found.len() > 1 {
        let remedy = "name one with kinect.serial; each needs a USB 2 controller of its own";
        return finding(
            "kinect",
            Verdict::Warning,
            format!("{} Kinects; the first is used: {name}", found.len()),
            remedy,
        );
    }
    finding("kinect", Verdict::Ok, name, "")
}

/// Whether this camera has settings of its own.
fn camera_settings(k: &Found, config: &Config) -> Finding {
    let (camera, own) = config.camera_of(&k.serial);
    let response = firmware_config::kinect::response_text(camera.response);
    if own {
        return finding(
            "camera",
            Verdict::Ok,
            format!("settings of its own for {}, response {response}", k.serial),
            "",
        );
    }
    let detail = format!(
        "defaults: fx {} fy {} cx {} cy {}, {} distortion, depth–colour offset {} ms, response {response}",
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        if [camera.k1, camera.k2, camera.p1, camera.p2, camera.k3] == [0.0; 5] { "no" } else { "with" },
        camera.depth_to_color_offset_ms
    );
    finding(
        "camera",
        Verdict::Warning,
        detail,
        format!(
            "calibrate it and add a table [camera.{}] to the settings; `lumiscan inspect` of a result says whether the \
             response fits its pictures",
            k.serial
        ),
    )
}

/// Other devices on the Kinect's bus: its two streams reserve 246 of a USB 2 controller's 480 Mb/s.
fn controller(k: &Found, sysfs: &Path) -> Finding {
    let read = |dir: &Path, name: &str| std::fs::read_to_string(dir.join(name)).unwrap_or_default().trim().to_owned();
    let prefix = format!("{}-", k.bus);
    let mut others = Vec::new();
    for entry in std::fs::read_dir(sysfs).into_iter().flatten().flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        // Interfaces have a colon; hubs are class 9; Microsoft's are the Kinect's own parts.
        let dir = entry.path();
        if name.starts_with(&prefix)
            && !name.contains(':')
            && read(&dir, "bDeviceClass") != "09"
            && read(&dir, "idVendor") != "045e"
        {
            others.push(format!(
                "{} {}",
                read(&dir, "idVendor") + ":" + &read(&dir, "idProduct"),
                read(&dir, "product")
            ));
        }
    }
    let speed = read(&sysfs.join(format!("usb{}", k.bus)), "speed");
    if !others.is_empty() {
        let remedy = "plug the Kinect into a USB 2 controller of its own; another port may be on another controller";
        return finding("controller", Verdict::Warning, format!("shared with {}", others.join(", ")), remedy);
    }
    if speed.parse::<u32>().is_ok_and(|s| s < 480) {
        return finding(
            "controller",
            Verdict::Failed,
            format!("{speed} Mb/s"),
            "the Kinect needs 480 Mb/s: use a USB 2 port",
        );
    }
    finding("controller", Verdict::Ok, "no other device shares it", "")
}

fn usbfs_memory(parameter: &Path) -> Finding {
    let Some(mb) = std::fs::read_to_string(parameter).ok().and_then(|t| t.trim().parse::<u64>().ok()) else {
        return finding("usbfs memory", Verdict::Warning, "the kernel does not say", "load the module usbcore");
    };
    // 0 means no limit.
    let verdict = if mb == 0 || mb >= 4 * USBFS_MB { Verdict::Ok } else { Verdict::Failed };
    let remedy = "boot with usbcore.usbfs_memory_mb=16";
    finding("usbfs memory", verdict, format!("{mb} MB, {USBFS_MB} MB are used"), remedy)
}

fn disk_findings(device: &Path, config: &Config) -> Vec<Finding> {
    // The device folder may not exist yet.
    let folder: PathBuf = device.ancestors().find(|a| a.is_dir()).unwrap_or(Path::new(".")).into();
    let mut findings = Vec::new();
    match disk::free_bytes(&folder) {
        Ok(free) => {
            let needed = u64::from(config.daemon.min_free_mb) * 1_000_000 + SCAN_BYTES;
            let verdict = if free > 4 * needed {
                Verdict::Ok
            } else if free > needed {
                Verdict::Warning
            } else {
                Verdict::Failed
            };
            let scans = free.saturating_sub(needed - SCAN_BYTES) / SCAN_BYTES;
            let detail = format!("{:.1} GB free, room for about {scans} scans", free as f64 / 1e9);
            findings.push(finding("disk", verdict, detail, "free space, or choose another device folder"));
        }
        Err(e) => findings.push(finding("disk", Verdict::Failed, e.to_string(), "choose another device folder")),
    }
    match disk::write_speed(&folder) {
        Ok(speed) => {
            let verdict = if speed > 27e6 { Verdict::Ok } else { Verdict::Warning };
            let detail = format!("{:.0} MB/s written", speed / 1e6);
            findings.push(finding(
                "disk speed",
                verdict,
                detail,
                "scans need 5 MB/s; `record` needs 20, `record --raw` 27",
            ));
        }
        Err(e) => findings.push(finding("disk speed", Verdict::Failed, e.to_string(), "choose another device folder")),
    }
    findings
}

fn memory_finding(config: &Config) -> Finding {
    let plan: u64 = memory_plan(config).iter().map(|p| p.bytes).sum();
    let estimator = u64::from(config.daemon.estimator_limit_mb) * 1_000_000;
    let total = memory::machine_bytes().unwrap_or(u64::MAX);
    let shown = format!(
        "plan {} MB for capture, {} MB for the estimator; the machine has {} MB",
        plan / 1_000_000,
        estimator / 1_000_000,
        total / 1_000_000
    );
    if let Err(e) = memory::planned(config) {
        return finding("memory", Verdict::Failed, shown, e.to_string());
    }
    let verdict = if plan + estimator < total / 10 * 9 { Verdict::Ok } else { Verdict::Failed };
    finding("memory", verdict, shown, "lower fusion.pool_blocks and daemon.estimator_limit_mb")
}

/// Whether the estimator's own plan for a typical scan fits the daemon's budget on this machine.
fn speed(config: &Config) -> Finding {
    let clock = WallClock::start();
    let options = Options {
        budget: Duration::from_secs_f64(config.daemon.budget_s),
        rounds: None,
        reference: None,
        memory_mb: None,
    };
    let plan = Plan::new(&clock, &options, &at_quality(&config.estimator), TYPICAL_SCAN, Done::default());
    let verdict = if plan.cuts().is_empty() { Verdict::Ok } else { Verdict::Warning };
    let detail = format!(
        "light and materials of {:.0} vertices and {:.0} keyframes need about {:.0} s, daemon.budget_s allows {:.0}",
        TYPICAL_SCAN.vertices,
        TYPICAL_SCAN.keyframes,
        plan.needed_seconds(),
        config.daemon.budget_s
    );
    finding("speed", verdict, detail, "the estimator keeps to the budget by doing less, and records what it cut")
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_config::kinect_models::Model;

    fn kinect() -> Found {
        Found { model: Model::K1414, serial: "A1".into(), bus: 3, path: "1.2".into(), address: 5, accessible: true }
    }

    #[test]
    fn permissions_and_defaults_are_reported_with_a_remedy() {
        assert_eq!(sensor_found(&Ok(Vec::new())).verdict, Verdict::Failed);
        let unpowered = sensor_found(&Err(UsbError::NoPower));
        assert!(unpowered.verdict == Verdict::Failed && unpowered.remedy == "plug it in", "{unpowered:?}");
        let locked = sensor_found(&Ok(vec![Found { accessible: false, ..kinect() }]));
        assert!(locked.verdict == Verdict::Failed && locked.remedy.contains("rules"));
        let defaults = camera_settings(&kinect(), &Config::default());
        assert!(defaults.verdict == Verdict::Warning && defaults.detail.contains("fx 525"), "{defaults:?}");
        let own = Config::from_toml("[camera.A1]\nfx = 520").unwrap();
        assert_eq!(camera_settings(&kinect(), &own).verdict, Verdict::Ok);
    }

    #[test]
    fn a_shared_controller_is_found() {
        let sysfs = tempfile::tempdir().unwrap();
        let device = |name: &str, class: &str, vendor: &str| {
            let dir = sysfs.path().join(name);
            std::fs::create_dir(&dir).unwrap();
            for (file, value) in [("bDeviceClass", class), ("idVendor", vendor), ("speed", "480")] {
                std::fs::write(dir.join(file), format!("{value}\n")).unwrap();
            }
        };
        device("usb3", "09", "1d6b");
        device("3-1", "09", "0409");
        device("3-1.2", "00", "045e");
        device("4-1", "00", "1234");
        assert_eq!(controller(&kinect(), sysfs.path()).verdict, Verdict::Ok);
        device("3-2", "00", "1234");
        assert_eq!(controller(&kinect(), sysfs.path()).verdict, Verdict::Warning);
    }

    #[test]
    fn too_little_usbfs_memory_fails() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("p");
        for (text, verdict) in
            [("16\n", Verdict::Ok), ("0", Verdict::Ok), ("1", Verdict::Failed), ("x", Verdict::Warning)]
        {
            std::fs::write(&file, text).unwrap();
            assert_eq!(usbfs_memory(&file).verdict, verdict, "{text}");
        }
    }
}
