//! State that the simulated bus, the opened device and its stream thread share.

use crate::lock::lock;
use crate::simulator::plan::SimPlan;
use firmware_config::kinect_models::DEPTH_ENDPOINT;
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// What the simulated device received and did.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SimLog {
    /// Input that a real Kinect would not accept.
    pub violations: Vec<String>,
    /// Depth stream.
    pub depth: SentCounts,
    /// Colour stream.
    pub color: SentCounts,
    /// State of the LED.
    pub led: u32,
    /// Sessions.
    pub opens: u32,
    /// Reads of the RGB sensor's registers.
    pub exposures: u32,
    /// Registers written, in order.
    pub writes: Vec<(u16, u16)>,
    /// True once every frame has been sent.
    pub over: bool,
    /// Times it was unplugged.
    pub unplugs: u32,
    /// When it was unplugged, while it is.
    pub unplugged_at: Option<Duration>,
}

/// State of the simulated device.
pub struct Shared {
    /// What happened.
    pub log: Mutex<SimLog>,
    /// Registers as written.
    pub registers: Mutex<BTreeMap<u16, u16>>,
    began: Instant,
    /// Nanoseconds of a simulated clock; `None` in real time.
    clock: Option<AtomicU64>,
}

impl Shared {
    /// A device in real time or, with `fast`, on a simulated clock.
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

    /// Waits until the clock shows `due`; false if `stop` was set meanwhile.
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

    /// Whether the registers switch the depth and the colour stream on.
    pub fn streams_on(&self) -> (bool, bool) {
        let registers = lock(&self.registers);
        (registers.get(&0x06) == Some(&2), registers.get(&0x05) == Some(&1))
    }

    /// Unplugs the device unless the plan's number is used up; true if it is unplugged.
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

/// Counters of what a stream sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SentCounts {
    /// Frames.
    pub frames: u64,
    /// Packets, including those lost on the way.
    pub packets: u64,
    /// Packets lost on the way.
    pub lost: u64,
    /// Packets truncated or garbled on the way.
    pub spoilt: u64,
}

impl SimLog {
    /// The counters of a stream.
    pub fn stream(&mut self, endpoint: u8) -> &mut SentCounts {
        if endpoint == DEPTH_ENDPOINT { &mut self.depth } else { &mut self.color }
    }
}
