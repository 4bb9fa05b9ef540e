//! Where events come from: a recording of frames or packets, a TUM folder, a Kinect, or OpenNI2.

use crate::failure::Failure;
use crate::kinect::decoder::Decoder;
use crate::sources::streaming::Streaming;
use recordings::recording::{Event, RecordingKind, RecordingReader};
use recordings::source::FrameSource;
use recordings::types::Sensor;
use std::collections::VecDeque;
use std::path::Path;

/// A source of events.
pub enum Source {
    /// A recording of frames or a TUM folder.
    Frames(Box<FrameSource>),
    /// A recording of USB packets, which are assembled and decoded again.
    Packets(Box<Packets>),
    /// A streaming Kinect.
    Kinect(Box<Streaming>),
    /// An `.oni` file.
    #[cfg(feature = "openni")]
    OpenNi(Box<crate::sources::openni::Device>),
}

/// A recording of packets, and the decoded frames that are still to be taken.
pub struct Packets {
    reader: RecordingReader,
    decoder: Decoder,
    frames: VecDeque<Event>,
}

impl Source {
    /// Opens a recording or a TUM folder.
    ///
    /// # Errors
    /// It does not exist or is damaged.
    pub fn open(path: &Path) -> Result<Self, Failure> {
        #[cfg(feature = "openni")]
        if path.extension().is_some_and(|e| e == "oni") {
            let device = crate::sources::openni::Device::open(&path.to_string_lossy());
            return Ok(Self::OpenNi(Box::new(device.map_err(|e| Failure::Input(format!("{}: {e}", path.display())))?)));
        }
        if path.is_file() {
            let reader = RecordingReader::open(path)?;
            if reader.kind() == RecordingKind::Packets {
                let packets = Packets { reader, decoder: Decoder::default(), frames: VecDeque::new() };
                return Ok(Self::Packets(Box::new(packets)));
            }
        }
        Ok(Self::Frames(Box::new(FrameSource::open(path)?)))
    }

    /// The sensor's description.
    pub fn sensor(&self) -> &Sensor {
        match self {
            Self::Frames(s) => s.sensor(),
            Self::Packets(p) => p.reader.sensor(),
            Self::Kinect(k) => k.sensor(),
            #[cfg(feature = "openni")]
            Self::OpenNi(o) => o.sensor(),
        }
    }

    /// Event number `index`; sources other than recordings of frames give their events in order only.
    ///
    /// # Errors
    /// The source is damaged.
    pub fn event(&mut self, index: usize, path: &Path) -> Result<Option<Event>, Failure> {
        match self {
            Self::Frames(s) => Ok(s.event(index)?),
            Self::Packets(p) => p.next_event(path),
            Self::Kinect(k) => Ok(k.next_event()),
            #[cfg(feature = "openni")]
            Self::OpenNi(o) => o.next_event().map_err(|e| Failure::Input(format!("{}: {e}", path.display()))),
        }
    }

    /// Share of the source before event number `index`; 0 where unknown.
    pub fn progress(&self, index: usize) -> f64 {
        match self {
            Self::Frames(s) => s.progress(index),
            Self::Packets(p) => p.reader.position() as f64 / p.reader.file_bytes() as f64,
            Self::Kinect(_) => 0.0,
            #[cfg(feature = "openni")]
            Self::OpenNi(_) => 0.0,
        }
    }

    /// Packets that did not arrive, where known, including those of frames that are missing altogether.
    pub fn missing_packets(&self) -> Option<u64> {
        let streams = match self {
            Self::Frames(_) => return None,
            #[cfg(feature = "openni")]
            Self::OpenNi(_) => return None,
            Self::Packets(p) => p.decoder.stats(),
            Self::Kinect(k) => return Some(k.missing_packets()),
        };
        Some(streams.depth.missing + streams.color.missing)
    }
}

impl Packets {
    fn next_event(&mut self, path: &Path) -> Result<Option<Event>, Failure> {
        loop {
            if let Some(frame) = self.frames.pop_front() {
                return Ok(Some(frame));
            }
            match self.reader.next_event()? {
                Some(Event::Packet(p)) => {
                    let frames = &mut self.frames;
                    self.decoder
                        .push(p.endpoint, p.timestamp_ns, &p.data, &mut |frame| frames.push_back(frame))
                        .map_err(|e| Failure::Input(format!("{}: {e}; record again", path.display())))?;
                }
                other => return Ok(other),
            }
        }
    }
}
