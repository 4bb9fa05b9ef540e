//! Reading and writing of scan files.

use crate::codec::chunk::{ChunkReader, ChunkWriter, Tag, beside};
use crate::codec::header::{from_bytes, to_bytes};
use crate::error::{Error, Result};
use crate::import::lists::format_seconds;
use crate::scan::contents::{CaptureStats, FrameId, MESH_BYTES, Scan, ScanTail, check_frame, check_mesh};
use crate::types::{ColorFrame, Keyframe, Mesh, RawVec3};
use crate::v1::{ColorV1, KeyframeV1, ScanSourceV1, ScanV1, StatsV1};
use glam::Vec3;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Kind of file.
pub const KIND: Tag = *b"SCAN";
pub(super) const VERSION: u32 = 1;
pub(super) const HEAD: Tag = *b"HEAD";
const STATISTICS: Tag = *b"STAT";
const POSITIONS: Tag = *b"VERT";
const NORMALS: Tag = *b"NORM";
const TRIANGLES: Tag = *b"TRIA";
const KEYFRAME: Tag = *b"KEYF";
const WITNESS: Tag = *b"WITN";
const FRAME_BYTES: u32 = (1 << 28) + (1 << 16);
pub(super) const KNOWN: &[(Tag, u32)] = &[
    (HEAD, 1 << 24),
    (STATISTICS, 1 << 16),
    (POSITIONS, MESH_BYTES),
    (NORMALS, MESH_BYTES),
    (TRIANGLES, MESH_BYTES),
    (KEYFRAME, FRAME_BYTES),
    (WITNESS, FRAME_BYTES),
];

/// Writes a scan while it is captured: colour frames go to disk as they are chosen, the rest at the end. A candidate
/// that does not become a keyframe is left out of the finished file.
pub struct ScanWriter {
    path: PathBuf,
    spool: PathBuf,
    file: BufWriter<File>,
    /// Where each frame's bytes begin in the spool, and what is known of it besides.
    frames: BTreeMap<FrameId, (u64, ColorFrame)>,
    bytes: u64,
}

impl ScanWriter {
    /// Starts a scan beside `path`; nothing is visible under that name before [`ScanWriter::finish`].
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        let spool = beside(path, ".frames.part")?;
        let file = File::options().read(true).write(true).create(true).truncate(true).open(&spool);
        let file = BufWriter::new(file.map_err(|e| Error::io(&spool, e))?);
        Ok(Self { path: path.to_path_buf(), spool, file, frames: BTreeMap::new(), bytes: 0 })
    }

    /// Appends a candidate's colour frame under the id that fusion gave it.
    ///
    /// # Errors
    /// The disk is full or gone, or the id was given before.
    pub fn add_frame(&mut self, id: FrameId, color: &ColorFrame) -> Result<()> {
        if self.frames.contains_key(&id) {
            return Err(Error::invalid(&self.path, format!("frame {} was added twice", id.0), "add each frame once"));
        }
        self.file.write_all(&color.bytes).map_err(|e| Error::io(&self.spool, e))?;
        let described = ColorFrame { bytes: Vec::new(), ..*color };
        self.frames.insert(id, (self.bytes, described));
        self.bytes += color.bytes.len() as u64;
        Ok(())
    }

    /// Writes the finished file (only frames that `tail` names), syncs and renames it into place.
    ///
    /// # Errors
    /// The disk is full or gone, or `tail` names a frame that was never added.
    pub fn finish(mut self, tail: &ScanTail) -> Result<()> {
        self.file.flush().map_err(|e| Error::io(&self.spool, e))?;
        let head = ScanV1 {
            name: tail.name.clone(),
            source: ScanSourceV1::Fusion,
            sensor: (&tail.sensor).into(),
            config: tail.config.clone(),
            vertices: tail.mesh.positions.len() as u32,
            triangles: tail.mesh.triangles.len() as u32,
            keyframes: tail.keyframes.len() as u32,
            witnesses: tail.witnesses.len() as u32,
        };
        let mut writer = write_head(&self.path, &head, &tail.stats, &tail.mesh)?;
        for (tag, kept) in [(KEYFRAME, &tail.keyframes), (WITNESS, &tail.witnesses)] {
            for frame in kept {
                let color = self.read_back(frame.id)?;
                let name = format_seconds(color.timestamp_ns);
                let camera = tail.sensor.color;
                let keyframe = Keyframe { name, world_from_camera: frame.world_from_camera, camera, color };
                write_frame(&mut writer, tag, &keyframe)?;
            }
        }
        writer.finish()
    }

    fn read_back(&mut self, id: FrameId) -> Result<ColorFrame> {
        let Some((begin, color)) = self.frames.get(&id) else {
            return Err(Error::invalid(&self.path, format!("frame {} was never added", id.0), "add it before the end"));
        };
        let end = self.frames.values().map(|(b, _)| *b).filter(|b| b > begin).min().unwrap_or(self.bytes);
        let mut bytes = vec![0; (end - begin) as usize];
        let file = self.file.get_mut();
        file.seek(SeekFrom::Start(*begin))
            .and_then(|_| file.read_exact(&mut bytes))
            .map_err(|e| Error::io(&self.spool, e))?;
        Ok(ColorFrame { bytes, ..*color })
    }
}

impl Drop for ScanWriter {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.spool);
    }
}

/// Starts a scan file with everything but its frames.
fn write_head(path: &Path, head: &ScanV1, stats: &CaptureStats, mesh: &Mesh) -> Result<ChunkWriter> {
    let refuse = |problem: String| Error::invalid(path, problem, "this scan cannot be stored");
    check_mesh(mesh).map_err(refuse)?;
    let mut writer = ChunkWriter::create(path, KIND, VERSION)?;
    writer.write(HEAD, &[&to_bytes(head).map_err(refuse)?])?;
    writer.write(STATISTICS, &[&to_bytes(&StatsV1::from(stats)).map_err(refuse)?])?;
    let raw = |v: &[Vec3]| v.iter().flat_map(|v| v.to_array()).flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
    writer.write(POSITIONS, &[&raw(&mesh.positions)])?;
    writer.write(NORMALS, &[&raw(&mesh.normals)])?;
    let indices: Vec<u8> = mesh.triangles.iter().flatten().flat_map(|i| i.to_le_bytes()).collect();
    writer.write(TRIANGLES, &[&indices])?;
    Ok(writer)
}

fn write_frame(writer: &mut ChunkWriter, tag: Tag, frame: &Keyframe) -> Result<()> {
    let head = KeyframeV1 {
        name: frame.name.clone(),
        world_from_camera: (&frame.world_from_camera).into(),
        camera: (&frame.camera).into(),
        color: ColorV1::from(&frame.color),
    };
    let refuse = |problem: String| Error::invalid(writer.path(), problem, "this scan cannot be stored");
    check_frame(frame).map_err(refuse)?;
    let head = to_bytes(&head).map_err(refuse)?;
    if head.len() + frame.color.bytes.len() > FRAME_BYTES as usize {
        return Err(refuse(format!("picture of {} bytes", frame.color.bytes.len())));
    }
    writer.write(tag, &[&head, &frame.color.bytes])
}

impl Scan {
    /// Reads a scan file.
    ///
    /// # Errors
    /// Unreadable, damaged, no scan, or of a newer version.
    pub fn read(path: &Path) -> Result<Self> {
        let mut file = ChunkReader::open(path, KIND, VERSION, KNOWN)?;
        let invalid = |problem: String| Error::invalid(path, problem, "scan or import it again");
        let mut payload = Vec::new();
        let (mut head, mut stats, mut mesh) = (None, None, Mesh::default());
        let (mut keyframes, mut witnesses) = (Vec::new(), Vec::new());
        while let Some(tag) = file.next(&mut payload)? {
            match tag {
                HEAD => head = Some(from_bytes::<ScanV1>(&payload).map_err(invalid)?.0),
                STATISTICS => stats = Some(from_bytes::<StatsV1>(&payload).map_err(invalid)?.0.into()),
                POSITIONS => mesh.positions = vectors(&payload).map_err(invalid)?,
                NORMALS => mesh.normals = vectors(&payload).map_err(invalid)?,
                TRIANGLES => {
                    let (triples, rest) = payload.as_chunks::<12>();
                    if !rest.is_empty() {
                        return Err(invalid("half a triangle".into()));
                    }
                    let index = |t: &[u8; 12], k: usize| u32::from_le_bytes([0, 1, 2, 3].map(|b| t[4 * k + b]));
                    mesh.triangles = triples.iter().map(|t| [0, 1, 2].map(|k| index(t, k))).collect();
                }
                KEYFRAME => keyframes.push(read_frame(&payload).map_err(invalid)?),
                _ => witnesses.push(read_frame(&payload).map_err(invalid)?),
            }
        }
        let (Some(head), Some(stats)) = (head, stats) else {
            return Err(invalid("a scan without a header".into()));
        };
        let found = [mesh.positions.len(), mesh.triangles.len(), keyframes.len(), witnesses.len()];
        if found != [head.vertices, head.triangles, head.keyframes, head.witnesses].map(|n| n as usize) {
            return Err(invalid("its parts are not as many as its header says".into()));
        }
        check_mesh(&mesh).map_err(invalid)?;
        Ok(Self {
            name: head.name,
            source: head.source.into(),
            sensor: head.sensor.try_into().map_err(invalid)?,
            mesh,
            keyframes,
            witnesses,
            config: head.config,
            stats,
        })
    }

    /// Writes a scan file (by fsync and rename).
    ///
    /// # Errors
    /// The disk is full or gone, or the mesh holds NaN or indices out of range.
    pub fn write(&self, path: &Path) -> Result<()> {
        let head = ScanV1 {
            name: self.name.clone(),
            source: self.source.into(),
            sensor: (&self.sensor).into(),
            config: self.config.clone(),
            vertices: self.mesh.positions.len() as u32,
            triangles: self.mesh.triangles.len() as u32,
            keyframes: self.keyframes.len() as u32,
            witnesses: self.witnesses.len() as u32,
        };
        let mut writer = write_head(path, &head, &self.stats, &self.mesh)?;
        for (tag, frames) in [(KEYFRAME, &self.keyframes), (WITNESS, &self.witnesses)] {
            for frame in frames {
                write_frame(&mut writer, tag, frame)?;
            }
        }
        writer.finish()
    }
}

fn vectors(payload: &[u8]) -> std::result::Result<Vec<Vec3>, String> {
    let (triples, rest) = payload.as_chunks::<12>();
    if !rest.is_empty() {
        return Err("half a vertex".into());
    }
    let raw = |t: &[u8; 12]| bytemuck::pod_read_unaligned::<RawVec3>(t).0.map(|x| f32::from_le_bytes(x.to_ne_bytes()));
    Ok(triples.iter().map(|t| Vec3::from_array(raw(t))).collect())
}

fn read_frame(payload: &[u8]) -> std::result::Result<Keyframe, String> {
    let (head, bytes) = from_bytes::<KeyframeV1>(payload)?;
    let frame = Keyframe {
        name: head.name,
        world_from_camera: head.world_from_camera.try_into()?,
        camera: head.camera.try_into()?,
        color: head.color.with_bytes(bytes),
    };
    check_frame(&frame)?;
    Ok(frame)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::contents::KeptFrame;
    use crate::testing::{keyframe, refuses_damage, resealed, scan};
    use proptest::prelude::*;

    #[test]
    fn a_scan_comes_back_to_the_bit() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.lscan");
        scan().write(&path).unwrap();
        assert_eq!(Scan::read(&path).unwrap(), scan());
        let again = dir.path().join("b.lscan");
        Scan::read(&path).unwrap().write(&again).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), std::fs::read(&again).unwrap());
        refuses_damage(&path, Scan::read);
    }

    #[test]
    fn only_frames_that_were_chosen_are_kept() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.lscan");
        let whole = scan();
        let mut writer = ScanWriter::create(&path).unwrap();
        for (id, ns) in [(0, 300), (4, 1_700_000_000), (7, 1_000_000_000), (9, 2_500_000_000)] {
            let mut color = keyframe(ns).color;
            // Different lengths, so that a wrong offset shows.
            color.bytes.extend(vec![id as u8; id as usize]);
            writer.add_frame(FrameId(id), &color).unwrap();
            assert!(writer.add_frame(FrameId(id), &color).is_err());
        }
        assert!(!path.exists());
        let kept = |id| KeptFrame { id: FrameId(id), world_from_camera: whole.keyframes[0].world_from_camera };
        let tail = ScanTail {
            name: whole.name.clone(),
            sensor: whole.sensor.clone(),
            mesh: whole.mesh.clone(),
            keyframes: vec![kept(7), kept(9)],
            witnesses: vec![kept(4)],
            config: whole.config.clone(),
            stats: whole.stats.clone(),
        };
        writer.finish(&tail).unwrap();
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
        let mut read = Scan::read(&path).unwrap();
        for (frame, extra) in read.keyframes.iter_mut().chain(&mut read.witnesses).zip([7, 9, 4]) {
            let length = frame.color.bytes.len() - extra;
            assert!(frame.color.bytes[length..].iter().all(|b| *b == extra as u8));
            frame.color.bytes.truncate(length);
        }
        assert_eq!(read, whole);

        let mut writer = ScanWriter::create(&path).unwrap();
        writer.add_frame(FrameId(1), &keyframe(0).color).unwrap();
        assert!(writer.finish(&tail).unwrap_err().to_string().contains("never added"));
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "leftovers, or the earlier scan is gone");
        assert!(Scan::read(&path).is_ok());
    }

    #[test]
    fn nonsense_is_not_written() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.lscan");
        let mut bad = scan();
        bad.mesh.triangles[0][1] = 25;
        assert!(bad.write(&path).is_err());
        let mut bad = scan();
        bad.mesh.positions[3].y = f32::NAN;
        assert!(bad.write(&path).is_err());
        let mut bad = scan();
        bad.keyframes[1].color.width = 31;
        assert!(bad.write(&path).is_err());
        let mut bad = scan();
        bad.witnesses[0].world_from_camera.translation.x = f64::INFINITY;
        assert!(bad.write(&path).is_err());
        let mut bad = scan();
        bad.mesh.normals.pop();
        assert!(bad.write(&path).is_err());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    proptest! {
        #[test]
        fn nonsense_behind_a_right_checksum_never_panics(at in any::<usize>(), value in any::<u8>()) {
            static WHOLE: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
            let whole = WHOLE.get_or_init(|| {
                let dir = tempfile::tempdir().unwrap();
                let path = dir.path().join("a.lscan");
                scan().write(&path).unwrap();
                std::fs::read(path).unwrap()
            });
            let dir = tempfile::tempdir().unwrap();
            let path = dir.path().join("damaged");
            std::fs::write(&path, resealed(whole, at % whole.len(), value)).unwrap();
            if let Ok(read) = Scan::read(&path) {
                prop_assert!(check_mesh(&read.mesh).is_ok());
            }
        }
    }
}
