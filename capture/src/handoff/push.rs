//! Finished scans to the other machine.

use crate::device_folder::handed_off::{self, HANDOFF};
use crate::device_folder::manifest;
use crate::device_folder::retention;
use crate::failure::Failure;
use crate::handoff::rsync::{Failed, rsync, run};
use crate::stop::Stop;
use firmware_config::HandoffConfig;
use std::ffi::OsString;
use std::path::Path;

/// How the scans fared.
#[derive(Debug, Default, serde::Serialize)]
pub struct Pushed {
    /// Scans that the other machine confirmed now.
    pub confirmed: usize,
    /// Scans that it has not confirmed.
    pub waiting: usize,
    /// Why not.
    pub problems: Vec<String>,
}

/// Copies every scan that is not confirmed yet, oldest first.
///
/// # Errors
/// The device folder cannot be written, or a signal came.
pub fn push(device: &Path, config: &HandoffConfig, stop: &Stop) -> Result<Pushed, Failure> {
    let mut pushed = Pushed::default();
    let mut is_reachable = true;
    for scan in retention::finished(device) {
        if handed_off::is_confirmed(device, &scan) {
            continue;
        }
        if manifest::is_incomplete(&scan) {
            // Its files change within seconds, or when the daemon starts again.
            pushed.waiting += 1;
            continue;
        }
        stop.check()?;
        let outcome = if is_reachable { copy(device, &scan, config, stop) } else { Ok(false) };
        match outcome {
            Ok(true) => {
                handed_off::confirm(device, &scan)?;
                pushed.confirmed += 1;
                continue;
            }
            Ok(false) => {}
            Err(Failed { failure, is_single }) => {
                stop.check()?;
                is_reachable = is_single;
                pushed.problems.push(format!("{}: {failure}", scan.display()));
            }
        }
        pushed.waiting += 1;
    }
    Ok(pushed)
}

/// Copies a scan, then has both ends compare every byte; true if they are the same.
fn copy(device: &Path, scan: &Path, config: &HandoffConfig, stop: &Stop) -> Result<bool, Failed> {
    // With --relative, what follows the dot is the path on the other side.
    let mut source = OsString::from(device);
    source.push("/./scans/");
    source.push(scan.file_name().unwrap_or_default());
    // Empty: the folder that results come from.
    let results = device.join(HANDOFF).join("./results");
    std::fs::create_dir_all(&results)
        .map_err(|e| Failed { failure: Failure::writing(&results, e), is_single: false })?;
    let target = format!("{}/", config.destination);
    let mut transfer = rsync(config);
    transfer.arg("--").arg(&source).arg(&results).arg(&target);
    run(transfer, stop)?;
    let mut comparison = rsync(config);
    comparison.args(["--dry-run", "--out-format=%i %n", "--"]).arg(&source).arg(&results).arg(&target);
    let differing = run(comparison, stop)?;
    let differing: Vec<&str> = differing.lines().filter(|line| line.starts_with(['<', '>'])).collect();
    if differing.is_empty() {
        return Ok(true);
    }
    let text = format!("the copy differs from it ({}); it is copied again next time", differing.join(", "));
    Err(Failed { failure: Failure::Internal(text), is_single: true })
}
