//! The clock.

use std::time::Instant;

/// A clock. On a simulated machine, time passes as work is reported.
pub trait Machine: Sync {
    /// Seconds since the run began.
    fn now(&self) -> f64;
    /// Reports finished work, in reference seconds.
    fn worked(&self, _reference_seconds: f64) {}
}

/// The clock of this machine.
#[derive(Debug)]
pub struct WallClock(Instant);

impl WallClock {
    /// Starts the clock.
    #[must_use]
    pub fn start() -> Self {
        Self(Instant::now())
    }
}

impl Machine for WallClock {
    fn now(&self) -> f64 {
        self.0.elapsed().as_secs_f64()
    }
}
