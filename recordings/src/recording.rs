//! RGB-D recordings (`.lrec`): a sensor header, then time-stamped events in the order they came.

use crate::codec::chunk::{ChunkReader, ChunkWriter, Tag};
use crate::codec::depth::{DepthDecoder, DepthEncoder};
use crate::codec::header::{from_bytes, to_bytes};
use crate::error::{Error, Result};
use crate::types::{Accelerometer, ColorFrame, DepthFrame, Sensor, TimestampNs, UsbPacket};
use crate::v1::{AccelerometerV1, ColorV1, DepthV1, RecordingKindV1, RecordingV1};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::path::Path;

/// Kind of file.
pub const KIND: Tag = *b"LREC";
const VERSION: u32 = 1;
const HEAD: Tag = *b"HEAD";
const DEPTH: Tag = *b"DPTH";
const COLOR: Tag = *b"COLR";
const ACCELEROMETER: Tag = *b"ACCL";
const PACKETS: Tag = *b"PKTS";
const KNOWN: &[(Tag, u32)] =
    &[(HEAD, 1 << 16), (DEPTH, 1 << 26), (COLOR, (1 << 28) + 64), (ACCELEROMETER, 64), (PACKETS, 1 << 20)];

/// Bytes of the largest picture; its chunk may be longer by a header.
const MAX_PICTURE_BYTES: usize = 1 << 28;
/// Pixels of the largest depth image.
const MAX_DEPTH_PIXELS: u64 = 1 << 24;
/// Packets are gathered until a chunk holds this many bytes.
const PACKET_BATCH_BYTES: usize = 1 << 16;

/// What a recording holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum RecordingKind {
    /// Depth and colour frames.
    Frames,
    /// Raw USB packets.
    Packets,
}

/// One message of the sensor.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// A depth frame.
    Depth(DepthFrame),
    /// A colour frame.
    Color(ColorFrame),
    /// An accelerometer reading.
    Accelerometer(Accelerometer),
    /// A USB packet.
    Packet(UsbPacket),
}

impl Event {
    /// Its time stamp.
    #[must_use]
    pub fn timestamp_ns(&self) -> TimestampNs {
        match self {
            Self::Depth(d) => d.timestamp_ns,
            Self::Color(c) => c.timestamp_ns,
            Self::Accelerometer(a) => a.timestamp_ns,
            Self::Packet(p) => p.timestamp_ns,
        }
    }
}

/// Counters of one kind of frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct StreamSummary {
    /// Frames.
    pub frames: u64,
    /// Frames with missing packets.
    pub incomplete: u64,
    /// Packets missing, in all.
    pub missing_packets: u64,
}

impl StreamSummary {
    fn add(&mut self, missing_packets: u32) {
        self.frames += 1;
        self.incomplete += u64::from(missing_packets > 0);
        self.missing_packets += u64::from(missing_packets);
    }
}

/// What a recording amounts to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecordingSummary {
    /// What it holds.
    pub kind: RecordingKind,
    /// From the earliest to the latest time stamp, in seconds.
    pub duration_s: f64,
    /// Depth frames; none in a recording of packets.
    pub depth: StreamSummary,
    /// Colour frames; none in a recording of packets.
    pub color: StreamSummary,
    /// Accelerometer readings.
    pub accelerometer: u64,
    /// USB packets.
    pub packets: u64,
}

impl RecordingSummary {
    /// Reads a recording through, checking every chunk but decoding no picture.
    ///
    /// # Errors
    /// Unreadable, no recording, damaged or truncated.
    pub fn read(path: &Path) -> Result<Self> {
        let mut reader = RecordingReader::open(path)?;
        let (depth, color) = (StreamSummary::default(), StreamSummary::default());
        let mut summary = Self { kind: reader.kind, duration_s: 0.0, depth, color, accelerometer: 0, packets: 0 };
        let (mut first, mut last) = (TimestampNs::MAX, TimestampNs::MIN);
        loop {
            let begin = reader.file.offset();
            let Some(tag) = reader.file.next(&mut reader.payload)? else {
                break;
            };
            let stamps = summary.add(tag, &mut reader).map_err(|problem| Error::Damaged {
                path: path.to_path_buf(),
                offset: begin,
                problem,
            })?;
            for stamp in stamps {
                (first, last) = (first.min(stamp), last.max(stamp));
            }
        }
        if first < last {
            summary.duration_s = (last as f64 - first as f64) * 1e-9;
        }
        Ok(summary)
    }

    /// Counts the chunk in the reader's payload; its earliest and latest time stamp.
    fn add(&mut self, tag: Tag, reader: &mut RecordingReader) -> std::result::Result<[TimestampNs; 2], String> {
        if tag == DEPTH {
            let (head, _) = from_bytes::<DepthV1>(&reader.payload)?;
            self.depth.add(head.missing_packets);
            return Ok([head.timestamp_ns; 2]);
        }
        if let Some(event) = reader.parse(tag)? {
            match &event {
                Event::Color(color) => self.color.add(color.missing_packets),
                _ => self.accelerometer += 1,
            }
            return Ok([event.timestamp_ns(); 2]);
        }
        self.packets += reader.packets.len() as u64;
        let stamps = || reader.packets.iter().map(|p| p.timestamp_ns);
        let span = [stamps().min().unwrap_or(TimestampNs::MAX), stamps().max().unwrap_or(TimestampNs::MIN)];
        reader.packets.clear();
        Ok(span)
    }
}

/// Writes a recording; nothing is visible under its name before [`RecordingWriter::finish`].
pub struct RecordingWriter {
    file: ChunkWriter,
    kind: RecordingKind,
    depth_size: (u32, u32),
    color_size: (u32, u32),
    packets: Vec<u8>,
    coded: Vec<u8>,
    encoder: DepthEncoder,
}

impl RecordingWriter {
    /// Starts a recording beside `path`.
    ///
    /// # Errors
    /// The folder cannot be written, or the sensor's description makes no sense.
    pub fn create(path: &Path, kind: RecordingKind, sensor: &Sensor) -> Result<Self> {
        let refuse = |problem: String| Error::invalid(path, problem, "mend the sensor's description");
        check_sensor(sensor).map_err(refuse)?;
        let kind_v1 = match kind {
            RecordingKind::Frames => RecordingKindV1::Frames,
            RecordingKind::Packets => RecordingKindV1::Packets,
        };
        let head = to_bytes(&RecordingV1 { kind: kind_v1, sensor: sensor.into() }).map_err(refuse)?;
        let mut file = ChunkWriter::create(path, KIND, VERSION)?;
        file.write(HEAD, &[&head])?;
        let size = |camera: &crate::types::CameraModel| (camera.intrinsics.width, camera.intrinsics.height);
        let (depth_size, color_size) = (size(&sensor.depth), size(&sensor.color));
        Ok(Self {
            file,
            kind,
            depth_size,
            color_size,
            packets: Vec::new(),
            coded: Vec::new(),
            encoder: DepthEncoder::new(),
        })
    }

    /// Appends an event.
    ///
    /// # Errors
    /// The disk is full or gone, or the event is none of this recording's kind and sensor.
    pub fn write(&mut self, event: &Event) -> Result<()> {
        let path = self.file.path().to_path_buf();
        let refuse = |problem: String| Error::invalid(&path, problem, "start a recording that fits the sensor");
        let is_packet = matches!(event, Event::Packet(_));
        let is_frame = matches!(event, Event::Depth(_) | Event::Color(_));
        if (is_packet && self.kind != RecordingKind::Packets) || (is_frame && self.kind != RecordingKind::Frames) {
            return Err(refuse(format!("the event does not belong in a recording of {:?}", self.kind)));
        }
        if !is_packet {
            self.flush_packets()?;
        }
        match event {
            Event::Depth(d) => {
                let (w, h) = self.depth_size;
                if (d.width, d.height) != (w, h) || d.depth.len() as u64 != u64::from(w) * u64::from(h) {
                    return Err(refuse(format!("depth of {}x{}, the sensor has {w}x{h}", d.width, d.height)));
                }
                let head = DepthV1 { timestamp_ns: d.timestamp_ns, missing_packets: d.missing_packets };
                let head = to_bytes(&head).map_err(refuse)?;
                self.coded.clear();
                self.encoder.encode(&d.depth, w as usize, &mut self.coded);
                self.file.write(DEPTH, &[&head, &self.coded])
            }
            Event::Color(c) => {
                let (w, h) = self.color_size;
                if (c.width, c.height) != (w, h) {
                    return Err(refuse(format!("colour of {}x{}, the sensor has {w}x{h}", c.width, c.height)));
                }
                if c.bytes.len() > MAX_PICTURE_BYTES {
                    return Err(refuse(format!("a picture of {} bytes", c.bytes.len())));
                }
                let head = to_bytes(&ColorV1::from(c)).map_err(refuse)?;
                self.file.write(COLOR, &[&head, &c.bytes])
            }
            Event::Accelerometer(a) => {
                let v1 = AccelerometerV1 { timestamp_ns: a.timestamp_ns, acceleration: a.acceleration };
                self.file.write(ACCELEROMETER, &[&to_bytes(&v1).map_err(refuse)?])
            }
            Event::Packet(p) => self.write_packet(p.timestamp_ns, p.endpoint, &p.data),
        }
    }

    /// Appends a USB packet; packets are written in batches.
    ///
    /// # Errors
    /// As [`RecordingWriter::write`].
    pub fn write_packet(&mut self, timestamp_ns: i64, endpoint: u8, data: &[u8]) -> Result<()> {
        let refuse = |problem: &str| Error::invalid(self.file.path(), problem, "record again");
        if self.kind != RecordingKind::Packets {
            return Err(refuse("a packet does not belong in a recording of frames"));
        }
        let length = u16::try_from(data.len()).map_err(|_| refuse("a packet of 64 KiB"))?;
        self.packets.extend(timestamp_ns.to_le_bytes());
        self.packets.push(endpoint);
        self.packets.extend(length.to_le_bytes());
        self.packets.extend(data);
        if self.packets.len() >= PACKET_BATCH_BYTES { self.flush_packets() } else { Ok(()) }
    }

    fn flush_packets(&mut self) -> Result<()> {
        if !self.packets.is_empty() {
            self.file.write(PACKETS, &[&self.packets])?;
            self.packets.clear();
        }
        Ok(())
    }

    /// Flushes, syncs and renames into place.
    ///
    /// # Errors
    /// The disk is full or gone.
    pub fn finish(mut self) -> Result<()> {
        self.flush_packets()?;
        self.file.finish()
    }
}

fn check_sensor(sensor: &Sensor) -> std::result::Result<(), String> {
    if let Some(problem) = sensor.color.problem().or(sensor.depth.problem()) {
        return Err(problem.into());
    }
    let i = &sensor.depth.intrinsics;
    if u64::from(i.width) * u64::from(i.height) > MAX_DEPTH_PIXELS {
        return Err(format!("depth of {}x{} is too large", i.width, i.height));
    }
    Ok(())
}

/// Reads a recording, event by event, with memory for one event.
pub struct RecordingReader {
    file: ChunkReader,
    kind: RecordingKind,
    sensor: Sensor,
    /// Where the first event's chunk begins.
    first: u64,
    /// Set at the end and after an error.
    done: bool,
    payload: Vec<u8>,
    packets: VecDeque<UsbPacket>,
    decoder: DepthDecoder,
}

impl RecordingReader {
    /// Opens a recording and reads its header.
    ///
    /// # Errors
    /// Unreadable, no recording, or of a newer version.
    pub fn open(path: &Path) -> Result<Self> {
        let mut file = ChunkReader::open(path, KIND, VERSION, KNOWN)?;
        let mut payload = Vec::new();
        let invalid = |problem: String| Error::invalid(path, problem, "record or import it again");
        let tag = file.next(&mut payload)?;
        if tag != Some(HEAD) {
            return Err(invalid("a recording without a header".into()));
        }
        let (head, _) = from_bytes::<RecordingV1>(&payload).map_err(invalid)?;
        let sensor = Sensor::try_from(head.sensor).map_err(invalid)?;
        check_sensor(&sensor).map_err(invalid)?;
        let kind = match head.kind {
            RecordingKindV1::Frames => RecordingKind::Frames,
            RecordingKindV1::Packets => RecordingKind::Packets,
        };
        let first = file.offset();
        let (packets, decoder) = (VecDeque::new(), DepthDecoder::new());
        Ok(Self { file, kind, sensor, first, done: false, payload, packets, decoder })
    }

    /// What it holds.
    #[must_use]
    pub fn kind(&self) -> RecordingKind {
        self.kind
    }

    /// The sensor.
    #[must_use]
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    /// The next event; `None` at the end. After an error (damaged chunk) there is no further event.
    ///
    /// # Errors
    /// A damaged or truncated chunk; everything before it has been delivered.
    pub fn next_event(&mut self) -> Result<Option<Event>> {
        loop {
            if let Some(packet) = self.packets.pop_front() {
                return Ok(Some(Event::Packet(packet)));
            }
            if self.done {
                return Ok(None);
            }
            self.done = true;
            let begin = self.file.offset();
            let Some(tag) = self.file.next(&mut self.payload)? else {
                return Ok(None);
            };
            let event = self.parse(tag).map_err(|problem| Error::Damaged {
                path: self.file.path().to_path_buf(),
                offset: begin,
                problem,
            })?;
            self.done = false;
            if event.is_some() {
                return Ok(event);
            }
        }
    }

    /// Goes back to the first event.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn rewind(&mut self) -> Result<()> {
        self.seek(self.first)
    }

    /// Goes to a place that [`RecordingReader::position`] gave.
    pub(crate) fn seek(&mut self, offset: u64) -> Result<()> {
        self.packets.clear();
        self.done = false;
        self.file.seek(offset)
    }

    /// Where the next chunk begins.
    #[must_use]
    pub fn position(&self) -> u64 {
        self.file.offset()
    }

    /// Length of the file.
    #[must_use]
    pub fn file_bytes(&self) -> u64 {
        self.file.file_bytes()
    }

    /// The event of the chunk in `payload`; packets are queued instead.
    fn parse(&mut self, tag: Tag) -> std::result::Result<Option<Event>, String> {
        Ok(match tag {
            DEPTH => {
                let (head, coded) = from_bytes::<DepthV1>(&self.payload)?;
                let (width, height) = (self.sensor.depth.intrinsics.width, self.sensor.depth.intrinsics.height);
                let depth = self.decoder.decode(coded, width as usize, height as usize)?;
                let DepthV1 { timestamp_ns, missing_packets } = head;
                Some(Event::Depth(DepthFrame { timestamp_ns, width, height, depth, missing_packets }))
            }
            COLOR => {
                let (head, bytes) = from_bytes::<ColorV1>(&self.payload)?;
                let (width, height) = (self.sensor.color.intrinsics.width, self.sensor.color.intrinsics.height);
                if (head.width, head.height) != (width, height) {
                    return Err(format!("colour of {}x{}, the sensor has {width}x{height}", head.width, head.height));
                }
                Some(Event::Color(head.with_bytes(bytes)))
            }
            ACCELEROMETER => {
                let (AccelerometerV1 { timestamp_ns, acceleration }, _) = from_bytes(&self.payload)?;
                Some(Event::Accelerometer(Accelerometer { timestamp_ns, acceleration }))
            }
            PACKETS => {
                let (mut packets, mut rest) = (VecDeque::new(), self.payload.as_slice());
                while !rest.is_empty() {
                    let (packet, tail) = parse_packet(rest).ok_or("a packet ends early")?;
                    packets.push_back(packet);
                    rest = tail;
                }
                self.packets = packets;
                None
            }
            _ => return Err("a second header".into()),
        })
    }
}

fn parse_packet(bytes: &[u8]) -> Option<(UsbPacket, &[u8])> {
    let (stamp, rest) = bytes.split_first_chunk::<8>()?;
    let (&[endpoint], rest) = rest.split_first_chunk::<1>()?;
    let (length, rest) = rest.split_first_chunk::<2>()?;
    let (data, rest) = rest.split_at_checked(usize::from(u16::from_le_bytes(*length)))?;
    Some((UsbPacket { timestamp_ns: i64::from_le_bytes(*stamp), endpoint, data: data.to_vec() }, rest))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{events, packets, sensor};
    use proptest::prelude::*;
    use std::path::PathBuf;

    fn written(kind: RecordingKind, events: &[Event]) -> (tempfile::TempDir, PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.lrec");
        let mut writer = RecordingWriter::create(&path, kind, &sensor()).unwrap();
        events.iter().for_each(|e| writer.write(e).unwrap());
        writer.finish().unwrap();
        (dir, path)
    }

    /// Every event up to the end or the first error.
    fn read(path: &Path) -> (Vec<Event>, Result<()>) {
        let mut events = Vec::new();
        let mut reader = match RecordingReader::open(path) {
            Ok(reader) => reader,
            Err(e) => return (events, Err(e)),
        };
        loop {
            match reader.next_event() {
                Ok(Some(event)) => events.push(event),
                Ok(None) => return (events, Ok(())),
                Err(e) => {
                    assert_eq!(reader.next_event().unwrap(), None, "an event after an error");
                    return (events, Err(e));
                }
            }
        }
    }

    #[test]
    fn frames_come_back() {
        let (_dir, path) = written(RecordingKind::Frames, &events(4));
        let reader = RecordingReader::open(&path).unwrap();
        assert_eq!((reader.kind(), reader.sensor()), (RecordingKind::Frames, &sensor()));
        let (read_back, outcome) = read(&path);
        outcome.unwrap();
        assert_eq!(read_back, events(4));
    }

    #[test]
    fn packets_come_back_in_order() {
        let packets = packets(500);
        let (_dir, path) = written(RecordingKind::Packets, &packets);
        assert_eq!(read(&path).0, packets);
        let mut reader = RecordingReader::open(&path).unwrap();
        (0..100).for_each(|_| drop(reader.next_event().unwrap()));
        reader.rewind().unwrap();
        assert_eq!(reader.next_event().unwrap().as_ref(), packets.first());
        let summary = RecordingSummary::read(&path).unwrap();
        assert_eq!((summary.kind, summary.packets, summary.accelerometer), (RecordingKind::Packets, 499, 1));
        let bytes: usize = 499 * 700;
        assert!(std::fs::metadata(&path).unwrap().len() < (bytes + bytes / 10) as u64);
    }

    #[test]
    fn a_summary_counts_what_is_there() {
        let (_dir, path) = written(RecordingKind::Frames, &events(4));
        let summary = RecordingSummary::read(&path).unwrap();
        assert_eq!(summary.depth, StreamSummary { frames: 4, incomplete: 2, missing_packets: 3 });
        assert_eq!(summary.color, StreamSummary { frames: 4, incomplete: 1, missing_packets: 7 });
        assert_eq!((summary.accelerometer, summary.packets), (4, 0));
        assert!((summary.duration_s - 0.110).abs() < 1e-9, "{}", summary.duration_s);
    }

    #[test]
    fn events_of_another_kind_or_size_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.lrec");
        let mut writer = RecordingWriter::create(&path, RecordingKind::Frames, &sensor()).unwrap();
        assert!(writer.write(&packets(1)[0]).is_err());
        for event in events(1) {
            match event {
                Event::Depth(mut d) => {
                    d.depth.pop();
                    assert!(writer.write(&Event::Depth(d)).is_err());
                }
                Event::Color(mut c) => {
                    c.width = 31;
                    assert!(writer.write(&Event::Color(c)).is_err());
                }
                _ => {}
            }
        }
        let mut bad = sensor();
        bad.color.intrinsics.fx = f64::NAN;
        assert!(RecordingWriter::create(&path, RecordingKind::Frames, &bad).is_err());
    }

    #[test]
    fn every_truncation_gives_the_prefix_and_says_so() {
        let events = events(3);
        let (_dir, path) = written(RecordingKind::Frames, &events);
        let whole = std::fs::read(&path).unwrap();
        let mut longest = 0;
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            let (prefix, outcome) = read(&path);
            assert_eq!(prefix, events[..prefix.len()]);
            assert!(matches!(outcome, Err(Error::Truncated { .. } | Error::Invalid { .. })), "{length}");
            assert!(RecordingSummary::read(&path).is_err());
            longest = longest.max(prefix.len());
        }
        assert_eq!(longest, events.len());
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn damage_never_panics_nor_changes_an_event(at in any::<usize>(), bit in 0u8..8) {
            static WHOLE: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
            let whole = WHOLE.get_or_init(|| {
                let (_dir, path) = written(RecordingKind::Frames, &events(2));
                std::fs::read(path).unwrap()
            });
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("damaged");
            let mut bytes = whole.clone();
            let at = at % bytes.len();
            bytes[at] ^= 1 << bit;
            std::fs::write(&path, &bytes).unwrap();
            let (prefix, outcome) = read(&path);
            prop_assert!(outcome.is_err());
            prop_assert_eq!(&prefix[..], &events(2)[..prefix.len()]);
        }

        #[test]
        fn random_payloads_never_panic(payload in proptest::collection::vec(any::<u8>(), 0..200), tag in 0usize..5) {
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("a.lrec");
            let mut writer = RecordingWriter::create(&path, RecordingKind::Frames, &sensor()).unwrap();
            // The checksum is right, the contents are not.
            writer.file.write(KNOWN[tag].0, &[&payload]).unwrap();
            writer.finish().unwrap();
            let _ = read(&path);
            let _ = RecordingSummary::read(&path);
        }
    }
}
