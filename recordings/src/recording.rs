//! RGB-D recordings (`.lrec`): a sensor header, then time-stamped events in the order they came.

use crate::error::Result;
use crate::types::{Accelerometer, ColorFrame, DepthFrame, Sensor, UsbPacket};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What a recording holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum RecordingKind {
    /// Depth and colour frames.
    Frames,
    /// Raw USB packets.
    Packets,
}

/// One thing the sensor said.
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

/// Writes a recording; nothing is visible under its name before [`RecordingWriter::finish`].
pub struct RecordingWriter {}

impl RecordingWriter {
    /// Starts a recording beside `path`.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn create(_path: &Path, _kind: RecordingKind, _sensor: &Sensor) -> Result<Self> {
        unimplemented!()
    }
    /// Appends an event.
    ///
    /// # Errors
    /// The disk is full or gone.
    pub fn write(&mut self, _event: &Event) -> Result<()> {
        unimplemented!()
    }
    /// Flushes, syncs and renames into place.
    ///
    /// # Errors
    /// The disk is full or gone.
    pub fn finish(self) -> Result<()> {
        unimplemented!()
    }
}

/// Reads a recording, event by event, with memory for one event.
pub struct RecordingReader {}

impl RecordingReader {
    /// Opens a recording and reads its header.
    ///
    /// # Errors
    /// Unreadable, no recording, or of a newer version.
    pub fn open(_path: &Path) -> Result<Self> {
        unimplemented!()
    }
    /// What it holds.
    #[must_use]
    pub fn kind(&self) -> RecordingKind {
        unimplemented!()
    }
    /// The sensor.
    #[must_use]
    pub fn sensor(&self) -> &Sensor {
        unimplemented!()
    }
    /// The next event; `None` at the end. After an error (damaged chunk) there is no further event.
    ///
    /// # Errors
    /// A damaged or truncated chunk; everything before it has been delivered.
    pub fn next_event(&mut self) -> Result<Option<Event>> {
        unimplemented!()
    }
}
