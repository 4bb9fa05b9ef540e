//! Files that appear complete or not at all.

use std::fs::File;
use std::io::Result;
use std::path::Path;

/// Fills a file beside `path`, syncs it and renames it into place.
pub fn write_whole(path: &Path, fill: impl FnOnce(&File) -> Result<()>) -> Result<()> {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(".part");
    let part = path.with_file_name(name);
    let written = File::create(&part).and_then(|file| fill(&file).and_then(|()| file.sync_all()));
    written.and_then(|()| std::fs::rename(&part, path)).inspect_err(|_| {
        let _ = std::fs::remove_file(&part);
    })
}
