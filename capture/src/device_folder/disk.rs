//! Free space and write speed of a disk.

use crate::failure::Failure;
use firmware_config::DaemonConfig;
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::time::Instant;

/// Bytes written to measure a disk's speed.
const PROBE_BYTES: usize = 48 << 20;
/// Bytes per write.
const PROBE_CHUNK: usize = 1 << 20;

/// Free bytes for this user on the file system of `folder`.
///
/// # Errors
/// The folder does not exist.
pub fn free_bytes(folder: &Path) -> Result<u64, Failure> {
    let s = rustix::fs::statvfs(folder).map_err(|e| Failure::Internal(format!("{}: {e}", folder.display())))?;
    Ok(s.f_bavail.saturating_mul(s.f_frsize))
}

/// True if the disk has the room that a scan in progress needs (`daemon.min_free_mb`).
///
/// # Errors
/// The device folder does not exist.
pub fn has_room(device: &Path, config: &DaemonConfig) -> Result<bool, Failure> {
    Ok(free_bytes(device)? >= u64::from(config.min_free_mb) * 1_000_000)
}

/// Bytes per second that reach the disk, measured with a temporary file in `folder`.
///
/// # Errors
/// The folder cannot be written.
pub fn write_speed(folder: &Path) -> Result<f64, Failure> {
    let path = folder.join(format!(".lumiscan-speed-{}", std::process::id()));
    let measured = measure(&path);
    let _ = std::fs::remove_file(&path);
    measured.map_err(|e| Failure::writing(&path, e))
}

fn measure(path: &Path) -> std::io::Result<f64> {
    // Not constant, since the file system may compress.
    let chunk: Vec<u8> = (0..PROBE_CHUNK as u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
    let mut file = File::create(path)?;
    let began = Instant::now();
    for _ in 0..PROBE_BYTES / PROBE_CHUNK {
        file.write_all(&chunk)?;
    }
    file.sync_all()?;
    Ok(PROBE_BYTES as f64 / began.elapsed().as_secs_f64().max(1e-6))
}

/// Checks that the disk can take `rate` bytes per second for `seconds`.
///
/// # Errors
/// It is too small or too slow; the message gives both figures.
pub fn require(folder: &Path, rate: f64, seconds: f64) -> Result<(), Failure> {
    let (free, needed) = (free_bytes(folder)?, rate * seconds + PROBE_BYTES as f64);
    let shown = folder.display();
    if (free as f64) < needed {
        return Err(Failure::Internal(format!(
            "{shown}: {:.1} GB are free, {:.1} GB are needed; free some, or record for less long with --seconds",
            free as f64 / 1e9,
            needed / 1e9
        )));
    }
    let speed = write_speed(folder)?;
    if speed < 1.2 * rate {
        return Err(Failure::Internal(format!(
            "{shown}: the disk writes {:.0} MB/s, {:.0} MB/s are needed; record to a faster one",
            speed / 1e6,
            1.2 * rate / 1e6
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_disk_cannot_take_is_refused_before_it_is_tried() {
        let folder = tempfile::tempdir().unwrap();
        assert!(require(folder.path(), 1e3, 1.0).is_ok());
        assert!(require(folder.path(), 1e3, 1e15).unwrap_err().to_string().contains("are free"));
        assert!(require(folder.path(), 1e13, 1e-6).unwrap_err().to_string().contains("MB/s"));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left behind");
    }
}
