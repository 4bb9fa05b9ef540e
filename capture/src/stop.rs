//! SIGINT and SIGTERM as a flag that long work looks at.

use crate::failure::Failure;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Set by the first SIGINT or SIGTERM.
#[derive(Debug, Clone, Default)]
pub struct Stop(Arc<AtomicUsize>);

impl Stop {
    /// From now on the signals no longer end the process by themselves.
    ///
    /// # Errors
    /// The system refuses the handler.
    pub fn on_signals() -> Result<Self, Failure> {
        let stop = Self::default();
        for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
            signal_hook::flag::register_usize(signal, Arc::clone(&stop.0), signal.unsigned_abs() as usize)
                .map_err(|e| Failure::Internal(format!("signal handler: {e}")))?;
        }
        Ok(stop)
    }

    /// # Errors
    /// [`Failure::Stopped`] once a signal came.
    pub fn check(&self) -> Result<(), Failure> {
        match self.0.load(Ordering::Relaxed) {
            0 => Ok(()),
            signal => Err(Failure::Stopped(i32::try_from(signal).unwrap_or(0))),
        }
    }
}
