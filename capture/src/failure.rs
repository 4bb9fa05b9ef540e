//! Why a command ends, and its exit code.

use estimator::EstimateError;
use serde::{Deserialize, Serialize};
use std::fmt::Display;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

/// A panic began where hardly any memory was left: libraries panic where they cannot allocate.
pub static MEMORY_RAN_OUT: AtomicBool = AtomicBool::new(false);

/// Why a command ended. Messages name the file concerned and the remedy.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The program, the disk or the operating system failed.
    #[error("{0}")]
    Internal(String),
    /// The command line or the configuration is invalid.
    #[error("{0}")]
    Usage(String),
    /// The input cannot be read.
    #[error("{0}")]
    Input(String),
    /// The scan holds too little for a result.
    #[error("{0}")]
    Unusable(String),
    /// A stage had to be abandoned for the budget; a partial result was written.
    #[error("{0}")]
    Abandoned(String),
    /// There was too little memory.
    #[error("{0}")]
    Memory(String),
    /// The user or the system asked to stop; the signal's number.
    #[error("stopped by signal {0}; nothing was left behind")]
    Stopped(i32),
}

/// When a command that failed may succeed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Retry {
    /// The input is bad.
    Never,
    /// With more memory or more time, here or on another machine.
    Elsewhere,
    /// When what the message names has been repaired.
    Repaired,
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
            Self::Memory(_) => 6,
            // As shells report it.
            Self::Stopped(signal) => u8::try_from(128 + signal).unwrap_or(1),
        }
    }

    /// When the same command may succeed.
    #[must_use]
    pub fn retry(&self) -> Retry {
        match self {
            Self::Internal(_) | Self::Usage(_) => Retry::Repaired,
            Self::Input(_) | Self::Unusable(_) => Retry::Never,
            Self::Abandoned(_) | Self::Memory(_) | Self::Stopped(_) => Retry::Elsewhere,
        }
    }

    /// The failure that a child process with this exit code reports; `None` for success and for codes of no such meaning.
    #[must_use]
    pub fn of_child(code: i32, message: String) -> Option<Self> {
        let all = [Self::Usage, Self::Input, Self::Unusable, Self::Abandoned, Self::Memory];
        all.into_iter().map(|kind| kind(message.clone())).find(|f| i32::from(f.code()) == code)
    }

    /// For a caught panic, whose location the panic message has already printed.
    #[must_use]
    pub fn panic(payload: &(dyn std::any::Any + Send)) -> Self {
        let text = payload.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| payload.downcast_ref::<&str>().copied()).unwrap_or("no message");
        if MEMORY_RAN_OUT.load(Ordering::Relaxed) {
            return Self::Memory(format!(
                "{text}, because memory ran out; raise the limit (--memory), or take it away"
            ));
        }
        Self::Internal(format!("internal error: {text}; please report this with the command and its input"))
    }

    /// For a scan that cannot be estimated.
    pub fn estimating(scan: impl Display, error: EstimateError) -> Self {
        match error {
            EstimateError::Unusable(problem) => Self::Unusable(format!("{scan}: {problem}")),
            EstimateError::NoReference(problem) => Self::Input(format!(
                "{scan}: --reference: {problem}; choose a pixel of a surface that the pictures show (a click in the viewer page \
                 tells one)"
            )),
        }
    }

    /// For an output that could not be written.
    pub fn writing(path: impl AsRef<Path>, error: impl Display) -> Self {
        Self::Internal(format!(
            "{}: {error}; check that the disk is mounted, writable and not full",
            path.as_ref().display()
        ))
    }
}

/// Errors of reading. Callers that write map the error themselves.
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
