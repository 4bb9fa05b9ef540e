//! Where pictures are rendered: a folder with the files that clients sent, and the newest picture.

use crate::lock::lock;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Bytes and number of the files that are kept; more are refused.
const MOST_BYTES: u64 = 32 << 20;
const MOST_FILES: usize = 16;
/// Longest name of a file.
const NAME: usize = 64;
/// What can be inserted or lights a scan.
const KINDS: [&str; 7] = ["glb", "ply", "hdr", "exr", "png", "jpg", "jpeg"];

/// The folder; it goes when this is dropped.
pub struct Desk {
    folder: PathBuf,
    writing: Mutex<()>,
}

impl Default for Desk {
    fn default() -> Self {
        Self {
            folder: std::env::temp_dir().join(format!("lumiscan-render-{}", std::process::id())),
            writing: Mutex::default(),
        }
    }
}

impl Drop for Desk {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// Why a piece of a file is not taken: status and reason.
pub type Refusal = (u16, String);

impl Desk {
    /// Where the child works; made if it is missing.
    ///
    /// # Errors
    /// The disk is full or gone.
    pub fn folder(&self) -> std::io::Result<&Path> {
        std::fs::create_dir_all(self.files())?;
        Ok(&self.folder)
    }

    /// The newest picture.
    #[must_use]
    pub fn picture(&self) -> PathBuf {
        self.folder.join("picture.png")
    }

    /// The camera of a view that is none of a keyframe.
    #[must_use]
    pub fn camera(&self) -> PathBuf {
        self.folder.join("camera.json")
    }

    /// A file that was sent; `None` if there is none of this name.
    #[must_use]
    pub fn file(&self, name: &str) -> Option<PathBuf> {
        Some(self.files().join(checked(name).ok()?)).filter(|path| path.is_file())
    }

    fn files(&self) -> PathBuf {
        self.folder.join("files")
    }

    /// Takes a piece of a file that begins at `offset`; one at 0 begins the file anew. Returns how long it is now.
    ///
    /// # Errors
    /// The name, the offset or the size does not fit, or the disk is full or gone.
    pub fn take(&self, name: &str, offset: u64, piece: &[u8]) -> Result<u64, Refusal> {
        let name = checked(name)?;
        let _turn = lock(&self.writing);
        let failed = |e: std::io::Error| (500, e.to_string());
        self.folder().map_err(failed)?;
        let path = self.files().join(name);
        let (mut others, mut number) = (0, 0);
        for entry in std::fs::read_dir(self.files()).map_err(failed)?.flatten().filter(|e| e.path() != path) {
            (others, number) = (others + entry.metadata().map_or(0, |m| m.len()), number + 1);
        }
        let length = if offset == 0 { 0 } else { std::fs::metadata(&path).map_or(0, |m| m.len()) };
        if offset != length {
            return Err((409, format!("{name} has {length} bytes; go on from there, or begin at 0")));
        }
        let longer = length + piece.len() as u64;
        if others + longer > MOST_BYTES || number >= MOST_FILES {
            let problem =
                format!("the box takes {MOST_FILES} files, {} MiB in all; remove some first", MOST_BYTES >> 20);
            return Err((413, problem));
        }
        let mut options = std::fs::OpenOptions::new();
        let file = if offset == 0 { options.write(true).create(true).truncate(true) } else { options.append(true) };
        file.open(&path).and_then(|mut file| file.write_all(piece)).map_err(failed)?;
        Ok(longer)
    }

    /// Removes every file that was sent.
    pub fn clear(&self) {
        let _turn = lock(&self.writing);
        let _ = std::fs::remove_dir_all(self.files());
    }
}

fn checked(name: &str) -> Result<&str, Refusal> {
    let harmless = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    let kind = name.rsplit_once('.').map(|(_, kind)| kind.to_ascii_lowercase());
    let fits = name.len() <= NAME && !name.starts_with(['.', '-']) && name.chars().all(harmless);
    if fits && kind.is_some_and(|k| KINDS.contains(&k.as_str())) {
        Ok(name)
    } else {
        Err((400, format!("a name is of letters, digits, _ - and ., ends with one of {}", KINDS.join(", "))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn desk() -> (tempfile::TempDir, Desk) {
        let folder = tempfile::tempdir().unwrap();
        let desk = Desk { folder: folder.path().join("desk"), writing: Mutex::default() };
        (folder, desk)
    }

    #[test]
    fn a_file_comes_in_pieces_and_nothing_else_does() {
        let (_folder, desk) = desk();
        assert_eq!(desk.take("a.glb", 0, b"abc"), Ok(3));
        assert_eq!(desk.take("a.glb", 3, b"de"), Ok(5));
        assert_eq!(desk.take("a.glb", 3, b"de").unwrap_err().0, 409);
        assert_eq!(std::fs::read(desk.file("a.glb").unwrap()).unwrap(), b"abcde");
        assert_eq!(desk.take("a.glb", 0, b"x"), Ok(1), "begun anew");
        for name in ["../a.glb", "a", ".glb", "-a.glb", "a b.glb", "a.exe", "a\0.glb", "a/b.glb", &"a".repeat(99)] {
            assert_eq!(desk.take(name, 0, b"x").unwrap_err().0, 400, "{name}");
            assert!(desk.file(name).is_none());
        }
        desk.clear();
        assert!(desk.file("a.glb").is_none());
    }

    #[test]
    fn files_are_few_and_small() {
        let (_folder, desk) = desk();
        let half = vec![0; (MOST_BYTES / 2) as usize];
        assert!(desk.take("a.glb", 0, &half).is_ok() && desk.take("b.glb", 0, &half).is_ok());
        assert_eq!(desk.take("c.glb", 0, b"x").unwrap_err().0, 413);
        assert!(desk.take("b.glb", 0, b"x").is_ok());
        for i in 0..MOST_FILES - 2 {
            assert!(desk.take(&format!("{i}.png"), 0, b"x").is_ok());
        }
        assert_eq!(desk.take("z.png", 0, b"x").unwrap_err().0, 413);
        drop(desk);
    }
}
