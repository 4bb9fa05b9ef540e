//! Requests of the user: start, stop, pause, discard and name a scan.

use crate::failure::Failure;
use crate::lock::lock;
use crate::status::State;
use clap::ValueEnum;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

/// A request to the daemon, on the command line and on the control socket.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Request {
    /// Start a scan.
    Start,
    /// End the scan.
    Stop,
    /// Print the daemon's status.
    Status,
    /// Print an address of the web page that pairs one more browser.
    Pair,
}

impl Request {
    /// The word on the control socket.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Stop => "stop",
            Self::Status => "status",
            Self::Pair => "pair",
        }
    }
}

/// Requests of the user: set by the control socket, the web page and signals, taken by the daemon and by a watched replay.
#[derive(Debug, Clone, Default)]
pub struct Orders {
    start: Arc<AtomicBool>,
    stop: Arc<AtomicBool>,
    paused: Arc<AtomicBool>,
    discard: Arc<AtomicBool>,
    auto: Arc<AtomicBool>,
    name: Arc<Mutex<Option<String>>>,
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

    /// Orders a scan to start, if the state allows it.
    ///
    /// # Errors
    /// Why it does not.
    pub fn start_in(&self, state: State) -> Result<(), String> {
        match state {
            State::Ready => {
                self.start();
                Ok(())
            }
            State::Waiting => Err("no Kinect is plugged in; plug one in".into()),
            State::Done => Err("the recording has been played; start the command again".into()),
            _ => Err(format!("the box is {state}; wait for it to be ready")),
        }
    }

    /// Orders the scan to stop, if there is one.
    ///
    /// # Errors
    /// There is none.
    pub fn stop_in(&self, state: State) -> Result<(), String> {
        if state != State::Scanning {
            return Err(format!("there is no scan to stop: the box is {state}"));
        }
        self.stop();
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

    /// Orders the scan to stop, and not to be published.
    pub fn discard(&self) {
        self.discard.store(true, Ordering::Release);
        self.stop();
    }

    /// Pauses the scan, or resumes it.
    pub fn pause(&self, paused: bool) {
        self.paused.store(paused, Ordering::Release);
    }

    /// Lets motion of the sensor start scans and stillness end them, or not.
    pub fn set_auto(&self, auto: bool) {
        self.auto.store(auto, Ordering::Release);
    }

    /// True if motion starts scans and stillness ends them.
    #[must_use]
    pub fn is_auto(&self) -> bool {
        self.auto.load(Ordering::Acquire)
    }

    /// Names the scan.
    pub fn set_name(&self, name: &str) {
        *lock(&self.name) = Some(name.to_owned());
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

    /// True while the scan is paused.
    #[must_use]
    pub fn is_paused(&self) -> bool {
        self.paused.load(Ordering::Acquire)
    }

    /// True if the scan is to be thrown away.
    #[must_use]
    pub fn is_discarded(&self) -> bool {
        self.discard.load(Ordering::Acquire)
    }

    /// The name that the user gave to the scan.
    #[must_use]
    pub fn name(&self) -> Option<String> {
        lock(&self.name).clone()
    }

    /// Discards pending orders, and what concerned the last scan.
    pub fn clear(&self) {
        for order in [&self.start, &self.stop, &self.paused, &self.discard] {
            order.store(false, Ordering::Release);
        }
        *lock(&self.name) = None;
    }
}
