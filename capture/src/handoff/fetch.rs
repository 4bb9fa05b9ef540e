//! Results of the other machine into the folders of their scans.

use crate::device_folder::handed_off::{self, HANDOFF};
use crate::device_folder::replace::{REPLACED, clean, replace};
use crate::device_folder::retention;
use crate::failure::Failure;
use crate::handoff::rsync::{rsync, run};
use crate::stop::Stop;
use firmware_config::HandoffConfig;
use std::path::Path;

/// What came.
#[derive(Debug, Default, serde::Serialize)]
pub struct Fetched {
    /// Scans whose result was replaced.
    pub replaced: Vec<String>,
    /// Results that were not used, and why.
    pub problems: Vec<String>,
}

/// Fetches what is new for scans that were handed off, and puts it in place.
///
/// # Errors
/// The device folder cannot be written, or a signal came.
pub fn fetch(device: &Path, config: &HandoffConfig, stop: &Stop) -> Result<Fetched, Failure> {
    let mut fetched = Fetched::default();
    clean(device);
    let scans: Vec<_> =
        retention::finished(device).into_iter().filter(|s| handed_off::is_confirmed(device, s)).collect();
    if scans.is_empty() {
        return Ok(fetched);
    }
    let incoming = device.join(HANDOFF).join("incoming");
    let _ = std::fs::remove_dir_all(&incoming);
    std::fs::create_dir_all(&incoming).map_err(|e| Failure::writing(&incoming, e))?;

    let name = |scan: &Path| scan.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let wanted = scans.iter().flat_map(|s| REPLACED.map(|file| format!("{}/{file}\n", name(s))));
    let list = incoming.join("wanted");
    std::fs::write(&list, wanted.collect::<String>()).map_err(|e| Failure::writing(&list, e))?;
    let absolute = std::path::absolute(device).map_err(|e| Failure::writing(device, e))?;
    let mut command = rsync(config);
    // What is in place already is not sent.
    command.arg("--ignore-missing-args").arg(format!("--compare-dest={}", absolute.join("scans").display()));
    command.arg(format!("--files-from={}", list.display()));
    command.arg("--").arg(format!("{}/results/", config.destination)).arg(&incoming);
    if let Err(failed) = run(command, stop) {
        stop.check()?;
        fetched.problems.push(failed.failure.to_string());
    }
    for scan in scans {
        let new = incoming.join(name(&scan));
        if REPLACED.iter().any(|file| new.join(file).exists()) {
            match replace(&scan, &new) {
                Ok(()) => fetched.replaced.push(name(&scan)),
                Err(failure) => fetched.problems.push(failure.to_string()),
            }
        }
    }
    let _ = std::fs::remove_dir_all(&incoming);
    Ok(fetched)
}
