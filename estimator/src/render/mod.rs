//! Mixed reality (§4.1): a result and what is put into it, taken out of it, or done to its light.

pub mod before_after_scene;
pub mod change;
pub mod compose;
pub mod inpainting;
pub mod lighting;
pub mod objects;
pub mod relight;
pub mod removal;
pub mod sampling;
pub mod view;

/// What went wrong, by what the caller can do about it.
#[derive(Debug, thiserror::Error)]
pub enum RealityError {
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

impl RealityError {
    /// Names a file and what is wrong with it.
    pub fn file(path: &std::path::Path, problem: impl std::fmt::Display) -> Self {
        Self::File { path: path.to_path_buf(), problem: problem.to_string() }
    }
}

/// Result of this module.
pub type Result<T> = std::result::Result<T, RealityError>;
