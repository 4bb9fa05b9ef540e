//! What ends a command, and with which exit code.

use std::fmt::Display;
use std::path::Path;

/// Why a command ended. Messages name the file concerned and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The program, the disk or the operating system failed.
    #[error("{0}")]
    Internal(String),
    /// The command line or the configuration makes no sense.
    #[error("{0}")]
    Usage(String),
    /// The input cannot be read.
    #[error("{0}")]
    Input(String),
    /// Nothing can be made of the scan.
    #[error("{0}")]
    Unusable(String),
    /// A stage had to be abandoned for the budget; a partial result was written.
    #[error("{0}")]
    Abandoned(String),
    /// The user or the system asked to stop; the signal's number.
    #[error("stopped by signal {0}; nothing was left behind")]
    Stopped(i32),
}

impl Failure {
    /// The exit code.
    #[must_use]
    pub fn code(&self) -> u8 {
        match self {
            Self::Internal(_) => 1,
            Self::Usage(_) => 2,
            Self::Input(_) => 3,
            Self::Unusable(_) => 4,
            Self::Abandoned(_) => 5,
            // As shells do.
            Self::Stopped(signal) => u8::try_from(128 + signal).unwrap_or(1),
        }
    }

    /// For a panic that was caught: a mistake of ours, whose place the panic's own message has told.
    #[must_use]
    pub fn panic(payload: &(dyn std::any::Any + Send)) -> Self {
        let text = payload.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| payload.downcast_ref::<&str>().copied()).unwrap_or("no message");
        Self::Internal(format!("internal error: {text}; please report this with the command and its input"))
    }

    /// For what could not be written.
    pub fn writing(path: impl AsRef<Path>, error: impl Display) -> Self {
        Self::Internal(format!(
            "{}: {error}; check that the disk is there, writable and not full",
            path.as_ref().display()
        ))
    }
}

/// Reading is what `recordings` is asked for; where it writes, the caller maps the error itself.
impl From<recordings::Error> for Failure {
    fn from(e: recordings::Error) -> Self {
        Self::Input(e.to_string())
    }
}

impl From<firmware_config::ConfigError> for Failure {
    fn from(e: firmware_config::ConfigError) -> Self {
        Self::Usage(e.to_string())
    }
}
