//! The external program ffmpeg, for videos.

use crate::failure::Failure;
use std::process::{Command, Stdio};

/// Checks that ffmpeg can be run.
///
/// # Errors
/// It cannot; the message names the `purpose`.
pub fn find_ffmpeg(purpose: &str) -> Result<(), Failure> {
    let found = Command::new("ffmpeg").arg("-version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    match found {
        Ok(status) if status.success() => Ok(()),
        _ => Err(Failure::Usage(format!("ffmpeg is not on the PATH; it is needed {purpose}"))),
    }
}
