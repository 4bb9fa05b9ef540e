//! SIGINT and SIGTERM as a flag that long-running work checks; each check is also a heartbeat.

use crate::failure::Failure;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// Set by SIGINT or SIGTERM. Every check counts as a heartbeat for the service manager's watchdog.
#[derive(Debug, Clone)]
pub struct Stop {
    signal: Arc<AtomicUsize>,
    /// Milliseconds from `since` to the last heartbeat.
    heartbeat: Arc<AtomicU64>,
    since: Instant,
}

impl Default for Stop {
    fn default() -> Self {
        Self { signal: Arc::default(), heartbeat: Arc::default(), since: Instant::now() }
    }
}

impl Stop {
    /// Installs the handlers: from now on the signals only set the flag.
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
        self.heartbeat.store(self.since.elapsed().as_millis() as u64, Ordering::Relaxed);
        match self.signal.load(Ordering::Relaxed) {
            0 => Ok(()),
            signal => Err(Failure::Stopped(i32::try_from(signal).unwrap_or(0))),
        }
    }

    /// True once a signal came; no heartbeat.
    #[must_use]
    pub fn is_set(&self) -> bool {
        self.signal.load(Ordering::Relaxed) != 0
    }

    /// For work that a signal must not interrupt: shares the heartbeat, and its flag is never set.
    #[must_use]
    pub fn without_signals(&self) -> Self {
        Self { signal: Arc::default(), ..self.clone() }
    }

    /// Time since the last heartbeat.
    #[must_use]
    pub fn since_heartbeat(&self) -> Duration {
        self.since.elapsed().saturating_sub(Duration::from_millis(self.heartbeat.load(Ordering::Relaxed)))
    }
}
