//! Which scans another machine has confirmed to hold: an empty file each, `<device>/handoff/confirmed/<scan>`.

use crate::device_folder::files::write_file;
use crate::failure::Failure;
use std::path::{Path, PathBuf};

/// Folder of the hand-off in the device folder.
pub const HANDOFF: &str = "handoff";

/// True if the other machine has confirmed the scan in this folder.
#[must_use]
pub fn is_confirmed(device: &Path, scan: &Path) -> bool {
    mark(device, scan).exists()
}

/// Notes that it has.
///
/// # Errors
/// The device folder cannot be written.
pub fn confirm(device: &Path, scan: &Path) -> Result<(), Failure> {
    let mark = mark(device, scan);
    if let Some(folder) = mark.parent() {
        std::fs::create_dir_all(folder).map_err(|e| Failure::writing(folder, e))?;
    }
    write_file(&mark, b"")
}

/// Forgets a scan that was removed.
pub fn forget(device: &Path, scan: &Path) {
    let _ = std::fs::remove_file(mark(device, scan));
}

fn mark(device: &Path, scan: &Path) -> PathBuf {
    device.join(HANDOFF).join("confirmed").join(scan.file_name().unwrap_or_default())
}
