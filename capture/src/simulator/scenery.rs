//! What a simulated Kinect sees, as the bytes of its frames. At the end of a recording its last picture stands.

use crate::simulator::depth_encoder::{DepthEncoder, pack};
use crate::simulator::plan::{Scenery, SimPlan};
use firmware_config::kinect_models::{BAYER_VGA, StreamFormat};
use recordings::recording::{Event, RecordingReader};
use recordings::types::{ColorEncoding, ColorFrame};
use std::path::PathBuf;
use std::sync::Arc;

/// A frame as it goes over the wire.
type Bytes = Arc<[u8]>;

/// Different pictures of the pattern.
const PATTERNS: usize = 8;
/// Nanoseconds between frames.
const PERIOD_NS: i64 = 33_333_333;

/// Frames by their number.
pub enum Player {
    /// Prepared frames, repeated: `[picture]` of depth and colour.
    Pattern(Vec<(Bytes, Bytes)>),
    /// A recording, decoded as it plays.
    Recording(Box<Playback>),
}

/// A recording of frames, on the simulated device's frame clock.
pub struct Playback {
    path: PathBuf,
    reader: Option<RecordingReader>,
    encoder: DepthEncoder,
    /// Millimetres per unit of its depth.
    unit_mm: f64,
    color_format: &'static StreamFormat,
    first_ns: Option<i64>,
    depth: Option<(u64, Bytes)>,
    color: Option<(u64, Bytes)>,
    /// Frames that repeat the first picture.
    hold: u64,
    /// The last frames, repeated at the end.
    last: (Option<Bytes>, Option<Bytes>),
}

impl Player {
    /// Opens the plan's pictures.
    ///
    /// # Errors
    /// The recording cannot be read, or is not of 640×480.
    pub fn open(
        plan: &SimPlan,
        encoder: DepthEncoder,
        depth: &StreamFormat,
        color: &'static StreamFormat,
    ) -> Result<Self, String> {
        match &plan.scenery {
            Scenery::Pattern => Ok(Self::Pattern((0..PATTERNS).map(|k| pattern(k, depth, color)).collect())),
            Scenery::Recording(path) => {
                let reader = RecordingReader::open(path).map_err(|e| e.to_string())?;
                let sensor = reader.sensor().clone();
                for i in [sensor.depth.intrinsics, sensor.color.intrinsics] {
                    if (i.width, i.height) != (BAYER_VGA.width, BAYER_VGA.height) {
                        return Err(format!("{}: a simulated Kinect plays 640x480 only", path.display()));
                    }
                }
                Ok(Self::Recording(Box::new(Playback {
                    path: path.clone(),
                    reader: Some(reader),
                    encoder,
                    unit_mm: sensor.depth_unit_m * 1e3,
                    color_format: color,
                    first_ns: None,
                    depth: None,
                    color: None,
                    hold: plan.hold,
                    last: (None, None),
                })))
            }
        }
    }

    /// Bytes of the depth and colour frame number `frame` (numbers ascend from call to call); `None` where the device
    /// has none at that time.
    pub fn frame(&mut self, frame: u64) -> (Option<Bytes>, Option<Bytes>) {
        match self {
            Self::Pattern(pictures) => {
                let (depth, color) = &pictures[(frame % PATTERNS as u64) as usize];
                (Some(Arc::clone(depth)), Some(Arc::clone(color)))
            }
            Self::Recording(playback) => playback.frame(frame),
        }
    }
}

/// A tilted plane over a gradient; both depend on `k`.
fn pattern(k: usize, depth: &StreamFormat, color: &StreamFormat) -> (Bytes, Bytes) {
    let raw: Vec<u16> = (0..(depth.width * depth.height) as usize)
        .map(|i| (400 + 8 * k + (i / depth.width as usize) / 2) as u16)
        .collect();
    let mosaic = (0..color.frame_bytes()).map(|i| (i / 7 + 29 * k) as u8).collect();
    (pack(&raw, depth.bits).into(), mosaic)
}

impl Playback {
    fn frame(&mut self, frame: u64) -> (Option<Bytes>, Option<Bytes>) {
        while (self.depth.is_none() || self.color.is_none()) && self.read_one() {}
        if frame < self.hold {
            let first = |slot: &Option<(u64, Bytes)>| slot.as_ref().map(|(_, bytes)| Bytes::clone(bytes));
            return (first(&self.depth), first(&self.color));
        }
        if self.reader.is_none() && self.depth.is_none() && self.color.is_none() {
            return self.last.clone();
        }
        let frame = frame - self.hold;
        let take = |slot: &mut Option<(u64, Bytes)>| match slot {
            Some((at, _)) if *at <= frame => slot.take().map(|(_, bytes)| bytes),
            _ => None,
        };
        let now = (take(&mut self.depth), take(&mut self.color));
        let remember = |last: &mut Option<Bytes>, new: &Option<Bytes>| {
            if new.is_some() {
                last.clone_from(new);
            }
        };
        remember(&mut self.last.0, &now.0);
        remember(&mut self.last.1, &now.1);
        now
    }

    /// Reads an event; false at the end. Of two frames in one period of the device, the later is played.
    fn read_one(&mut self) -> bool {
        let event = match self.reader.as_mut().map(RecordingReader::next_event) {
            Some(Ok(Some(event))) => event,
            Some(Err(e)) => {
                tracing::warn!("{}: {e}", self.path.display());
                self.reader = None;
                return false;
            }
            _ => {
                self.reader = None;
                return false;
            }
        };
        let (time, is_depth) = match &event {
            Event::Depth(d) => (d.timestamp_ns, true),
            Event::Color(c) => (c.timestamp_ns, false),
            _ => return true,
        };
        let first = *self.first_ns.get_or_insert(time);
        let at = u64::try_from((time.saturating_sub(first).saturating_add(PERIOD_NS / 2)) / PERIOD_NS).unwrap_or(0);
        match event {
            Event::Depth(d) if is_depth => {
                let mm: Vec<u16> = d.depth.iter().map(|&v| (f64::from(v) * self.unit_mm).round() as u16).collect();
                self.depth = Some((at, self.encoder.encode(&mm).into()));
            }
            Event::Color(c) => {
                if let Some(mosaic) = mosaic(c, self.color_format) {
                    self.color = Some((at, mosaic));
                }
            }
            _ => {}
        }
        true
    }
}

/// The image behind the Bayer filter (GRBG).
fn mosaic(color: ColorFrame, format: &StreamFormat) -> Option<Bytes> {
    if color.encoding == ColorEncoding::BayerGrbg && *format == BAYER_VGA {
        return (color.bytes.len() == BAYER_VGA.frame_bytes()).then(|| color.bytes.into());
    }
    let rgb = color.decode().ok()?;
    let (width, height) = (format.width as usize, format.height as usize);
    // Larger images show the same columns, with more rows around the same centre.
    let scale = width / rgb.width as usize;
    let margin = (height - scale * rgb.height as usize) / 2;
    let value = |i: usize| {
        let (x, y) = (i % width, i / width);
        let channel = match (y % 2, x % 2) {
            (0, 1) => 0,
            (1, 0) => 2,
            _ => 1,
        };
        let row = (y.saturating_sub(margin) / scale).min(rgb.height as usize - 1);
        rgb.data[3 * (row * rgb.width as usize + x / scale) + channel]
    };
    Some((0..width * height).map(value).collect())
}
