//! TUM RGB-D folders: import as a stream of events, export from a recording.

use crate::codec::chunk::beside;
use crate::codec::image::{PictureHeader, decode_depth_png, encode_depth_png, encode_png};
use crate::error::{Error, Result};
use crate::import::camera_file::{format_camera, read_camera};
use crate::import::lists::{format_seconds, read_list};
use crate::recording::{Event, RecordingKind, RecordingReader, RecordingWriter};
use crate::types::{ColorEncoding, ColorFrame, DepthFrame, Sensor, TimestampNs};
use std::collections::BTreeSet;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Bytes of the largest picture file that is read.
const MAX_PICTURE_BYTES: u64 = 1 << 28;

/// One line of `rgb.txt` or `depth.txt`.
#[derive(Debug, Clone)]
struct Entry {
    timestamp_ns: TimestampNs,
    is_depth: bool,
    name: String,
}

/// A TUM RGB-D folder read as events in order of time (colour before depth at equal stamps).
pub struct TumReader {
    dir: PathBuf,
    sensor: Sensor,
    entries: Vec<Entry>,
    next: usize,
}

impl TumReader {
    /// Opens a folder: reads and checks `rgb.txt`, `depth.txt`, `camera.txt` and that every listed file is there.
    ///
    /// # Errors
    /// Missing folder, missing or empty lists, a line that cannot be read, a camera file that makes no sense.
    pub fn open(dir: &Path) -> Result<Self> {
        if !dir.is_dir() {
            return Err(Error::invalid(dir, "no such folder", "give a TUM RGB-D folder or an .lrec file"));
        }
        for list in ["rgb.txt", "depth.txt"] {
            if !dir.join(list).is_file() {
                return Err(Error::invalid(
                    dir,
                    format!("there is no {list}"),
                    "a TUM RGB-D folder holds rgb.txt, depth.txt and camera.txt",
                ));
            }
        }
        let sensor = read_camera(&dir.join("camera.txt"))?;
        let mut entries = Vec::new();
        for (list, is_depth) in [("rgb.txt", false), ("depth.txt", true)] {
            for (timestamp_ns, name) in read_list(&dir.join(list))? {
                let file = dir.join(&name);
                if !file.is_file() {
                    return Err(Error::invalid(
                        file,
                        format!("listed in {list}, but there is no such file"),
                        "restore it, or remove its line",
                    ));
                }
                entries.push(Entry { timestamp_ns, is_depth, name });
            }
        }
        entries.sort_by_key(|e| (e.timestamp_ns, e.is_depth));
        Ok(Self { dir: dir.to_path_buf(), sensor, entries, next: 0 })
    }

    /// The sensor described by the camera file.
    #[must_use]
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    /// Number of events.
    #[must_use]
    pub fn events(&self) -> usize {
        self.entries.len()
    }

    /// Event number `index`, in order of time; `None` beyond the end.
    ///
    /// # Errors
    /// A picture that is missing, truncated or of another size.
    pub fn event(&self, index: usize) -> Result<Option<Event>> {
        let Some(entry) = self.entries.get(index) else {
            return Ok(None);
        };
        let path = self.dir.join(&entry.name);
        let bytes = read_picture(&path)?;
        let event = if entry.is_depth { self.depth(entry, &bytes) } else { self.color(entry, bytes) };
        event
            .map(Some)
            .map_err(|problem| Error::invalid(path, problem, "replace the picture, or remove its line from the list"))
    }

    fn depth(&self, entry: &Entry, bytes: &[u8]) -> std::result::Result<Event, String> {
        let (width, height) = (self.sensor.depth.intrinsics.width, self.sensor.depth.intrinsics.height);
        let depth = decode_depth_png(bytes, width, height)?;
        Ok(Event::Depth(DepthFrame { timestamp_ns: entry.timestamp_ns, width, height, depth, missing_packets: 0 }))
    }

    fn color(&self, entry: &Entry, bytes: Vec<u8>) -> std::result::Result<Event, String> {
        let PictureHeader { encoding, width, height } = PictureHeader::read(&bytes)?;
        let expected = (self.sensor.color.intrinsics.width, self.sensor.color.intrinsics.height);
        if (width, height) != expected {
            return Err(format!("is {width}x{height}, but camera.txt says {}x{}", expected.0, expected.1));
        }
        let timestamp_ns = entry.timestamp_ns;
        Ok(Event::Color(ColorFrame { timestamp_ns, width, height, encoding, bytes, missing_packets: 0 }))
    }

    /// The next frame; `None` at the end.
    ///
    /// # Errors
    /// A picture that is missing, truncated or of another size.
    pub fn next_event(&mut self) -> Result<Option<Event>> {
        let event = self.event(self.next)?;
        self.next += 1;
        Ok(event)
    }
}

/// Reads a picture file of bounded size.
pub(crate) fn read_picture(path: &Path) -> Result<Vec<u8>> {
    let file = std::fs::File::open(path).map_err(|e| Error::io(path, e))?;
    let mut bytes = Vec::new();
    file.take(MAX_PICTURE_BYTES + 1).read_to_end(&mut bytes).map_err(|e| Error::io(path, e))?;
    if bytes.len() as u64 > MAX_PICTURE_BYTES {
        return Err(Error::invalid(path, "picture file too large", "give pictures below 256 MiB"));
    }
    Ok(bytes)
}

/// Copies a TUM RGB-D folder into a recording.
///
/// # Errors
/// Whatever [`TumReader`] finds, or the recording cannot be written; nothing is left behind then.
pub fn import_tum(dir: &Path, recording: &Path) -> Result<()> {
    let mut reader = TumReader::open(dir)?;
    let mut writer = RecordingWriter::create(recording, RecordingKind::Frames, reader.sensor())?;
    while let Some(event) = reader.next_event()? {
        writer.write(&event)?;
    }
    writer.finish()
}

/// Writes a recording as a TUM RGB-D folder, frame for frame, with the same time stamps and depth values. JPEG and PNG
/// colour keeps its bytes, raw colour becomes PNG. Of a recording with a damaged tail everything before the damage is
/// written, and the damage reported.
///
/// # Errors
/// The recording is damaged or holds raw packets, `dir` exists and is not empty, or cannot be written.
pub fn export_tum(recording: &mut RecordingReader, dir: &Path) -> Result<()> {
    if recording.kind() != RecordingKind::Frames {
        return Err(Error::invalid(
            dir,
            "the recording holds raw USB packets, no frames",
            "replay it into frames first",
        ));
    }
    if std::fs::read_dir(dir).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(Error::invalid(dir, "the folder exists and is not empty", "remove it, or choose another name"));
    }
    let part = beside(dir, ".part")?;
    let exported = TumWriter::create(&part).and_then(|mut writer| {
        let outcome = writer.copy(recording);
        writer.finish(recording.sensor())?;
        Ok(outcome)
    });
    match exported {
        Ok(outcome) => {
            std::fs::rename(&part, dir).map_err(|e| Error::io(dir, e))?;
            outcome
        }
        Err(error) => {
            let _ = std::fs::remove_dir_all(&part);
            Err(error)
        }
    }
}

/// The two lists and two folders of a TUM folder under way.
struct TumWriter {
    dir: PathBuf,
    lists: [String; 2],
    /// Names in use: stamps need not be unique.
    names: BTreeSet<String>,
}

impl TumWriter {
    fn create(dir: &Path) -> Result<Self> {
        if dir.exists() {
            std::fs::remove_dir_all(dir).map_err(|e| Error::io(dir, e))?;
        }
        for sub in ["rgb", "depth"] {
            let sub = dir.join(sub);
            std::fs::create_dir_all(&sub).map_err(|e| Error::io(sub, e))?;
        }
        let lists = ["color images", "depth maps"].map(|what| format!("# {what}\n# timestamp filename\n"));
        Ok(Self { dir: dir.to_path_buf(), lists, names: BTreeSet::new() })
    }

    fn copy(&mut self, recording: &mut RecordingReader) -> Result<()> {
        while let Some(event) = recording.next_event()? {
            let unwritable = |e: String| Error::invalid(&self.dir, e, "the recording is damaged: record again");
            match event {
                Event::Color(c) => match c.encoding {
                    ColorEncoding::Jpeg => self.add(0, c.timestamp_ns, "jpg", &c.bytes)?,
                    ColorEncoding::Png => self.add(0, c.timestamp_ns, "png", &c.bytes)?,
                    ColorEncoding::BayerGrbg | ColorEncoding::Rgb => {
                        let rgb = c.decode().map_err(unwritable)?;
                        let png = encode_png(c.width, c.height, png::ColorType::Rgb, &rgb.data).map_err(unwritable)?;
                        self.add(0, c.timestamp_ns, "png", &png)?;
                    }
                },
                Event::Depth(d) => {
                    let png = encode_depth_png(d.width, d.height, &d.depth).map_err(unwritable)?;
                    self.add(1, d.timestamp_ns, "png", &png)?;
                }
                Event::Accelerometer(_) | Event::Packet(_) => {}
            }
        }
        Ok(())
    }

    fn add(&mut self, list: usize, stamp: TimestampNs, extension: &str, bytes: &[u8]) -> Result<()> {
        let stamp = format_seconds(stamp);
        let stem = format!("{}/{stamp}", ["rgb", "depth"][list]);
        let mut name = format!("{stem}.{extension}");
        let mut copy = 1;
        while !self.names.insert(name.clone()) {
            copy += 1;
            name = format!("{stem}-{copy}.{extension}");
        }
        let path = self.dir.join(&name);
        std::fs::write(&path, bytes).map_err(|e| Error::io(path, e))?;
        self.lists[list] += &format!("{stamp} {name}\n");
        Ok(())
    }

    fn finish(self, sensor: &Sensor) -> Result<()> {
        let files =
            [("rgb.txt", &self.lists[0]), ("depth.txt", &self.lists[1]), ("camera.txt", &format_camera(sensor))];
        for (name, text) in files {
            let path = self.dir.join(name);
            std::fs::write(&path, text).map_err(|e| Error::io(path, e))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::tum_folder;

    fn all(dir: &Path) -> Vec<Event> {
        let mut reader = TumReader::open(dir).unwrap();
        std::iter::from_fn(|| reader.next_event().unwrap()).collect()
    }

    #[test]
    fn events_come_in_order_of_time() {
        let dir = tum_folder(3);
        let events = all(dir.path());
        let kinds: Vec<(TimestampNs, bool)> = events
            .iter()
            .map(|e| match e {
                Event::Depth(d) => (d.timestamp_ns, true),
                Event::Color(c) => (c.timestamp_ns, false),
                _ => panic!("neither depth nor colour"),
            })
            .collect();
        let ms = 1_000_000;
        assert_eq!(
            kinds,
            [(0, false), (0, true), (33 * ms, false), (43 * ms, true), (66 * ms, false), (86 * ms, true)]
        );
        let Event::Color(color) = &events[0] else { panic!() };
        assert_eq!((color.width, color.height, color.encoding), (32, 24, ColorEncoding::Jpeg));
        assert_eq!(color.decode().unwrap().data.len(), 32 * 24 * 3);
        let Event::Depth(depth) = &events[1] else { panic!() };
        assert_eq!(depth.depth[33], 1033);
    }

    #[test]
    fn what_is_wrong_with_a_folder_is_said() {
        let message = |dir: &Path| match TumReader::open(dir) {
            Err(e) => e.to_string(),
            Ok(mut reader) => loop {
                match reader.next_event() {
                    Ok(Some(_)) => {}
                    Ok(None) => break String::new(),
                    Err(e) => break e.to_string(),
                }
            },
        };
        assert!(message(Path::new("/nowhere")).contains("no such folder"));
        for file in ["rgb.txt", "depth.txt", "camera.txt", "depth/1.png", "rgb/1.jpg"] {
            let dir = tum_folder(2);
            std::fs::remove_file(dir.path().join(file)).unwrap();
            let m = message(dir.path());
            assert!(m.contains(file.split('/').next_back().unwrap().trim_end_matches(".txt")), "{file}: {m}");
            for truncated in [0, 1, 100] {
                let dir = tum_folder(2);
                let path = dir.path().join(file);
                let bytes = std::fs::read(&path).unwrap();
                let length = bytes.len() * truncated / 101;
                std::fs::write(&path, &bytes[..length]).unwrap();
                if !file.ends_with(".txt") || truncated == 0 {
                    assert!(message(dir.path()).contains(file), "{file} cut to {length} bytes");
                }
            }
        }
        let dir = tum_folder(2);
        std::fs::write(dir.path().join("camera.txt"), "30 30 16 12 5000 64 48").unwrap();
        assert!(message(dir.path()).contains("is 32x24"));
    }

    #[test]
    fn folder_to_recording_to_folder_is_exact() {
        let folder = tum_folder(4);
        let dir = tempfile::tempdir().unwrap();
        let (recording, back) = (dir.path().join("a.lrec"), dir.path().join("back"));
        import_tum(folder.path(), &recording).unwrap();
        export_tum(&mut RecordingReader::open(&recording).unwrap(), &back).unwrap();
        let (mut original, mut copy) = (TumReader::open(folder.path()).unwrap(), TumReader::open(&back).unwrap());
        assert_eq!(original.sensor(), copy.sensor());
        assert_eq!(original.events(), copy.events());
        while let Some(event) = original.next_event().unwrap() {
            assert!(copy.next_event().unwrap() == Some(event));
        }
        // Once more through a recording: the same bytes.
        let again = dir.path().join("b.lrec");
        import_tum(&back, &again).unwrap();
        assert!(std::fs::read(&recording).unwrap() == std::fs::read(&again).unwrap());
    }

    #[test]
    fn equal_stamps_and_raw_colour_are_exported() {
        let dir = tempfile::tempdir().unwrap();
        let (recording, folder) = (dir.path().join("a.lrec"), dir.path().join("folder"));
        let mut sensor = crate::testing::sensor();
        sensor.name = "TUM RGB-D folder".into();
        sensor.serial = String::new();
        let mut writer = RecordingWriter::create(&recording, RecordingKind::Frames, &sensor).unwrap();
        let events = crate::testing::events(2);
        events.iter().chain(&events).for_each(|e| writer.write(e).unwrap());
        writer.finish().unwrap();
        std::fs::create_dir(&folder).unwrap();
        export_tum(&mut RecordingReader::open(&recording).unwrap(), &folder).unwrap();
        let exported = all(&folder);
        assert_eq!(exported.len(), 8);
        assert_eq!(TumReader::open(&folder).unwrap().sensor(), &sensor);
        let frames = events.iter().filter(|e| !matches!(e, Event::Accelerometer(_))).flat_map(|e| [e, e]);
        for (a, b) in exported.iter().zip(frames) {
            match (a, b) {
                (Event::Color(a), Event::Color(b)) => {
                    assert_eq!(a.timestamp_ns, b.timestamp_ns);
                    assert_eq!(a.decode().unwrap(), b.decode().unwrap());
                }
                (Event::Depth(a), Event::Depth(b)) => {
                    assert_eq!((a.timestamp_ns, &a.depth), (b.timestamp_ns, &b.depth));
                }
                _ => panic!("another order"),
            }
        }
        let message = export_tum(&mut RecordingReader::open(&recording).unwrap(), &folder).unwrap_err().to_string();
        assert!(message.contains("not empty"), "{message}");
    }

    #[test]
    fn of_a_truncated_recording_the_prefix_is_exported() {
        let dir = tempfile::tempdir().unwrap();
        let (recording, folder) = (dir.path().join("a.lrec"), dir.path().join("folder"));
        import_tum(tum_folder(4).path(), &recording).unwrap();
        let bytes = std::fs::read(&recording).unwrap();
        std::fs::write(&recording, &bytes[..bytes.len() - 100]).unwrap();
        let outcome = export_tum(&mut RecordingReader::open(&recording).unwrap(), &folder);
        assert!(matches!(outcome, Err(Error::Truncated { .. })));
        assert_eq!(all(&folder).len(), 7);
    }

    #[test]
    fn a_failed_import_leaves_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let folder = tum_folder(3);
        std::fs::write(folder.path().join("depth/1.png"), "no picture").unwrap();
        assert!(import_tum(folder.path(), &dir.path().join("a.lrec")).is_err());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }
}
