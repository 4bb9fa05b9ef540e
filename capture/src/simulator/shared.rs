//! State that the simulated bus, the opened device and its stream thread share.

use crate::simulator::plan::SimPlan;
use firmware_config::kinect_models::DEPTH_ENDPOINT;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// What the simulated device saw and did.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SimLog {
    /// Things that a real one would not have understood.
    pub complaints: Vec<String>,
    /// Depth stream.
    pub depth: Sent,
    /// Colour stream.
    pub color: Sent,
    /// Value of the LED.
    pub led: u32,
    /// Sessions.
    pub opens: u32,
    /// Readings of the RGB sensor's registers.
    pub exposures: u32,
    /// Registers written, in order.
    pub writes: Vec<(u16, u16)>,
    /// True once everything there was to see has been sent.
    pub over: bool,
    /// Times it was unplugged.
    pub unplugs: u32,
    /// When it was unplugged, while it is.
    pub unplugged_at: Option<Duration>,
}

/// What the bus, the opened device and its stream thread share.
pub struct Shared {
    /// What happened.
    pub log: Mutex<SimLog>,
    /// Registers as written.
    pub registers: Mutex<BTreeMap<u16, u16>>,
    began: Instant,
    /// Nanoseconds of a clock of its own; `None` in real time.
    clock: Option<AtomicU64>,
}

/// Locks, whatever another thread did.
pub fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    /// Of a device in real time, or (`fast`) on a clock of its own.
    #[must_use]
    pub fn new(fast: bool) -> Self {
        let clock = fast.then(AtomicU64::default);
        Self { log: Mutex::default(), registers: Mutex::default(), began: Instant::now(), clock }
    }

    /// Time since the start.
    #[must_use]
    pub fn now(&self) -> Duration {
        match &self.clock {
            Some(ns) => Duration::from_nanos(ns.load(Ordering::Relaxed)),
            None => self.began.elapsed(),
        }
    }

    /// Lets time pass.
    pub fn pause(&self, time: Duration) {
        match &self.clock {
            Some(ns) => {
                ns.fetch_add(time.as_nanos() as u64, Ordering::Relaxed);
                std::thread::yield_now();
            }
            None => std::thread::sleep(time),
        }
    }

    /// False if `stop` was set meanwhile.
    pub fn wait_until(&self, due: Duration, stop: &AtomicBool) -> bool {
        match &self.clock {
            Some(ns) => {
                ns.fetch_max(due.as_nanos() as u64, Ordering::Relaxed);
                if lock(&self.log).over {
                    std::thread::sleep(Duration::from_millis(1));
                }
            }
            None => {
                let left = due.saturating_sub(self.now());
                if !left.is_zero() {
                    std::thread::sleep(left);
                }
            }
        }
        !stop.load(Ordering::Relaxed)
    }

    /// Changes the log.
    pub fn counts(&self, count: impl FnOnce(&mut SimLog)) {
        count(&mut lock(&self.log));
    }

    /// Whether the registers say that depth and colour stream.
    pub fn streams_on(&self) -> (bool, bool) {
        let registers = lock(&self.registers);
        (registers.get(&0x06) == Some(&2), registers.get(&0x05) == Some(&1))
    }

    /// Pulls the plug, if that is still to happen.
    pub fn unplug(&self, plan: &SimPlan) -> bool {
        let now = self.now();
        let mut log = lock(&self.log);
        if log.unplugs >= plan.unplugs || log.unplugged_at.is_some() {
            return log.unplugged_at.is_some();
        }
        log.unplugs += 1;
        log.unplugged_at = Some(now);
        true
    }

    /// True unless it is unplugged.
    pub fn is_plugged(&self) -> bool {
        lock(&self.log).unplugged_at.is_none()
    }
}

/// What a stream of the simulated device really sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Sent {
    /// Frames.
    pub frames: u64,
    /// Packets, those that were lost on the way included.
    pub packets: u64,
    /// Packets lost on the way.
    pub lost: u64,
    /// Packets cut or garbled on the way.
    pub spoilt: u64,
}

impl SimLog {
    /// The counters of a stream.
    pub fn stream(&mut self, endpoint: u8) -> &mut Sent {
        if endpoint == DEPTH_ENDPOINT { &mut self.depth } else { &mut self.color }
    }
}
