//! TUM RGB-D folders: import as a stream of events, export from a recording.

use crate::error::Result;
use crate::recording::{Event, RecordingReader};
use crate::types::Sensor;
use std::path::Path;

/// A TUM RGB-D folder read as events in order of time (colour before depth at equal stamps).
pub struct TumReader {}

impl TumReader {
    /// Opens a folder: reads and checks `rgb.txt`, `depth.txt`, `camera.txt` and that every listed file is there.
    ///
    /// # Errors
    /// Missing folder, missing or empty lists, a line that cannot be read, a camera file that makes no sense.
    pub fn open(_dir: &Path) -> Result<Self> {
        unimplemented!()
    }
    /// The sensor described by the camera file.
    #[must_use]
    pub fn sensor(&self) -> &Sensor {
        unimplemented!()
    }
    /// The next frame; `None` at the end.
    ///
    /// # Errors
    /// A picture that is missing, truncated or of another size.
    pub fn next_event(&mut self) -> Result<Option<Event>> {
        unimplemented!()
    }
}

/// Writes a recording as a TUM RGB-D folder, frame for frame, with the same time stamps and depth values.
///
/// # Errors
/// The recording is damaged, or the folder cannot be written.
pub fn export_tum(_recording: &mut RecordingReader, _dir: &Path) -> Result<()> {
    unimplemented!()
}
