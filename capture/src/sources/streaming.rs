//! A Kinect that streams into a scan: its frames, and when the scan is over. However it ends, what came before counts.

use crate::device_folder::disk::has_room;
use crate::kinect::driver::Led;
use crate::kinect::live::{Live, Polled};
use crate::orders::Orders;
use crate::sources::motion::Motion;
use crate::status::Board;
use crate::stop::Stop;
use firmware_config::DaemonConfig;
use recordings::recording::Event;
use recordings::types::{Sensor, TimestampNs};
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Between two looks at the disk.
const DISK_INTERVAL: Duration = Duration::from_secs(2);

/// Why a scan's capture is over.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ending {
    /// The user said so.
    Ordered,
    /// The sensor stands still.
    Still,
    /// It is as long as a scan may be.
    Longest,
    /// The service is to end.
    Terminated,
    /// The disk is nearly full.
    DiskFull,
    /// The Kinect was unplugged.
    Unplugged,
    /// The Kinect does not answer any more.
    Failed(String),
}

impl Ending {
    /// What the user should know of it.
    #[must_use]
    pub fn problem(&self) -> Option<String> {
        match self {
            Self::DiskFull => Some("the disk is nearly full: the scan was ended; fetch and remove some scans".into()),
            Self::Unplugged => Some("the Kinect was unplugged: the scan was ended; plug it in again".into()),
            Self::Failed(problem) => Some(format!("the scan was ended: {problem}")),
            _ => None,
        }
    }
}

/// Where the ending is left for the daemon.
pub type EndingSlot = Arc<Mutex<Option<Ending>>>;

/// What a scan's frames and its end depend on.
pub struct Conditions {
    /// To stop, by the user.
    pub orders: Orders,
    /// To end, by the service manager.
    pub stop: Stop,
    /// What is shown.
    pub board: Arc<Board>,
    /// Ends when the sensor stands still.
    pub auto: bool,
    /// Limits.
    pub config: DaemonConfig,
    /// Device folder.
    pub device: PathBuf,
}

/// Frames of a scan in progress.
pub struct Streaming {
    live: Live,
    sensor: Sensor,
    frames: VecDeque<Event>,
    motion: Motion,
    first: Option<TimestampNs>,
    newest: TimestampNs,
    conditions: Conditions,
    disk_seen: Instant,
    /// A stream that was found silent.
    silent: Option<&'static str>,
    ending: EndingSlot,
}

impl Streaming {
    /// Takes over a streaming Kinect.
    #[must_use]
    pub fn new(mut live: Live, sensor: Sensor, conditions: Conditions) -> Self {
        live.set_led(Led::Scanning);
        Self {
            frames: live.acceleration().map(Event::Accelerometer).into_iter().collect(),
            live,
            sensor,
            motion: Motion::new(conditions.config.motion),
            first: None,
            newest: TimestampNs::MIN,
            conditions,
            disk_seen: Instant::now(),
            silent: None,
            ending: EndingSlot::default(),
        }
    }

    /// The sensor.
    #[must_use]
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    /// Where the reason of the end will stand.
    #[must_use]
    pub fn ending(&self) -> EndingSlot {
        Arc::clone(&self.ending)
    }

    /// True if the sensor does not wait for who reads.
    #[must_use]
    pub fn gives_way(&self) -> bool {
        !self.live.waits()
    }

    /// Packets that did not come.
    #[must_use]
    pub fn missing_packets(&self) -> u64 {
        let s = self.live.stats().streams;
        s.depth.missing + s.color.missing
    }

    /// The next frame; `None` when the capture is over.
    pub fn next_event(&mut self) -> Option<Event> {
        loop {
            if let Some(frame) = self.frames.pop_front() {
                self.look_at(&frame);
                return Some(frame);
            }
            if self.ending.lock().unwrap_or_else(PoisonError::into_inner).is_some() {
                return None;
            }
            if let Some(ending) = self.over() {
                return self.end(ending);
            }
            let frames = &mut self.frames;
            match self.live.poll(&mut |_, _| {}, &mut |event| frames.push_back(event)) {
                Ok(Polled::Gone) => return self.end(Ending::Unplugged),
                Ok(_) => {}
                Err(e) if e.is_gone() => return self.end(Ending::Unplugged),
                Err(e) => return self.end(Ending::Failed(e.to_string())),
            }
            if let Some(stream) = self.live.silent_stream().filter(|s| self.silent != Some(*s)) {
                self.silent = Some(stream);
                self.conditions
                    .board
                    .error(&format!("no {stream} frames come; plug the Kinect into a USB 2 port of its own"));
            }
            self.conditions.board.driver(&self.live.stats(), self.live.exposure_us());
        }
    }

    fn look_at(&mut self, frame: &Event) {
        match frame {
            Event::Color(c) => self.motion.see_color(c),
            Event::Depth(d) => self.motion.see_depth(d),
            _ => return,
        };
        let t = frame.timestamp_ns();
        self.first = Some(self.first.map_or(t, |f| f.min(t)));
        self.newest = self.newest.max(t);
    }

    fn over(&mut self) -> Option<Ending> {
        let c = &self.conditions;
        let seconds = self.first.map_or(0.0, |f| self.newest.saturating_sub(f) as f64 * 1e-9);
        if c.stop.check().is_err() {
            Some(Ending::Terminated)
        } else if c.orders.take_stop() {
            Some(Ending::Ordered)
        } else if seconds >= c.config.max_scan_s {
            Some(Ending::Longest)
        } else if c.auto && self.motion.still_s() >= c.config.end_still_s {
            Some(Ending::Still)
        } else if self.disk_seen.elapsed() >= DISK_INTERVAL {
            self.disk_seen = Instant::now();
            // A folder that is gone is found when the scan is written.
            (!has_room(&c.device, &c.config).unwrap_or(true)).then_some(Ending::DiskFull)
        } else {
            None
        }
    }

    fn end(&mut self, ending: Ending) -> Option<Event> {
        let mut slot = self.ending.lock().unwrap_or_else(PoisonError::into_inner);
        if slot.is_none() {
            tracing::info!("the capture is over: {ending:?}");
            self.live.set_led(if ending.problem().is_some() { Led::Error } else { Led::Busy });
            *slot = Some(ending);
        }
        None
    }
}
