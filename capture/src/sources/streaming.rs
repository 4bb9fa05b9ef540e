//! The frames of a live scan, and the conditions that end it. Frames before the end are kept, whatever ended it.

use crate::device_folder::disk::has_room;
use crate::kinect::buffers::Buffers;
use crate::kinect::driver::Led;
use crate::kinect::frame_queue::StreamKind;
use crate::kinect::live::{Live, Polled};
use crate::lock::lock;
use crate::orders::Orders;
use crate::sources::motion::Motion;
use crate::status::Board;
use crate::stop::Stop;
use firmware_config::DaemonConfig;
use recordings::recording::Event;
use recordings::types::{Sensor, TimestampNs};
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Time between two checks of the disk.
const DISK_INTERVAL: Duration = Duration::from_secs(2);

/// Why the capture of a scan has ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ending {
    /// The user ended it.
    Ordered,
    /// The sensor stands still.
    Still,
    /// It has reached `daemon.max_scan_s`.
    Longest,
    /// The service is being stopped.
    Terminated,
    /// The disk is nearly full.
    DiskFull,
    /// The Kinect was unplugged.
    Unplugged,
    /// The Kinect no longer answers.
    Failed(String),
}

impl Ending {
    /// The message for the user, if it was not an ordinary end.
    #[must_use]
    pub fn problem(&self) -> Option<String> {
        match self {
            Self::DiskFull => {
                Some("the disk is nearly full: the scan was ended; copy scans elsewhere and remove them".into())
            }
            Self::Unplugged => Some("the Kinect was unplugged: the scan was ended; plug it in again".into()),
            Self::Failed(problem) => Some(format!("the scan was ended: {problem}")),
            _ => None,
        }
    }
}

/// Where the daemon reads the reason of the end.
pub type EndingSlot = Arc<Mutex<Option<Ending>>>;

/// What ends a scan, and where its figures are shown.
pub struct Conditions {
    /// The user's requests.
    pub orders: Orders,
    /// The service manager's signals.
    pub stop: Stop,
    /// Receives the driver's figures.
    pub board: Arc<Board>,
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
    disk_checked: Instant,
    /// The silent stream that was last reported.
    silent: Option<StreamKind>,
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
            motion: Motion::new(&conditions.config),
            first: None,
            newest: TimestampNs::MIN,
            conditions,
            disk_checked: Instant::now(),
            silent: None,
            ending: EndingSlot::default(),
        }
    }

    /// The sensor.
    #[must_use]
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    /// Will hold the reason of the end.
    #[must_use]
    pub fn ending(&self) -> EndingSlot {
        Arc::clone(&self.ending)
    }

    /// True if frames are lost where the consumer is slow, as with a real sensor.
    #[must_use]
    pub fn drops_when_slow(&self) -> bool {
        !self.live.waits()
    }

    /// Where the buffers of its frames go when they are done with.
    #[must_use]
    pub fn buffers(&self) -> Buffers {
        self.live.buffers().clone()
    }

    /// Packets that did not arrive.
    #[must_use]
    pub fn missing_packets(&self) -> u64 {
        let s = self.live.stats().streams;
        s.depth.missing + s.color.missing
    }

    /// The next frame; `None` when the capture is over.
    pub fn next_event(&mut self) -> Option<Event> {
        loop {
            if let Some(frame) = self.frames.pop_front() {
                self.observe(&frame);
                return Some(frame);
            }
            if lock(&self.ending).is_some() {
                return None;
            }
            if let Some(ending) = self.ending_now() {
                return self.end(ending);
            }
            let frames = &mut self.frames;
            match self.live.poll(&mut |event| frames.push_back(event)) {
                Ok(Polled::Gone) => return self.end(Ending::Unplugged),
                Ok(_) => {}
                Err(e) if e.is_gone() => return self.end(Ending::Unplugged),
                Err(e) => return self.end(Ending::Failed(e.to_string())),
            }
            if let Some(stream) = self.live.silent_stream().filter(|s| self.silent != Some(*s)) {
                self.silent = Some(stream);
                self.conditions
                    .board
                    .error(&format!("no {stream} frames arrive; plug the Kinect into a USB 2 port of its own"));
            }
            self.conditions.board.driver(&self.live.stats(), self.live.exposure_us());
        }
    }

    fn observe(&mut self, frame: &Event) {
        match frame {
            Event::Color(c) => self.motion.add_color(c),
            Event::Depth(d) => self.motion.add_depth(d),
            _ => return,
        };
        let t = frame.timestamp_ns();
        self.first = Some(self.first.map_or(t, |f| f.min(t)));
        self.newest = self.newest.max(t);
    }

    fn ending_now(&mut self) -> Option<Ending> {
        let c = &self.conditions;
        let seconds = self.first.map_or(0.0, |f| self.newest.saturating_sub(f) as f64 * 1e-9);
        if c.stop.check().is_err() {
            Some(Ending::Terminated)
        } else if c.orders.take_stop() {
            Some(Ending::Ordered)
        } else if seconds >= c.config.max_scan_s {
            Some(Ending::Longest)
        } else if c.orders.is_auto() && self.motion.still_s() >= c.config.end_still_s {
            Some(Ending::Still)
        } else if self.disk_checked.elapsed() >= DISK_INTERVAL {
            self.disk_checked = Instant::now();
            // A missing folder is reported when the scan is written.
            (!has_room(&c.device, &c.config).unwrap_or(true)).then_some(Ending::DiskFull)
        } else {
            None
        }
    }

    fn end(&mut self, ending: Ending) -> Option<Event> {
        let mut slot = lock(&self.ending);
        if slot.is_none() {
            tracing::info!("the capture has ended: {ending:?}");
            self.live.set_led(if ending.problem().is_some() { Led::Error } else { Led::Busy });
            *slot = Some(ending);
        }
        None
    }
}
