//! Atomic writes of small files: readers see the old content or the new, and a power cut leaves one of the two.

use crate::failure::Failure;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Writes a file beside its place, syncs it, renames it into place and syncs the folder.
///
/// # Errors
/// The disk is full or gone; the old content, if any, is untouched then.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let part = beside(path, ".part");
    let written = File::create(&part).and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()));
    written.and_then(|()| std::fs::rename(&part, path)).map_err(|e| {
        let _ = std::fs::remove_file(&part);
        Failure::writing(path, e)
    })?;
    sync(path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")))
}

/// Replaces a file by a rename, without the wait for the disk: for what is out of date after a power cut anyway.
///
/// # Errors
/// As the file system's.
pub fn replace_unsynced(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let part = beside(path, ".part");
    std::fs::write(&part, bytes)?;
    std::fs::rename(&part, path)
}

/// Waits until a file, or the names in a folder, are on the disk.
///
/// # Errors
/// The disk is full or gone.
pub fn sync(path: &Path) -> Result<(), Failure> {
    File::open(path).and_then(|f| f.sync_all()).map_err(|e| Failure::writing(path, e))
}

/// The path with `ending` appended to its file name.
pub fn beside(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(ending);
    path.with_file_name(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_as_a_whole_and_nothing_is_left_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        for text in ["old", "new"] {
            write_file(&path, text.as_bytes()).unwrap();
            assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        }
        replace_unsynced(&path, b"newer").unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        // A folder in the way is not replaced, and the part does not stay.
        let taken = folder.path().join("folder");
        std::fs::create_dir_all(taken.join("x")).unwrap();
        assert!(write_file(&taken, b"text").is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }
}
