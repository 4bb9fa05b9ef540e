//! SIGINT and SIGTERM as a flag that long work looks at.

use crate::failure::Failure;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Set by the first SIGINT or SIGTERM. Whoever looks at it shows a sign of life.
#[derive(Debug, Clone)]
pub struct Stop {
    signal: Arc<AtomicUsize>,
    /// Milliseconds from `since` to the last sign of life.
    sign: Arc<AtomicU64>,
    since: Instant,
}

impl Default for Stop {
    fn default() -> Self {
        Self { signal: Arc::default(), sign: Arc::default(), since: Instant::now() }
    }
}

impl Stop {
    /// From now on the signals no longer end the process by themselves.
    ///
    /// # Errors
    /// The system refuses the handler.
    pub fn on_signals() -> Result<Self, Failure> {
        let stop = Self::default();
        for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
            signal_hook::flag::register_usize(signal, Arc::clone(&stop.signal), signal.unsigned_abs() as usize)
                .map_err(|e| Failure::Internal(format!("signal handler: {e}")))?;
        }
        Ok(stop)
    }

    /// # Errors
    /// [`Failure::Stopped`] once a signal came.
    pub fn check(&self) -> Result<(), Failure> {
        self.sign.store(self.since.elapsed().as_millis() as u64, Ordering::Relaxed);
        match self.signal.load(Ordering::Relaxed) {
            0 => Ok(()),
            signal => Err(Failure::Stopped(i32::try_from(signal).unwrap_or(0))),
        }
    }

    /// For work that a signal shall not cut short: the same sign of life, and a flag that nobody sets.
    #[must_use]
    pub fn deaf(&self) -> Self {
        Self { signal: Arc::default(), ..self.clone() }
    }

    /// Time since the last sign of life.
    #[must_use]
    pub fn last_sign(&self) -> Duration {
        self.since.elapsed().saturating_sub(Duration::from_millis(self.sign.load(Ordering::Relaxed)))
    }
}
