//! Inputs as files, in memory: what reads paths is given paths.

use std::path::PathBuf;
use std::sync::OnceLock;

/// The folder of this process. `fuzz/run` removes it.
fn folder() -> &'static PathBuf {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let parent = std::env::var_os("FUZZ_SCRATCH").map_or_else(|| PathBuf::from("/dev/shm"), PathBuf::from);
        let folder = parent.join(std::process::id().to_string());
        std::fs::create_dir_all(&folder).expect("a folder for inputs");
        folder
    })
}

/// A file with these bytes; the next one of the same name replaces it.
pub fn file(name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder().join(name);
    std::fs::write(&path, bytes).expect("a file in memory");
    path
}
