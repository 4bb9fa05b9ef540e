//! The folder of a scan that is being made: invisible until it is complete, then renamed into place.

use crate::device_folder::dates::{self, Dates, Moment};
use crate::device_folder::files::sync;
use crate::device_folder::naming::sanitised;
use crate::failure::Failure;
use std::path::{Path, PathBuf};

/// Prefix of folders that are being filled.
pub const STAGING: &str = ".staging-";
/// Prefix of the folders that the daemon fills.
pub const UNFINISHED: &str = ".capture-";

/// A scan that is being made, in a folder that is removed unless it is published.
#[derive(Debug)]
pub struct Staging {
    scans: PathBuf,
    folder: PathBuf,
    /// What stands before the name: the time, or that there is none.
    stamp: String,
    name: String,
    /// When it was begun; `None` if an interrupted run did.
    began: Option<Moment>,
    published: bool,
    /// The folder stays if it is not published, to be finished later.
    keep: bool,
}

impl Staging {
    /// Makes `<device>/scans/.staging-…`, and removes those of processes that were killed.
    ///
    /// # Errors
    /// The device folder cannot be written.
    pub fn create(device: &Path, name: &str) -> Result<Self, Failure> {
        let scans = device.join("scans");
        std::fs::create_dir_all(&scans).map_err(|e| cannot_write(&scans, &e))?;
        remove_abandoned(&scans);
        let (stamp, name) = (dates::stamp(), sanitised(name));
        let folder = scans.join(format!("{STAGING}{}-{stamp}-{name}", std::process::id()));
        std::fs::create_dir(&folder).map_err(|e| cannot_write(&folder, &e))?;
        Ok(Self { scans, folder, stamp, name, began: Some(Moment::now()), published: false, keep: false })
    }

    /// Makes `<device>/scans/.capture-…`, which only the daemon cleans up after an interrupted run.
    ///
    /// # Errors
    /// The device folder cannot be written.
    pub fn unattended(device: &Path, name: &str) -> Result<Self, Failure> {
        let scans = device.join("scans");
        let (stamp, name) = (dates::stamp(), sanitised(name));
        let folder = scans.join(format!("{UNFINISHED}{stamp}-{name}"));
        std::fs::create_dir_all(&folder).map_err(|e| cannot_write(&folder, &e))?;
        // After a power cut, what is in it is found.
        sync(&scans)?;
        sync(device)?;
        Ok(Self { scans, folder, stamp, name, began: Some(Moment::now()), published: false, keep: false })
    }

    /// Takes over a folder of an interrupted run.
    ///
    /// # Errors
    /// It is not such a folder.
    pub fn resume(folder: &Path) -> Result<Self, Failure> {
        let id = folder.file_name().and_then(|n| n.to_str()).and_then(|n| n.strip_prefix(UNFINISHED));
        let (Some((stamp, name)), Some(scans)) = (id.and_then(|id| id.split_once('-')), folder.parent()) else {
            return Err(Failure::Internal(format!("{}: not an unfinished scan", folder.display())));
        };
        let (scans, folder, stamp, name) = (scans.into(), folder.into(), stamp.into(), name.into());
        Ok(Self { scans, folder, stamp, name, began: None, published: false, keep: true })
    }

    /// Publishes under another name.
    pub fn set_name(&mut self, name: &str) {
        self.name = sanitised(name);
    }

    /// Its dates, if it is published now.
    pub fn dates(&mut self) -> Dates {
        dates::dates(&mut self.stamp, self.began.as_ref())
    }

    /// Keeps the folder from now on, even if it is not published.
    pub fn keep(&mut self) {
        self.keep = true;
    }

    /// Where the scan's files are written.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Makes the folder visible as `<device>/scans/<utc>-<name>` (`undated-<name>` while the clock is not set; with a number appended if that exists) and
    /// returns its path.
    ///
    /// # Errors
    /// The device folder cannot be written.
    pub fn publish(mut self) -> Result<PathBuf, Failure> {
        sync(&self.folder)?;
        let id = format!("{}-{}", self.stamp, self.name);
        for attempt in 1u32.. {
            let suffix = if attempt == 1 { String::new() } else { format!("-{attempt}") };
            let target = self.scans.join(format!("{id}{suffix}"));
            // A rename onto a folder that is not empty fails, so no scan is ever replaced.
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
        Err(Failure::Internal(format!("{}: no free name for {id}", self.scans.display())))
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        if !self.published && !self.keep {
            let _ = std::fs::remove_dir_all(&self.folder);
        }
    }
}

fn cannot_write(path: &Path, e: &std::io::Error) -> Failure {
    Failure::Internal(format!("{}: {e}; choose a device folder that can be written with --device", path.display()))
}

/// Removes staging folders whose process, named by its id, has ended.
pub fn remove_abandoned(scans: &Path) {
    let Ok(entries) = std::fs::read_dir(scans) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let pid = name.to_str().and_then(|n| n.strip_prefix(STAGING)).and_then(|n| n.split('-').next());
        let alive = |pid: &str| Path::new("/proc").join(pid).exists();
        if pid.is_some_and(|p| !alive(p)) {
            tracing::info!("removing the remains of an interrupted run: {}", entry.path().display());
            let _ = std::fs::remove_dir_all(entry.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device_folder::files::write_file;

    #[test]
    fn two_scans_of_the_same_second_both_appear() {
        let device = tempfile::tempdir().unwrap();
        let mut paths = Vec::new();
        let staged: Vec<_> = (0..3)
            .map(|i| {
                let mut s = Staging::create(device.path(), &format!("a{i}")).unwrap();
                (s.stamp, s.name) = ("same".into(), "scan".into());
                write_file(&s.folder().join("x"), b"x").unwrap();
                s
            })
            .collect();
        for s in staged {
            paths.push(s.publish().unwrap());
        }
        assert!(paths[2].ends_with("scans/same-scan-3") && paths.iter().all(|p| p.join("x").exists()), "{paths:?}");
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
}
