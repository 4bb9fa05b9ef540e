//! Numbering and removal of the daemon's scans: names that are unique without a correct clock, room for the next scan, and
//! the remains of interrupted runs.

use crate::device_folder::disk::has_room;
use crate::device_folder::files::{sync, write_file};
use crate::device_folder::handed_off;
use crate::device_folder::manifest;
use crate::device_folder::naming::sanitised;
use crate::device_folder::staging::{STAGING, UNFINISHED};
use crate::failure::Failure;
use firmware_config::{DaemonConfig, HandoffConfig};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Folder of partial scans.
const ASIDE: &str = "aside";
/// File with the number of the newest scan.
const COUNTER: &str = "counter";
/// Stem of the daemon's scan names.
const NAME: &str = "scan";

/// The next scan's name, `scan-0042`: a number is never used twice, whatever the clock shows and whatever was deleted.
///
/// # Errors
/// The device folder cannot be written.
pub fn next_name(device: &Path) -> Result<String, Failure> {
    let path = device.join(COUNTER);
    let stored = std::fs::read_to_string(&path).ok().and_then(|t| t.trim().parse::<u64>().ok()).unwrap_or(0);
    let used =
        [device.join("scans"), device.join(ASIDE)].iter().flat_map(|d| names(d)).filter_map(|n| number(&n)).max();
    let next = stored.max(used.unwrap_or(0)).saturating_add(1);
    write_file(&path, format!("{next}\n").as_bytes())?;
    Ok(numbered(next))
}

fn numbered(number: u64) -> String {
    format!("{NAME}-{number:04}")
}

/// The name in the folder of a scan of the daemon that the user has named, `scan-0042-kitchen`.
#[must_use]
pub fn with_name(numbered: &str, name: &str) -> String {
    format!("{numbered}-{}", sanitised(name))
}

/// The number in `20261121T110534Z-scan-0042` or, published a second time or with a name, `…-scan-0042-2`.
fn number(folder: &str) -> Option<u64> {
    let (_, rest) = folder.split_once(&format!("-{NAME}-"))?;
    rest.split('-').next()?.parse().ok()
}

fn names(dir: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(dir).into_iter().flatten().flatten();
    entries.filter_map(|e| e.file_name().into_string().ok()).collect()
}

/// Folders of interrupted runs of the daemon; those with a complete scan file can be finished.
#[must_use]
pub fn unfinished(device: &Path) -> Vec<PathBuf> {
    let scans = device.join("scans");
    let mut all: Vec<_> =
        names(&scans).into_iter().filter(|n| n.starts_with(UNFINISHED)).map(|n| scans.join(n)).collect();
    all.sort();
    all
}

/// Moves a scan that cannot be finished to `aside/`, and keeps only the `keep` newest there.
///
/// # Errors
/// The device folder cannot be written.
pub fn set_aside(device: &Path, folder: &Path, keep: u32) -> Result<(), Failure> {
    let aside = device.join(ASIDE);
    std::fs::create_dir_all(&aside).map_err(|e| Failure::writing(&aside, e))?;
    let name = folder.file_name().map_or("partial".into(), |n| n.to_string_lossy().replacen(UNFINISHED, "", 1));
    let target = aside.join(&name);
    // A folder of the same name is of the same interrupted scan.
    let _ = std::fs::remove_dir_all(&target);
    std::fs::rename(folder, &target).map_err(|e| Failure::writing(&target, e))?;
    sync(&aside)?;
    tracing::warn!("an interrupted scan is set aside in {}", target.display());
    let mut all = by_age(&aside);
    let surplus = all.len().saturating_sub(keep as usize);
    all.drain(..surplus).for_each(|old| remove(&old));
    Ok(())
}

/// The scans that are complete, oldest first.
#[must_use]
pub fn finished(device: &Path) -> Vec<PathBuf> {
    let mut finished = by_age(&device.join("scans"));
    finished.retain(|f| f.file_name().is_some_and(|n| !n.to_string_lossy().starts_with('.')));
    finished
}

/// Removes the oldest finished scans until the device folder is within its limit and the disk has room. Where scans are handed
/// off, one that the other machine has not confirmed stays.
///
/// # Errors
/// There is too little room even without any scan that may go.
pub fn make_room(device: &Path, config: &DaemonConfig, handoff: &HandoffConfig) -> Result<(), Failure> {
    let finished = finished(device);
    let limit = u64::from(config.max_folder_mb) * 1_000_000;
    let mut used: u64 = finished.iter().map(|f| size(f)).sum();
    let (waiting, removable): (Vec<_>, Vec<_>) =
        finished.into_iter().partition(|f| handoff.is_on() && !handed_off::is_confirmed(device, f));
    let mut oldest = removable.into_iter();
    while used > limit || !has_room(device, config)? {
        let Some(folder) = oldest.next() else { break };
        used = used.saturating_sub(size(&folder));
        tracing::warn!("removing {} to make room", folder.display());
        remove(&folder);
        handed_off::forget(device, &folder);
    }
    if has_room(device, config)? {
        return Ok(());
    }
    let waiting = match waiting.len() {
        0 => String::new(),
        n => format!("; {n} scans stay until they are handed off: see `lumiscan handoff`"),
    };
    Err(Failure::Internal(format!(
        "{}: less than {} MB are free; free space, or lower daemon.min_free_mb{waiting}",
        device.display(),
        config.min_free_mb
    )))
}

/// Folders, oldest first, by the daemon's own numbers since the clock may have been wrong; those without a number first.
fn by_age(dir: &Path) -> Vec<PathBuf> {
    let mut all: Vec<_> = names(dir)
        .into_iter()
        .map(|name| {
            let path = dir.join(&name);
            let changed = std::fs::metadata(&path).and_then(|m| m.modified()).unwrap_or(SystemTime::UNIX_EPOCH);
            (number(&name).unwrap_or(0), changed, name, path)
        })
        .filter(|(.., path)| path.is_dir())
        .collect();
    all.sort();
    all.into_iter().map(|(.., path)| path).collect()
}

/// Total size of the files in a folder, in bytes.
fn size(folder: &Path) -> u64 {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.filter_map(|e| e.metadata().ok()).filter(std::fs::Metadata::is_file).map(|m| m.len()).sum()
}

/// The ids of the published scans, oldest first.
#[must_use]
pub fn published(device: &Path) -> Vec<String> {
    let all = by_age(&device.join("scans"));
    let ids = all.iter().filter_map(|f| f.file_name()?.to_str());
    ids.filter(|id| !id.starts_with('.')).map(Into::into).collect()
}

/// Gives a published scan another name, and returns its new id. Its time and its number stay.
///
/// # Errors
/// The disk is full or gone.
pub fn rename(folder: &Path, name: &str) -> Result<String, Failure> {
    let old = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let time = old.split('-').next().unwrap_or_default();
    let named = number(&old).map_or_else(|| sanitised(name), |n| with_name(&numbered(n), name));
    let (id, target) = moved(folder, &format!("{time}-{named}"))?;
    manifest::change(&target, vec![("name", name.into())])?;
    Ok(id)
}

/// Gives a folder this name, with a number appended if that exists; returns the new name and path.
fn moved(folder: &Path, name: &str) -> Result<(String, PathBuf), Failure> {
    for attempt in 1u32..1000 {
        let suffix = if attempt == 1 { String::new() } else { format!("-{attempt}") };
        let id = format!("{name}{suffix}");
        let target = folder.with_file_name(&id);
        if target != folder && target.exists() {
            continue;
        }
        std::fs::rename(folder, &target).map_err(|e| Failure::writing(&target, e))?;
        return Ok((id, target));
    }
    Err(Failure::Internal(format!("{}: no free name for {name}", folder.display())))
}

/// Puts another time before a published scan's name, and returns its new folder.
///
/// # Errors
/// The disk is full or gone.
pub fn set_stamp(folder: &Path, stamp: &str) -> Result<PathBuf, Failure> {
    let old = folder.file_name().unwrap_or_default().to_string_lossy();
    let name = old.split_once('-').map_or("", |(_, name)| name);
    moved(folder, &format!("{stamp}-{name}")).map(|(_, target)| target)
}

/// Removes a folder. It is renamed first, so that readers see all of it or nothing.
pub fn remove(folder: &Path) {
    let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let doomed = folder.with_file_name(format!("{STAGING}0-{name}"));
    if let Err(e) = std::fs::rename(folder, &doomed).and_then(|()| std::fs::remove_dir_all(&doomed)) {
        tracing::warn!("{}: {e}", folder.display());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scan(device: &Path, name: &str, bytes: usize) {
        let folder = device.join("scans").join(name);
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("scan.lscan"), vec![0; bytes]).unwrap();
    }

    #[test]
    fn numbers_are_never_used_twice() {
        let device = tempfile::tempdir().unwrap();
        assert_eq!(next_name(device.path()).unwrap(), "scan-0001");
        assert_eq!(next_name(device.path()).unwrap(), "scan-0002");
        // The counter is lost, the scans are not. A user's name may look like one of ours.
        std::fs::remove_file(device.path().join(COUNTER)).unwrap();
        scan(device.path(), "19700101T000012Z-scan-0007-my-scan-9", 1);
        assert_eq!(next_name(device.path()).unwrap(), "scan-0008");
        std::fs::write(device.path().join(COUNTER), "nonsense").unwrap();
        assert_eq!(next_name(device.path()).unwrap(), "scan-0008");
    }

    #[test]
    fn the_oldest_are_removed_first_and_the_one_in_progress_never() {
        let device = tempfile::tempdir().unwrap();
        for name in [
            "20990101T000000Z-scan-0002",
            "19700101T000000Z-scan-0010",
            "19700101T000000Z-scan-0003",
            ".capture-20000101T000000Z-scan-0001",
        ] {
            scan(device.path(), name, 1_000_000);
        }
        let config = DaemonConfig { max_folder_mb: 2, min_free_mb: 1, ..DaemonConfig::default() };
        make_room(device.path(), &config, &HandoffConfig::default()).unwrap();
        let mut left = names(&device.path().join("scans"));
        left.sort();
        assert_eq!(
            left,
            [".capture-20000101T000000Z-scan-0001", "19700101T000000Z-scan-0003", "19700101T000000Z-scan-0010"]
        );
    }

    #[test]
    fn a_scan_keeps_its_number_under_another_name() {
        let device = tempfile::tempdir().unwrap();
        for (old, new) in [
            ("20000101T000000Z-scan-0001", "20000101T000000Z-scan-0001-my_desk"),
            ("20000101T000000Z-scan-0001-x-2", "20000101T000000Z-scan-0001-my_desk-2"),
            ("20000101T000001Z-tabletop", "20000101T000001Z-my_desk"),
        ] {
            scan(device.path(), old, 1);
            assert_eq!(rename(&device.path().join("scans").join(old), "my desk").unwrap(), new);
            assert_eq!(manifest::read(&device.path().join("scans").join(new)).unwrap()["name"], "my desk");
        }
        assert_eq!(published(device.path()).len(), 3);
        assert_eq!(next_name(device.path()).unwrap(), "scan-0002");
    }

    #[test]
    fn a_full_disk_is_an_error_when_nothing_is_left_to_remove() {
        let device = tempfile::tempdir().unwrap();
        scan(device.path(), "20000101T000000Z-scan-0001", 10);
        let config = DaemonConfig { min_free_mb: 1_000_000, ..DaemonConfig::default() };
        assert!(
            make_room(device.path(), &config, &HandoffConfig::default())
                .unwrap_err()
                .to_string()
                .contains("min_free_mb")
        );
    }

    #[test]
    fn what_is_not_handed_off_stays() {
        let device = tempfile::tempdir().unwrap();
        for i in 1..=3 {
            scan(device.path(), &format!("20000101T00000{i}Z-scan-000{i}"), 1_000_000);
        }
        let config = DaemonConfig { max_folder_mb: 1, min_free_mb: 1, ..DaemonConfig::default() };
        let handoff = HandoffConfig { destination: "far:scans".into(), ..HandoffConfig::default() };
        make_room(device.path(), &config, &handoff).unwrap();
        assert_eq!(finished(device.path()).len(), 3);
        let second = device.path().join("scans/20000101T000002Z-scan-0002");
        handed_off::confirm(device.path(), &second).unwrap();
        make_room(device.path(), &config, &handoff).unwrap();
        assert!(
            finished(device.path()).len() == 2 && !second.exists() && !handed_off::is_confirmed(device.path(), &second)
        );
        let full = DaemonConfig { min_free_mb: 1_000_000, ..config };
        assert!(make_room(device.path(), &full, &handoff).unwrap_err().to_string().contains("2 scans stay"));
        assert_eq!(finished(device.path()).len(), 2);
    }

    #[test]
    fn only_the_newest_partial_scans_are_kept() {
        let device = tempfile::tempdir().unwrap();
        for i in 1..=5 {
            let name = format!("{UNFINISHED}20000101T00000{i}Z-scan-000{i}");
            scan(device.path(), &name, 10);
            set_aside(device.path(), &device.path().join("scans").join(name), 2).unwrap();
        }
        let mut left = names(&device.path().join(ASIDE));
        left.sort();
        assert_eq!(left, ["20000101T000004Z-scan-0004", "20000101T000005Z-scan-0005"]);
        assert!(unfinished(device.path()).is_empty());
    }
}
