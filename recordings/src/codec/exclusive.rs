//! Files that one process at a time may have, on one machine or on a file system that several share.

use std::fs::{File, TryLockError};
use std::io::Result;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Opens a file for writing, its contents untouched, and locks it until it is closed; `None` while another process has it.
/// The holder may rename or remove the file. A file system without locks locks nothing.
///
/// # Errors
/// The folder cannot be written.
pub fn open_exclusive(path: &Path) -> Result<Option<File>> {
    loop {
        let file = File::options().write(true).create(true).truncate(false).open(path)?;
        if let Err(TryLockError::WouldBlock) = file.try_lock() {
            return Ok(None);
        }
        // Between opening and locking, the holder may have renamed or removed it.
        let opened = file.metadata()?;
        if std::fs::metadata(path).is_ok_and(|m| (m.dev(), m.ino()) == (opened.dev(), opened.ino())) {
            return Ok(Some(file));
        }
    }
}
