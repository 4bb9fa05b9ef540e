//! Puts a result that another machine made in the place of the box's own. Readers see the folder as it was or as it will be.

use crate::device_folder::files::{sync, write_file};
use crate::device_folder::manifest::{EstimatorEntry, EstimatorOutcome, MANIFEST, updated};
use crate::failure::Failure;
use recordings::decision::Cut;
use recordings::result::{Estimate, Origin};
use recordings::scan::ScanIdentity;
use rustix::fs::{CWD, RenameFlags, renameat_with};
use std::path::Path;

/// Prefix of a folder that is being filled to replace another.
const REPLACEMENT: &str = ".replacement-";
/// What may come from the other machine.
pub const REPLACED: [&str; 3] = ["result.lres", "preview.png", "viewer.html"];

/// Moves the files of `incoming` that are in [`REPLACED`] to the published folder of their scan.
///
/// # Errors
/// The result is damaged or that of another scan, or the device folder cannot be written. Nothing is changed then.
pub fn replace(scan: &Path, incoming: &Path) -> Result<(), Failure> {
    let new = |name: &str| incoming.join(name).exists();
    let result = if new("result.lres") { incoming } else { scan }.join("result.lres");
    let entry = describe(&result)?;
    let made_from = entry.origin.as_ref().map(|o| o.scan.as_str());
    if new("result.lres") && made_from != Some(&ScanIdentity::read(&scan.join("scan.lscan"))?.digest) {
        let (result, scan) = (result.display(), scan.display());
        return Err(Failure::Input(format!("{result}: it was not made from {scan}; estimate the copy of that scan")));
    }

    let name = scan.file_name().unwrap_or_default().to_string_lossy();
    let staging = scan.with_file_name(format!("{REPLACEMENT}{name}"));
    let replaced = fill(&staging, scan, incoming, &entry).and_then(|()| {
        // Both names exist all the time.
        renameat_with(CWD, &staging, CWD, scan, RenameFlags::EXCHANGE).map_err(|e| Failure::writing(scan, e))?;
        scan.parent().map_or(Ok(()), sync)
    });
    // The old folder, or the new one that could not be put in place.
    let _ = std::fs::remove_dir_all(&staging);
    replaced
}

/// Removes what a process that was killed left of a replacement. Nothing but links and copies is in it.
pub fn clean(device: &Path) {
    let entries = std::fs::read_dir(device.join("scans")).into_iter().flatten().flatten();
    for entry in entries.filter(|e| e.file_name().to_string_lossy().starts_with(REPLACEMENT)) {
        let _ = std::fs::remove_dir_all(entry.path());
    }
}

/// What the manifest says of a result of which nothing but its file is known.
fn describe(result: &Path) -> Result<EstimatorEntry, Failure> {
    let estimate = Estimate::read(result)?;
    let is_partial = estimate.cuts.iter().any(Cut::is_abandoned);
    let outcome = if is_partial { EstimatorOutcome::Partial } else { EstimatorOutcome::Done };
    let mut entry = EstimatorEntry { outcome, origin: Origin::read(result)?, ..EstimatorEntry::default() };
    entry.describe(&estimate);
    Ok(entry)
}

/// The folder as it will be: links to what stays, the new files, their manifest.
fn fill(staging: &Path, scan: &Path, incoming: &Path, entry: &EstimatorEntry) -> Result<(), Failure> {
    let failed = |e: std::io::Error| Failure::writing(staging, e);
    std::fs::create_dir(staging).map_err(failed)?;
    for name in REPLACED.iter().filter(|name| incoming.join(name).exists()) {
        sync(&incoming.join(name))?;
        std::fs::rename(incoming.join(name), staging.join(name)).map_err(failed)?;
    }
    for file in std::fs::read_dir(scan).map_err(failed)? {
        let name = file.map_err(failed)?.file_name();
        if name != MANIFEST && !staging.join(&name).exists() {
            std::fs::hard_link(scan.join(&name), staging.join(&name)).map_err(failed)?;
        }
    }
    write_file(&staging.join(MANIFEST), updated(scan, staging, entry)?.as_bytes())?;
    sync(staging)
}
