//! Errors of rendering, typed by what the caller can do about them.

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The request makes no sense for this result.
    #[error("{0}")]
    Request(String),
    /// A result cannot be read; the message names it.
    #[error(transparent)]
    Result(#[from] recordings::Error),
    /// A file cannot be used.
    #[error("{path}: {problem}")]
    File {
        /// The file.
        path: std::path::PathBuf,
        /// What is wrong with it.
        problem: String,
    },
}

impl RenderError {
    /// Names a file and what is wrong with it.
    pub fn file(path: &std::path::Path, problem: impl std::fmt::Display) -> Self {
        Self::File { path: path.to_path_buf(), problem: problem.to_string() }
    }
}

/// Result of this module.
pub type Result<T> = std::result::Result<T, RenderError>;
