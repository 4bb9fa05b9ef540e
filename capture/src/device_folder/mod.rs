//! The device folder: scans are staged in it and appear complete or not at all.

pub mod disk;
pub mod manifest;
pub mod publish;
pub mod retention;
pub mod trajectory;

use crate::device_folder::retention::UNFINISHED;
use crate::failure::Failure;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// Prefix of folders that are being filled.
const STAGING: &str = ".staging-";

/// A scan that is being made, in a folder that goes away again unless it is published.
#[derive(Debug)]
pub struct Staging {
    scans: PathBuf,
    folder: PathBuf,
    id: String,
    published: bool,
    /// Left where it is if it is not published: it can be finished later.
    keep: bool,
}

impl Staging {
    /// Makes `<device>/scans/.staging-…`, and removes those that killed processes left behind.
    ///
    /// # Errors
    /// The device folder cannot be written.
    pub fn create(device: &Path, name: &str) -> Result<Self, Failure> {
        let scans = device.join("scans");
        std::fs::create_dir_all(&scans).map_err(|e| cannot_write(&scans, &e))?;
        remove_abandoned(&scans);
        let id = format!("{}-{}", utc(SystemTime::now()), sanitised(name));
        let folder = scans.join(format!("{STAGING}{}-{id}", std::process::id()));
        std::fs::create_dir(&folder).map_err(|e| cannot_write(&folder, &e))?;
        Ok(Self { scans, folder, id, published: false, keep: false })
    }

    /// The daemon's: `<device>/scans/.capture-…`, which only the daemon cleans up after an interrupted run.
    ///
    /// # Errors
    /// The device folder cannot be written.
    pub fn unattended(device: &Path, name: &str) -> Result<Self, Failure> {
        let scans = device.join("scans");
        let id = format!("{}-{}", utc(SystemTime::now()), sanitised(name));
        let folder = scans.join(format!("{UNFINISHED}{id}"));
        std::fs::create_dir_all(&folder).map_err(|e| cannot_write(&folder, &e))?;
        Ok(Self { scans, folder, id, published: false, keep: false })
    }

    /// One that an interrupted run left.
    ///
    /// # Errors
    /// It is none.
    pub fn resume(folder: &Path) -> Result<Self, Failure> {
        let id = folder.file_name().and_then(|n| n.to_str()).and_then(|n| n.strip_prefix(UNFINISHED));
        let (Some(id), Some(scans)) = (id, folder.parent()) else {
            return Err(Failure::Internal(format!("{}: no unfinished scan", folder.display())));
        };
        Ok(Self { scans: scans.into(), folder: folder.into(), id: id.into(), published: false, keep: true })
    }

    /// From now on the folder outlives this process, published or not.
    pub fn keep(&mut self) {
        self.keep = true;
    }

    /// Where the scan's files are written.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Makes the folder visible as `<device>/scans/<utc>-<name>` (with a number behind it where that is taken) and
    /// returns its path.
    ///
    /// # Errors
    /// The device folder cannot be written.
    pub fn publish(mut self) -> Result<PathBuf, Failure> {
        sync(&self.folder)?;
        for attempt in 1u32.. {
            let suffix = if attempt == 1 { String::new() } else { format!("-{attempt}") };
            let target = self.scans.join(format!("{}{suffix}", self.id));
            // Renaming onto a folder that is not empty fails, so no other process's scan is ever replaced.
            match std::fs::rename(&self.folder, &target) {
                Ok(()) => {
                    self.published = true;
                    sync(&self.scans)?;
                    return Ok(target);
                }
                Err(_) if target.exists() => {}
                Err(e) => return Err(cannot_write(&target, &e)),
            }
        }
        Err(Failure::Internal(format!("{}: no free name for {}", self.scans.display(), self.id)))
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        if !self.published && !self.keep {
            let _ = std::fs::remove_dir_all(&self.folder);
        }
    }
}

/// Writes a small file of the scan and syncs it.
///
/// # Errors
/// The disk is full or gone.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    std::fs::write(path, bytes).map_err(|e| Failure::writing(path, e))?;
    sync(path)
}

fn sync(path: &Path) -> Result<(), Failure> {
    File::open(path).and_then(|f| f.sync_all()).map_err(|e| Failure::writing(path, e))
}

fn cannot_write(path: &Path, e: &std::io::Error) -> Failure {
    Failure::Internal(format!("{}: {e}; choose a device folder that can be written with --device", path.display()))
}

/// Removes staging folders whose process (its id stands in the name) is no more.
fn remove_abandoned(scans: &Path) {
    let Ok(entries) = std::fs::read_dir(scans) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let pid = name.to_str().and_then(|n| n.strip_prefix(STAGING)).and_then(|n| n.split('-').next());
        let alive = |pid: &str| Path::new("/proc").join(pid).exists();
        if pid.is_some_and(|p| !alive(p)) {
            tracing::info!("removing what an interrupted run left: {}", entry.path().display());
            let _ = std::fs::remove_dir_all(entry.path());
        }
    }
}

/// A name with nothing in it that a file system, a shell or a web address would mind.
fn sanitised(name: &str) -> String {
    let clean: String = name
        .chars()
        .take(64)
        .map(|c| if c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.') { c } else { '_' })
        .collect();
    let clean = clean.trim_start_matches('.');
    if clean.is_empty() { "scan".into() } else { clean.into() }
}

/// `20261121T110534Z`.
#[must_use]
pub fn utc(time: SystemTime) -> String {
    let seconds = time.duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs());
    let (days, s) = (seconds / 86_400, seconds % 86_400);
    let (year, month, day) = civil(days);
    format!("{year:04}{month:02}{day:02}T{:02}{:02}{:02}Z", s / 3600, s / 60 % 60, s % 60)
}

/// Year, month and day of the Gregorian calendar (Howard Hinnant's `civil_from_days`).
fn civil(days: u64) -> (u64, u64, u64) {
    let z = days + 719_468;
    let (era, day_of_era) = (z / 146_097, z % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 { shifted + 3 } else { shifted - 9 };
    (year_of_era + era * 400 + u64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn utc_of_known_instants() {
        let at = |s| utc(UNIX_EPOCH + Duration::from_secs(s));
        assert_eq!(at(0), "19700101T000000Z");
        assert_eq!(at(951_782_400), "20000229T000000Z");
        assert_eq!(at(1_305_031_102), "20110510T123822Z");
        assert_eq!(at(4_107_542_399), "21000228T235959Z");
        assert_eq!(at(4_107_542_400), "21000301T000000Z");
    }

    #[test]
    fn two_scans_of_the_same_second_both_appear() {
        let device = tempfile::tempdir().unwrap();
        let mut paths = Vec::new();
        let staged: Vec<_> = (0..3)
            .map(|i| {
                let mut s = Staging::create(device.path(), &format!("a{i}")).unwrap();
                s.id = "same".into();
                write_file(&s.folder().join("x"), b"x").unwrap();
                s
            })
            .collect();
        for s in staged {
            paths.push(s.publish().unwrap());
        }
        assert!(paths[2].ends_with("scans/same-3") && paths.iter().all(|p| p.join("x").exists()), "{paths:?}");
    }

    #[test]
    fn unpublished_and_abandoned_folders_go_away() {
        let device = tempfile::tempdir().unwrap();
        // No process has this id.
        let abandoned = device.path().join("scans").join(format!("{STAGING}4294967295-x"));
        std::fs::create_dir_all(&abandoned).unwrap();
        let staging = Staging::create(device.path(), "a/b").unwrap();
        assert!(!abandoned.exists() && staging.folder().exists());
        drop(staging);
        assert_eq!(std::fs::read_dir(device.path().join("scans")).unwrap().count(), 0);
    }

    #[test]
    fn names_are_harmless() {
        assert_eq!(sanitised("../a b\n"), "_a_b_");
        assert_eq!(sanitised("..."), "scan");
    }
}
