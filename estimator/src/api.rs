//! What a caller of the estimator gives and gets besides scan and result: options, progress, errors.

use std::time::Duration;

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
pub enum EstimateError {
    /// The scan holds nothing that could be estimated from.
    #[error("{0}")]
    Unusable(String),
}

/// What a run may spend.
#[derive(Debug, Clone)]
pub struct Options {
    /// Wall time from start to result.
    pub budget: Duration,
    /// Fixed number of ray rounds: replaces the clock, and the result is byte-identical.
    pub rounds: Option<u32>,
}

/// Told about every stage as it goes.
pub trait Progress: Sync {
    /// `fraction` of stage `name` is done (0 at its start, 1 at its end).
    fn stage(&self, name: &'static str, fraction: f64);
}

/// Reports nothing.
impl Progress for () {
    fn stage(&self, _: &'static str, _: f64) {}
}
