//! Errors, typed by what the caller can do about them.

use std::path::{Path, PathBuf};

/// What can go wrong with a file or folder. Every message names the file and says what to do about it.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The operating system refused.
    #[error("{path}: {source}")]
    Io {
        /// File concerned.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// The file ends in the middle; everything before has been delivered.
    #[error(
        "{path}: the file is cut off after {offset} bytes; what precedes is intact, the rest is lost: copy or record it again"
    )]
    Truncated {
        /// File concerned.
        path: PathBuf,
        /// Where the last whole chunk ends.
        offset: u64,
    },
    /// A chunk's checksum or length is wrong; everything before has been delivered.
    #[error("{path}: damaged at byte {offset} ({problem}); what precedes is intact: copy or record it again")]
    Damaged {
        /// File concerned.
        path: PathBuf,
        /// Where the damaged chunk begins.
        offset: u64,
        /// What is wrong with it.
        problem: String,
    },
    /// The bytes are not what they should be.
    #[error("{path}: {problem}; {remedy}")]
    Invalid {
        /// File concerned.
        path: PathBuf,
        /// What is wrong.
        problem: String,
        /// What the reader of the message can do.
        remedy: String,
    },
}

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// Wraps an I/O error with its path.
    pub fn io(path: impl AsRef<Path>, source: std::io::Error) -> Self {
        Self::Io { path: path.as_ref().to_path_buf(), source }
    }

    /// Names a file whose contents are wrong, and the remedy.
    pub fn invalid(path: impl AsRef<Path>, problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Invalid { path: path.as_ref().to_path_buf(), problem: problem.into(), remedy: remedy.into() }
    }
}
