//! What commands print on stdout, and where they may write.

use crate::failure::Failure;
use std::io::Write;
use std::path::Path;

/// Prints one line of the result.
///
/// # Errors
/// stdout cannot be written. A closed pipe is no error.
pub fn print(text: &str) -> Result<(), Failure> {
    let mut out = std::io::stdout().lock();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        // The reader has closed the pipe (`lumiscan … | head`).
        Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => other.map_err(|e| Failure::Internal(format!("stdout: {e}"))),
    }
}

/// Prints a result as JSON.
///
/// # Errors
/// As [`print()`].
pub fn print_json(value: &impl serde::Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value).map_err(|e| Failure::Internal(e.to_string()))?;
    print(&text)
}

/// Checks before any work that the folder of an output file exists.
///
/// # Errors
/// It does not, or `path` is itself a folder.
pub fn check_parent(path: &Path) -> Result<(), Failure> {
    let parent = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !parent.is_dir() {
        let shown = parent.display();
        return Err(Failure::Usage(format!("{}: there is no folder {shown}; make it first", path.display())));
    }
    if path.is_dir() {
        return Err(Failure::Usage(format!("{} is a folder; name a file", path.display())));
    }
    Ok(())
}
