//! Options, progress and errors of the estimator.

use std::time::Duration;

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
pub enum EstimateError {
    /// The scan has no triangle, or no keyframe that shows any of it.
    #[error("{0}")]
    Unusable(String),
}

/// Effort of a run.
#[derive(Debug, Clone)]
pub struct Options {
    /// Time from start to result.
    pub budget: Duration,
    /// Fixed number of ray rounds in place of the clock: the result is byte-identical on every machine.
    pub rounds: Option<u32>,
}

/// Gets the progress of every stage.
pub trait Progress: Sync {
    /// `fraction` of stage `name` is done (0 at its start, 1 at its end).
    fn stage(&self, name: &'static str, fraction: f64);
}

/// Reports nothing.
impl Progress for () {
    fn stage(&self, _: &'static str, _: f64) {}
}
