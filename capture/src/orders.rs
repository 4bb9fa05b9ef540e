//! Requests to start and stop a scan.

use crate::failure::Failure;
use clap::ValueEnum;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A request to the daemon, on the command line and on the control socket.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Request {
    /// Start a scan.
    Start,
    /// End the scan.
    Stop,
    /// Print the daemon's status.
    Status,
}

impl Request {
    /// The word on the control socket.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Stop => "stop",
            Self::Status => "status",
        }
    }
}

/// Requests of the user to start and stop scans: set by the control socket and by signals, taken by the daemon.
#[derive(Debug, Clone, Default)]
pub struct Orders {
    start: Arc<AtomicBool>,
    stop: Arc<AtomicBool>,
}

impl Orders {
    /// Lets SIGUSR1 (start) and SIGUSR2 (stop) set them, too.
    ///
    /// # Errors
    /// The system refuses the handlers.
    pub fn by_signals(&self) -> Result<(), Failure> {
        for (signal, order) in [(signal_hook::consts::SIGUSR1, &self.start), (signal_hook::consts::SIGUSR2, &self.stop)]
        {
            signal_hook::flag::register(signal, Arc::clone(order))
                .map_err(|e| Failure::Internal(format!("signal handler: {e}")))?;
        }
        Ok(())
    }

    /// Orders a scan to start.
    pub fn start(&self) {
        self.start.store(true, Ordering::Release);
    }

    /// Orders the scan to stop.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Release);
    }

    /// True once for each order to start.
    #[must_use]
    pub fn take_start(&self) -> bool {
        self.start.swap(false, Ordering::AcqRel)
    }

    /// True once for each order to stop.
    #[must_use]
    pub fn take_stop(&self) -> bool {
        self.stop.swap(false, Ordering::AcqRel)
    }

    /// Discards pending orders.
    pub fn clear(&self) {
        self.start.store(false, Ordering::Release);
        self.stop.store(false, Ordering::Release);
    }
}
