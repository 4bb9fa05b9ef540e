//! Colour and depth frames of a source, paired in order of time and played once or several times.

use crate::failure::Failure;
use crate::kinect::buffers::Buffers;
use crate::sources::pairing::{Decided, Pairer};
use crate::sources::sensor;
use crate::sources::source::Source;
use crate::sources::streaming::Streaming;
use firmware_config::CaptureConfig;
use recordings::recording::Event;
use recordings::scan::CaptureStats;
use recordings::source::FrameSource;
use recordings::types::{ColorFrame, DepthFrame, Sensor, TimestampNs};
use std::path::{Path, PathBuf};

/// A colour frame and the depth frame of the same instant, not yet decoded.
#[derive(Debug)]
pub struct RawPair {
    /// Colour; its time stamp continues over the turns of `--loop`.
    pub color: ColorFrame,
    /// Depth.
    pub depth: DepthFrame,
    /// Newest reading of the accelerometer: specific force in m/s², camera axes.
    pub acceleration: Option<[f32; 3]>,
    /// Share of the source that has been played, over all turns.
    pub played: f64,
}

/// The pairs of a source, played forward and backward in turns.
pub struct Pairs {
    source: Source,
    /// Number of the next event of the first turn.
    next: usize,
    path: PathBuf,
    pairer: Pairer<(usize, ColorFrame), (usize, DepthFrame)>,
    depth_offset_ns: i64,
    plays: u32,
    /// The events of each pair; only kept if the source is played more than once.
    index: Vec<Place>,
    replayed: Option<Replayed>,
    acceleration: Option<[f32; 3]>,
    stats: CaptureStats,
    span: Option<(TimestampNs, TimestampNs)>,
}

#[derive(Debug, Clone, Copy)]
struct Place {
    color: usize,
    depth: usize,
    time: TimestampNs,
}

/// State of the second and later turns.
struct Replayed {
    turns_left: u32,
    backward: bool,
    next: usize,
    /// Time on the continued clock of the newest pair.
    clock: TimestampNs,
    /// Time of that pair in the source.
    source_time: TimestampNs,
}

impl Pairs {
    /// Opens a recording or a TUM folder, to be played `plays` times.
    ///
    /// # Errors
    /// It does not exist or is damaged.
    pub fn open(path: &Path, plays: u32, config: &CaptureConfig) -> Result<Self, Failure> {
        let source = Source::open(path)?;
        if plays > 1 && !matches!(source, Source::Frames(_)) {
            let problem = "can be played once only; omit --loop, or record frames";
            return Err(Failure::Usage(format!("{}: {problem}", path.display())));
        }
        Ok(Self::new(source, path, plays, config))
    }

    /// The pairs of a streaming Kinect.
    #[must_use]
    pub fn live(streaming: Streaming, config: &CaptureConfig) -> Self {
        Self::new(Source::Kinect(Box::new(streaming)), Path::new("kinect"), 1, config)
    }

    fn new(source: Source, path: &Path, plays: u32, config: &CaptureConfig) -> Self {
        let stated = source.sensor().depth_to_color_offset_ns;
        let configured = ms_to_ns(config.depth_to_color_offset_ms);
        Self {
            pairer: Pairer::new(ms_to_ns(config.max_pair_gap_ms)),
            depth_offset_ns: if stated == 0 { configured } else { stated },
            source,
            next: 0,
            path: path.to_path_buf(),
            plays,
            index: Vec::new(),
            replayed: None,
            acceleration: None,
            stats: CaptureStats::default(),
            span: None,
        }
    }

    /// True if pairs are dropped where the consumer is slow, since the source does not wait.
    #[must_use]
    pub fn drops_when_slow(&self) -> bool {
        matches!(&self.source, Source::Kinect(k) if k.drops_when_slow())
    }

    /// Where the buffers of its frames go when they are done with.
    #[must_use]
    pub fn buffers(&self) -> Buffers {
        match &self.source {
            Source::Kinect(k) => k.buffers(),
            _ => Buffers::default(),
        }
    }

    /// The sensor; the configuration fills in what the source does not state.
    #[must_use]
    pub fn sensor(&self, config: &CaptureConfig) -> Sensor {
        let mut sensor = self.source.sensor().clone();
        sensor.depth_to_color_offset_ns = self.depth_offset_ns;
        if matches!(&self.source, Source::Frames(s) if matches!(**s, FrameSource::Tum(_))) {
            sensor.response = sensor::response(config.response);
        }
        sensor
    }

    /// The capture part of the counters.
    #[must_use]
    pub fn stats(&self) -> CaptureStats {
        let duration_s = self.span.map_or(0.0, |(first, last)| last.saturating_sub(first) as f64 * 1e-9);
        let missing_packets = self.source.missing_packets().unwrap_or(self.stats.missing_packets);
        CaptureStats { duration_s, missing_packets, ..self.stats.clone() }
    }

    /// The next pair; `None` at the end of the last turn.
    ///
    /// # Errors
    /// The source is damaged, or a frame is not of the size that the sensor's description states.
    pub fn next_pair(&mut self) -> Result<Option<RawPair>, Failure> {
        if self.replayed.is_none() {
            if let Some(pair) = self.next_forward()? {
                return Ok(Some(self.counted(pair)));
            }
            let (Some(last), true) = (self.index.last(), self.plays > 1) else { return Ok(None) };
            self.replayed = Some(Replayed {
                turns_left: self.plays - 1,
                backward: true,
                // The pair at the turning point is not played twice.
                next: self.index.len().saturating_sub(2),
                clock: last.time,
                source_time: last.time,
            });
        }
        let Some(pair) = self.next_replayed()? else { return Ok(None) };
        Ok(Some(self.counted(pair)))
    }

    fn counted(&mut self, pair: RawPair) -> RawPair {
        self.stats.pairs += 1;
        let t = pair.color.timestamp_ns;
        self.span = Some(self.span.map_or((t, t), |(first, last)| (first, last.max(t))));
        pair
    }

    fn next_forward(&mut self) -> Result<Option<RawPair>, Failure> {
        loop {
            match self.pairer.decide() {
                Some(Decided::Pair((color_at, color), (depth_at, depth))) => {
                    if self.plays > 1 {
                        self.index.push(Place { color: color_at, depth: depth_at, time: color.timestamp_ns });
                    }
                    let played = self.source.progress(self.next) / f64::from(self.plays);
                    return Ok(Some(RawPair { color, depth, acceleration: self.acceleration, played }));
                }
                Some(Decided::Color(_)) => self.stats.unpaired_color += 1,
                Some(Decided::Depth(_)) => self.stats.unpaired_depth += 1,
                None => match self.source.event(self.next, &self.path)? {
                    Some(event) => self.take(event)?,
                    None if self.pairer.end() => {}
                    None => return Ok(None),
                },
            }
        }
    }

    fn take(&mut self, event: Event) -> Result<(), Failure> {
        let number = self.next;
        self.next += 1;
        match event {
            Event::Color(c) => {
                self.count(c.missing_packets, true);
                self.check_size("colour", (c.width, c.height), c.timestamp_ns, self.source.sensor().color.intrinsics)?;
                self.pairer.push_color(c.timestamp_ns, (number, c));
            }
            Event::Depth(d) => {
                self.count(d.missing_packets, false);
                self.check_size("depth", (d.width, d.height), d.timestamp_ns, self.source.sensor().depth.intrinsics)?;
                self.pairer.push_depth(d.timestamp_ns.saturating_add(self.depth_offset_ns), (number, d));
            }
            Event::Accelerometer(a) => self.acceleration = Some(a.acceleration),
            Event::Packet(_) => {}
        }
        Ok(())
    }

    fn count(&mut self, missing_packets: u32, is_color: bool) {
        let frames = if is_color { &mut self.stats.color_frames } else { &mut self.stats.depth_frames };
        *frames += 1;
        self.stats.incomplete_frames += u64::from(missing_packets > 0);
        self.stats.missing_packets += u64::from(missing_packets);
    }

    fn check_size(
        &self,
        what: &str,
        (width, height): (u32, u32),
        time: TimestampNs,
        expected: recordings::types::Intrinsics,
    ) -> Result<(), Failure> {
        if (width, height) == (expected.width, expected.height) {
            return Ok(());
        }
        Err(Failure::Input(format!(
            "{}: the {what} frame at {:.6} s is {width}x{height}, but the sensor's is {}x{}; record or export it again",
            self.path.display(),
            time as f64 * 1e-9,
            expected.width,
            expected.height
        )))
    }

    /// The next pair of the second and later turns, read again by the numbers of its events.
    fn next_replayed(&mut self) -> Result<Option<RawPair>, Failure> {
        let Some(turn) = &mut self.replayed else { return Ok(None) };
        let Some(&place) = self.index.get(turn.next) else { return Ok(None) };
        if turn.turns_left == 0 || self.index.len() < 2 {
            return Ok(None);
        }
        let step = (place.time.saturating_sub(turn.source_time)).saturating_abs();
        (turn.clock, turn.source_time) = (turn.clock.saturating_add(step), place.time);
        let clock = turn.clock;
        let last = self.index.len() - 1;
        match (turn.backward, turn.next) {
            (true, 0) => (turn.backward, turn.next, turn.turns_left) = (false, 1, turn.turns_left - 1),
            (true, n) => turn.next = n - 1,
            (false, n) if n == last => {
                (turn.backward, turn.next, turn.turns_left) = (true, last - 1, turn.turns_left - 1)
            }
            (false, n) => turn.next = n + 1,
        }
        let (color, depth) = (self.source.event(place.color, &self.path)?, self.source.event(place.depth, &self.path)?);
        let (Some(Event::Color(mut color)), Some(Event::Depth(depth))) = (color, depth) else {
            return Err(Failure::Input(format!(
                "{}: the file changed while it was played; play a copy",
                self.path.display()
            )));
        };
        self.count(color.missing_packets, true);
        self.count(depth.missing_packets, false);
        color.timestamp_ns = clock;
        let played = (self.stats.pairs + 1) as f64 / (self.index.len() as f64 * f64::from(self.plays));
        Ok(Some(RawPair { color, depth, acceleration: self.acceleration, played }))
    }
}

fn ms_to_ns(ms: f64) -> i64 {
    (ms * 1e6).round() as i64
}
