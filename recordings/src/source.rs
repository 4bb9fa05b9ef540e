//! Frames from a TUM RGB-D folder or a recording, in any order: a replay in a loop runs forwards and backwards in turn.

use crate::error::{Error, Result};
use crate::import::tum::TumReader;
use crate::recording::{Event, RecordingKind, RecordingReader};
use crate::types::Sensor;
use std::path::Path;

/// Events by number. Memory: one event, and eight bytes for each event met in a recording.
pub enum FrameSource {
    /// A TUM RGB-D folder.
    Tum(TumReader),
    /// A recording of frames.
    Recording {
        /// The file.
        reader: RecordingReader,
        /// Where the events met so far begin, and at the end where the next one does.
        offsets: Vec<u64>,
    },
}

impl FrameSource {
    /// Opens a TUM RGB-D folder or an `.lrec` file.
    ///
    /// # Errors
    /// Whatever [`TumReader::open`] or [`RecordingReader::open`] finds, or a recording of raw packets.
    pub fn open(path: &Path) -> Result<Self> {
        if !path.exists() {
            let remedy = "give an .lrec file or a TUM RGB-D folder";
            return Err(Error::invalid(path, "no such file or folder", remedy));
        }
        if path.is_dir() {
            return Ok(Self::Tum(TumReader::open(path)?));
        }
        let reader = RecordingReader::open(path)?;
        if reader.kind() != RecordingKind::Frames {
            return Err(Error::invalid(path, "holds raw USB packets, no frames", "decode the packets first"));
        }
        let offsets = vec![reader.position()];
        Ok(Self::Recording { reader, offsets })
    }

    /// The sensor.
    #[must_use]
    pub fn sensor(&self) -> &Sensor {
        match self {
            Self::Tum(reader) => reader.sensor(),
            Self::Recording { reader, .. } => reader.sensor(),
        }
    }

    /// Event number `index`; `None` beyond the last. Neighbours of the last one asked for are cheap.
    ///
    /// # Errors
    /// A picture or chunk that is damaged; in a recording, events before it can be read.
    pub fn event(&mut self, index: usize) -> Result<Option<Event>> {
        match self {
            Self::Tum(reader) => reader.event(index),
            Self::Recording { reader, offsets } => {
                let mut at = index.min(offsets.len() - 1);
                reader.seek(offsets[at])?;
                loop {
                    let event = reader.next_event()?;
                    if event.is_some() && at + 1 == offsets.len() {
                        offsets.push(reader.position());
                    }
                    if event.is_none() || at == index {
                        return Ok(event);
                    }
                    at += 1;
                }
            }
        }
    }

    /// Share of the source that lies before event number `index`, as far as it is known.
    #[must_use]
    pub fn progress(&self, index: usize) -> f64 {
        match self {
            Self::Tum(reader) => (index as f64 / reader.events() as f64).min(1.0),
            Self::Recording { reader, offsets } => {
                let offset = offsets[index.min(offsets.len() - 1)];
                offset as f64 / reader.file_bytes() as f64
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::RecordingWriter;
    use crate::testing::{events, sensor, tum_folder};

    #[test]
    fn both_kinds_are_read_in_any_order() {
        let dir = tum_folder(3);
        let path = dir.path().join("a.lrec");
        let mut writer = RecordingWriter::create(&path, RecordingKind::Frames, &sensor()).unwrap();
        events(4).iter().for_each(|e| writer.write(e).unwrap());
        writer.finish().unwrap();
        let mut source = FrameSource::open(&path).unwrap();
        for index in [3, 0, 11, 5, 4, 3, 11, 0] {
            assert_eq!(source.event(index).unwrap().as_ref(), Some(&events(4)[index]), "{index}");
        }
        assert_eq!(source.event(12).unwrap(), None);
        assert_eq!(source.event(99).unwrap(), None);
        assert!(source.progress(6) > 0.3 && source.progress(6) < 0.7 && source.progress(12) <= 1.0);

        let mut source = FrameSource::open(dir.path()).unwrap();
        let last = source.event(5).unwrap();
        assert!(last.is_some() && source.event(0).unwrap().is_some() && source.event(5).unwrap() == last);
        assert_eq!(source.event(6).unwrap(), None);
    }

    #[test]
    fn a_truncated_recording_gives_its_prefix_then_an_error() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.lrec");
        let mut writer = RecordingWriter::create(&path, RecordingKind::Frames, &sensor()).unwrap();
        events(4).iter().for_each(|e| writer.write(e).unwrap());
        writer.finish().unwrap();
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 20]).unwrap();
        let mut source = FrameSource::open(&path).unwrap();
        for index in 0..11 {
            assert_eq!(source.event(index).unwrap().as_ref(), Some(&events(4)[index]));
        }
        assert!(matches!(source.event(11), Err(Error::Truncated { .. })));
        assert_eq!(source.event(10).unwrap().as_ref(), Some(&events(4)[10]));
    }

    #[test]
    fn what_cannot_be_replayed_is_named() {
        let message = |path: &Path| FrameSource::open(path).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(message(Path::new("/nowhere")).contains("no such file or folder"));
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.lrec");
        std::fs::write(&path, "no recording").unwrap();
        assert!(message(&path).contains("not a Lumiscan file"));
        RecordingWriter::create(&path, RecordingKind::Packets, &sensor()).unwrap().finish().unwrap();
        assert!(message(&path).contains("raw USB packets"));
    }
}
