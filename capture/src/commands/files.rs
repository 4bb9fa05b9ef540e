//! Files and folders that commands read and write.

use crate::failure::Failure;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// The scan that was named, otherwise the one beside a result: `scan.lscan` or the `.lscan` of the same stem.
pub fn find_scan(named: Option<&Path>, result: &Path) -> Option<PathBuf> {
    let beside = [result.with_file_name("scan.lscan"), result.with_extension("lscan")];
    named.map(Path::to_path_buf).or_else(|| beside.into_iter().find(|p| p.is_file()))
}

/// True if the path ends with one of the `extensions` (lower case, no dot).
pub fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().and_then(|e| e.to_str()).is_some_and(|e| extensions.contains(&e.to_ascii_lowercase().as_str()))
}

/// What exists is never overwritten; returns the folder's name.
pub fn check_fresh(dir: &Path) -> Result<&OsStr, Failure> {
    let used = dir.is_file() || std::fs::read_dir(dir).is_ok_and(|mut entries| entries.next().is_some());
    match dir.file_name() {
        Some(name) if !used => Ok(name),
        _ => Err(Failure::Usage(format!("{}: exists and is no empty folder; name a new one", dir.display()))),
    }
}

/// Fills a folder beside `dir` and renames it into place, so that `dir` is complete or not there at all.
pub fn into_fresh_folder(dir: &Path, fill: impl FnOnce(&Path) -> Result<(), Failure>) -> Result<(), Failure> {
    let mut staged = check_fresh(dir)?.to_os_string();
    staged.push(format!(".{}.part", std::process::id()));
    let staging = StagingFolder::create(dir.with_file_name(staged))?;
    fill(&staging.0)?;
    std::fs::rename(&staging.0, dir).map_err(|e| Failure::writing(dir, e))
}

/// A folder that goes away again unless it is renamed.
pub struct StagingFolder(PathBuf);

impl StagingFolder {
    /// Makes the folder.
    pub fn create(path: PathBuf) -> Result<Self, Failure> {
        std::fs::create_dir_all(&path).map_err(|e| Failure::writing(&path, e))?;
        Ok(Self(path))
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for StagingFolder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
