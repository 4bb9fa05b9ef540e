//! The chunk container all our files share: append-only, checked, readable up to where a crash left off.
//!
//! A file is `"LUMISCAN" | kind[4] | version u32`, then chunks `tag[4] | length u32 | crc32 u32 | payload`, the last
//! one tagged `END `. All numbers are little-endian; the checksum covers tag, length and payload, so that a flipped tag
//! is damage and not an unknown chunk. Unknown chunks are skipped.

use crate::codec::exclusive::open_exclusive;
use crate::error::{Error, Result};
use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Read, Seek, Write};
use std::path::{Path, PathBuf};

/// Name of a chunk, or of a kind of file.
pub type Tag = [u8; 4];

const MAGIC: &[u8; 8] = b"LUMISCAN";
const HEADER_BYTES: u64 = 16;
const CHUNK_HEADER_BYTES: u64 = 12;
const END: Tag = *b"END ";
const BUFFER_BYTES: usize = 1 << 18;

fn checksum(tag: Tag, length: u32, payload: &[&[u8]]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&tag);
    hasher.update(&length.to_le_bytes());
    payload.iter().for_each(|part| hasher.update(part));
    hasher.finalize()
}

/// Writes `name.part` beside `path`; [`ChunkWriter::finish`] syncs it and renames it into place. Dropped before that,
/// it removes what it wrote.
pub struct ChunkWriter {
    path: PathBuf,
    part: PathBuf,
    /// `None` once finished.
    file: Option<BufWriter<File>>,
}

impl ChunkWriter {
    /// Starts a file of a kind and version.
    ///
    /// # Errors
    /// The folder cannot be written, or another process is writing the same file.
    pub fn create(path: &Path, kind: Tag, version: u32) -> Result<Self> {
        let part = beside(path, ".part")?;
        let busy = || std::io::Error::new(std::io::ErrorKind::ResourceBusy, "another process is writing this file");
        let file = open_exclusive(&part).and_then(|f| f.ok_or_else(busy)).map_err(|e| Error::io(&part, e))?;
        // What a killed process left.
        file.set_len(0).map_err(|e| Error::io(&part, e))?;
        let file = Some(BufWriter::with_capacity(BUFFER_BYTES, file));
        let mut writer = Self { path: path.to_path_buf(), part, file };
        writer.put(&[MAGIC, &kind, &version.to_le_bytes()])?;
        Ok(writer)
    }

    /// Appends a chunk whose payload is the concatenation of `parts`.
    ///
    /// # Errors
    /// The disk is full or gone, or the payload is 4 GiB or longer.
    pub fn write(&mut self, tag: Tag, parts: &[&[u8]]) -> Result<()> {
        let length = u32::try_from(parts.iter().map(|p| p.len()).sum::<usize>()).map_err(|_| {
            Error::invalid(&self.path, "more than 4 GiB in one chunk", "make the scan or recording smaller")
        })?;
        let crc = checksum(tag, length, parts);
        self.put(&[&tag, &length.to_le_bytes(), &crc.to_le_bytes()])?;
        self.put(parts)
    }

    fn put(&mut self, parts: &[&[u8]]) -> Result<()> {
        if let Some(file) = &mut self.file {
            for part in parts {
                file.write_all(part).map_err(|e| Error::io(&self.part, e))?;
            }
        }
        Ok(())
    }

    /// The file being written.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Ends the file, syncs it, and gives it its name.
    ///
    /// # Errors
    /// The disk is full or gone.
    pub fn finish(mut self) -> Result<()> {
        self.end()?;
        if let Some(file) = &self.file {
            file.get_ref().sync_all().map_err(|e| Error::io(&self.part, e))?;
        }
        self.put_in_place()?;
        sync_folder(&self.path)
    }

    /// Ends the file and gives it its name, without the wait for the disk.
    ///
    /// # Errors
    /// The disk is full or gone.
    pub fn finish_unsynced(mut self) -> Result<()> {
        self.end()?;
        self.put_in_place()
    }

    fn end(&mut self) -> Result<()> {
        self.write(END, &[])?;
        self.file.as_mut().map_or(Ok(()), BufWriter::flush).map_err(|e| Error::io(&self.part, e))
    }

    fn put_in_place(&mut self) -> Result<()> {
        std::fs::rename(&self.part, &self.path).map_err(|e| Error::io(&self.path, e))?;
        self.file = None;
        Ok(())
    }
}

/// The path with `ending` appended to its file name.
pub(crate) fn beside(path: &Path, ending: &str) -> Result<PathBuf> {
    let Some(name) = path.file_name() else {
        return Err(Error::invalid(path, "not the name of a file", "give a name in an existing folder"));
    };
    let mut name = name.to_os_string();
    name.push(ending);
    Ok(path.with_file_name(name))
}

/// Makes a rename in the folder of `path` durable.
fn sync_folder(path: &Path) -> Result<()> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    File::open(folder).and_then(|f| f.sync_all()).map_err(|e| Error::io(folder, e))
}

impl Drop for ChunkWriter {
    fn drop(&mut self) {
        if self.file.take().is_some() {
            let _ = std::fs::remove_file(&self.part);
        }
    }
}

/// What stands before the payload of a chunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Header {
    /// Its name.
    pub tag: Tag,
    /// Bytes of the payload.
    pub length: u32,
    /// Checksum of name, length and payload.
    pub crc: u32,
}

/// Reads a file chunk by chunk, with memory for one chunk.
pub struct ChunkReader {
    path: PathBuf,
    file: BufReader<File>,
    file_bytes: u64,
    /// Where the next chunk begins.
    at: u64,
    /// Known tags and the longest payload each may have.
    known: &'static [(Tag, u32)],
}

impl ChunkReader {
    /// Opens a file of a kind, at most of `version`; chunks other than `known` will be skipped.
    ///
    /// # Errors
    /// Unreadable, no file of ours, of another kind, or of a newer version.
    pub fn open(path: &Path, kind: Tag, version: u32, known: &'static [(Tag, u32)]) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::io(path, e))?;
        let metadata = file.metadata().map_err(|e| Error::io(path, e))?;
        if !metadata.is_file() {
            return Err(Error::invalid(path, "not a file", "give the name of a file"));
        }
        let mut file = BufReader::with_capacity(BUFFER_BYTES, file);
        let mut header = [0; HEADER_BYTES as usize];
        let found = file_kind(&mut file, &mut header).map_err(|e| Error::io(path, e))?;
        let name = |tag: Tag| String::from_utf8_lossy(&tag).trim().to_lowercase();
        match found {
            None => return Err(Error::invalid(path, "not a Lumiscan file", "give a .lrec, .lscan or .lres file")),
            Some((k, _)) if k != kind => {
                let problem = format!("this is a file of kind `{}`, not `{}`", name(k), name(kind));
                return Err(Error::invalid(path, problem, "give a file of the right kind"));
            }
            Some((_, v)) if v == 0 || v > version => {
                let problem = format!("written in version {v} of the format, this program reads up to {version}");
                return Err(Error::invalid(path, problem, "update Lumiscan"));
            }
            Some(_) => {}
        }
        Ok(Self { path: path.to_path_buf(), file, file_bytes: metadata.len(), at: HEADER_BYTES, known })
    }

    /// The file being read.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Where the next chunk begins.
    #[must_use]
    pub fn offset(&self) -> u64 {
        self.at
    }

    /// Continues at a chunk's beginning, as [`ChunkReader::offset`] gave it.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn seek(&mut self, offset: u64) -> Result<()> {
        // A relative seek keeps what is buffered. After an error the file stands elsewhere than at `self.at`.
        let seek = |file: &mut BufReader<File>| {
            let here = file.stream_position()?;
            file.seek_relative(offset as i64 - here as i64)
        };
        seek(&mut self.file).map_err(|e| Error::io(&self.path, e))?;
        self.at = offset;
        Ok(())
    }

    /// Length of the file in bytes.
    #[must_use]
    pub fn file_bytes(&self) -> u64 {
        self.file_bytes
    }

    /// Reads the next known chunk into `payload`; `None` at the end of a whole file.
    ///
    /// # Errors
    /// [`Error::Truncated`] if the file stops without its end chunk, [`Error::Damaged`] if a checksum is wrong.
    pub fn next(&mut self, payload: &mut Vec<u8>) -> Result<Option<Tag>> {
        loop {
            let begin = self.at;
            let Header { tag, length, crc } = self.header()?;
            let limit = match self.known.iter().find(|(t, _)| *t == tag) {
                Some((_, limit)) => Some(*limit),
                None if tag == END => Some(0),
                None => None,
            };
            if limit.is_some_and(|limit| length > limit) {
                return Err(self.damaged(begin, "impossible length"));
            }
            if u64::from(length) > self.file_bytes - begin - CHUNK_HEADER_BYTES {
                return Err(self.truncated(begin));
            }
            payload.clear();
            let found = if limit.is_some() {
                payload.resize(length as usize, 0);
                self.file.read_exact(payload).map_err(|e| Error::io(&self.path, e))?;
                checksum(tag, length, &[payload])
            } else {
                self.checksum_unknown(tag, length)?
            };
            if found != crc {
                return Err(self.damaged(begin, "checksum"));
            }
            self.at = begin + CHUNK_HEADER_BYTES + u64::from(length);
            match limit {
                _ if tag == END => return Ok(None),
                Some(_) => return Ok(Some(tag)),
                None => {}
            }
        }
    }

    /// The header of the next chunk, whose payload is skipped unread and unchecked; `None` at the end of a whole file.
    ///
    /// # Errors
    /// [`Error::Truncated`] if the file stops without its end chunk.
    pub fn skip(&mut self) -> Result<Option<Header>> {
        let begin = self.at;
        let header = self.header()?;
        let end = begin + CHUNK_HEADER_BYTES + u64::from(header.length);
        if end > self.file_bytes {
            return Err(self.truncated(begin));
        }
        self.seek(end)?;
        Ok((header.tag != END).then_some(header))
    }

    /// Reads the header at `self.at`.
    fn header(&mut self) -> Result<Header> {
        if self.file_bytes.saturating_sub(self.at) < CHUNK_HEADER_BYTES {
            return Err(self.truncated(self.at));
        }
        let mut bytes = [0; CHUNK_HEADER_BYTES as usize];
        self.file.read_exact(&mut bytes).map_err(|e| Error::io(&self.path, e))?;
        let [tag, length, crc] = std::array::from_fn(|i| [0, 1, 2, 3].map(|k| bytes[4 * i + k]));
        Ok(Header { tag, length: u32::from_le_bytes(length), crc: u32::from_le_bytes(crc) })
    }

    fn truncated(&self, offset: u64) -> Error {
        Error::Truncated { path: self.path.clone(), offset }
    }

    fn damaged(&self, offset: u64, problem: &str) -> Error {
        Error::Damaged { path: self.path.clone(), offset, problem: problem.into() }
    }

    fn checksum_unknown(&mut self, tag: Tag, length: u32) -> Result<u32> {
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(&tag);
        hasher.update(&length.to_le_bytes());
        let mut left = length as usize;
        while left > 0 {
            let buffer = self.file.fill_buf().map_err(|e| Error::io(&self.path, e))?;
            let n = buffer.len().min(left);
            if n == 0 {
                return Err(Error::Truncated { path: self.path.clone(), offset: self.at });
            }
            hasher.update(&buffer[..n]);
            self.file.consume(n);
            left -= n;
        }
        Ok(hasher.finalize())
    }
}

/// Kind and version of a file of ours; `None` if it is none.
fn file_kind(file: &mut impl Read, header: &mut [u8; HEADER_BYTES as usize]) -> std::io::Result<Option<(Tag, u32)>> {
    match file.read_exact(header) {
        Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => return Ok(None),
        other => other?,
    }
    let [a, b] = [8, 12].map(|at| [0, 1, 2, 3].map(|k| header[at + k]));
    Ok(header.starts_with(MAGIC).then_some((a, u32::from_le_bytes(b))))
}

/// The kind of a file of ours (`b"LREC"`, `b"SCAN"`, `b"LRES"`), or `None` if it is none.
///
/// # Errors
/// The file cannot be read.
pub fn kind_of(path: &Path) -> Result<Option<Tag>> {
    let mut file = File::open(path).map_err(|e| Error::io(path, e))?;
    let kind = file_kind(&mut file, &mut [0; HEADER_BYTES as usize]).map_err(|e| Error::io(path, e))?;
    Ok(kind.map(|(tag, _)| tag))
}

/// CRC-32 (IEEE) of a whole file, for manifests.
///
/// # Errors
/// The file cannot be read.
pub fn crc32_of_file(path: &Path) -> Result<u32> {
    let mut file = File::open(path).map_err(|e| Error::io(path, e))?;
    let mut hasher = crc32fast::Hasher::new();
    let mut buffer = vec![0; BUFFER_BYTES];
    loop {
        match file.read(&mut buffer).map_err(|e| Error::io(path, e))? {
            0 => return Ok(hasher.finalize()),
            n => hasher.update(&buffer[..n]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const KIND: Tag = *b"TEST";
    const KNOWN: &[(Tag, u32)] = &[(*b"AAAA", 1000), (*b"BBBB", 10)];

    fn written(chunks: &[(Tag, Vec<u8>)]) -> (tempfile::TempDir, PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("file.test");
        let mut writer = ChunkWriter::create(&path, KIND, 3).unwrap();
        for (tag, payload) in chunks {
            writer.write(*tag, &[&payload[..payload.len() / 2], &payload[payload.len() / 2..]]).unwrap();
        }
        assert!(!path.exists());
        writer.finish().unwrap();
        (dir, path)
    }

    #[test]
    fn a_file_has_one_writer_at_a_time() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("file.test");
        let first = ChunkWriter::create(&path, KIND, 3).unwrap();
        let message = ChunkWriter::create(&path, KIND, 3).err().unwrap().to_string();
        assert!(message.contains("another process"), "{message}");
        first.finish().unwrap();
        ChunkWriter::create(&path, KIND, 3).unwrap().finish().unwrap();
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }

    /// Every chunk up to the end or the first error.
    fn read(path: &Path) -> (Vec<(Tag, Vec<u8>)>, Result<()>) {
        let mut chunks = Vec::new();
        let mut reader = match ChunkReader::open(path, KIND, 3, KNOWN) {
            Ok(reader) => reader,
            Err(e) => return (chunks, Err(e)),
        };
        let mut payload = Vec::new();
        loop {
            match reader.next(&mut payload) {
                Ok(Some(tag)) => chunks.push((tag, payload.clone())),
                Ok(None) => return (chunks, Ok(())),
                Err(e) => return (chunks, Err(e)),
            }
        }
    }

    /// The bytes of a file with `chunks`, and a path for a damaged copy (syncing a file for every case takes long).
    fn damageable(chunks: &[(Tag, Vec<u8>)]) -> (tempfile::TempDir, PathBuf, Vec<u8>) {
        static WHOLE: std::sync::OnceLock<Vec<u8>> = std::sync::OnceLock::new();
        let whole = WHOLE.get_or_init(|| {
            let (_dir, path) = written(chunks);
            std::fs::read(path).unwrap()
        });
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("damaged");
        (dir, path, whole.clone())
    }

    fn some_chunks() -> Vec<(Tag, Vec<u8>)> {
        vec![(*b"AAAA", (0..100).collect()), (*b"BBBB", vec![]), (*b"AAAA", vec![7; 999]), (*b"BBBB", vec![1, 2])]
    }

    #[test]
    fn chunks_come_back_and_unknown_ones_are_skipped() {
        let mut chunks = some_chunks();
        let (_dir, path) = written(&chunks);
        let (read_back, outcome) = read(&path);
        outcome.unwrap();
        assert_eq!(read_back, chunks);
        assert_eq!(kind_of(&path).unwrap(), Some(KIND));
        chunks.insert(2, (*b"NEW!", vec![9; 700_000]));
        let (_dir, path) = written(&chunks);
        assert_eq!(read(&path).0, read_back);
    }

    #[test]
    fn every_truncation_gives_the_prefix_and_says_so() {
        let chunks = some_chunks();
        let (_dir, path) = written(&chunks);
        let whole = std::fs::read(&path).unwrap();
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            let (prefix, outcome) = read(&path);
            assert_eq!(prefix, chunks[..prefix.len()]);
            match outcome.unwrap_err() {
                Error::Truncated { offset, .. } => {
                    let expected = 16 + prefix.iter().map(|(_, p)| 12 + p.len() as u64).sum::<u64>();
                    assert_eq!(offset, expected);
                }
                Error::Invalid { .. } => assert!(length < 16),
                other => panic!("{other}"),
            }
        }
    }

    #[test]
    fn an_unfinished_file_leaves_nothing_but_a_crashed_one_its_prefix() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("file.test");
        let mut writer = ChunkWriter::create(&path, KIND, 3).unwrap();
        writer.write(*b"AAAA", &[&[1; 1000]]).unwrap();
        assert!(dir.path().join("file.test.part").exists());
        drop(writer);
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
        assert!(ChunkWriter::create(Path::new("/"), KIND, 3).is_err());
        assert!(ChunkWriter::create(&dir.path().join("none/file.test"), KIND, 3).is_err());
    }

    #[test]
    fn lengths_are_checked_before_memory_is_taken() {
        let (_dir, path) = written(&[]);
        let mut bytes = std::fs::read(&path).unwrap()[..16].to_vec();
        bytes.extend(b"AAAA\xff\xff\xff\xff\0\0\0\0");
        std::fs::write(&path, &bytes).unwrap();
        assert!(matches!(read(&path).1, Err(Error::Damaged { offset: 16, .. })));
        bytes[16..20].copy_from_slice(b"ZZZZ");
        std::fs::write(&path, &bytes).unwrap();
        assert!(matches!(read(&path).1, Err(Error::Truncated { offset: 16, .. })));
    }

    #[test]
    fn other_kinds_and_newer_versions_are_named() {
        let (dir, path) = written(&some_chunks());
        let message =
            |kind, version| ChunkReader::open(&path, kind, version, KNOWN).map(|_| ()).unwrap_err().to_string();
        assert!(message(*b"LREC", 3).contains("kind `test`"));
        assert!(message(KIND, 2).contains("update Lumiscan"));
        assert!(ChunkReader::open(dir.path(), KIND, 3, KNOWN).is_err());
        assert!(ChunkReader::open(&dir.path().join("none"), KIND, 3, KNOWN).is_err());
    }

    #[test]
    fn crc_of_a_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x");
        std::fs::write(&path, b"123456789").unwrap();
        assert_eq!(crc32_of_file(&path).unwrap(), 0xcbf4_3926);
    }

    proptest! {
        #[test]
        fn a_flipped_bit_is_noticed(at in 0usize..1200, bit in 0u8..8) {
            let chunks = some_chunks();
            let (_dir, path, mut bytes) = damageable(&chunks);
            let at = at % bytes.len();
            bytes[at] ^= 1 << bit;
            std::fs::write(&path, &bytes).unwrap();
            let (prefix, outcome) = read(&path);
            prop_assert_eq!(&prefix[..], &chunks[..prefix.len()]);
            // Of the header's sixteen bytes only the version may change unnoticed, to an older one.
            prop_assert!(outcome.is_err() || (12..16).contains(&at));
        }

        #[test]
        fn random_tails_are_refused(tail in proptest::collection::vec(any::<u8>(), 0..300), known in any::<bool>()) {
            let (_dir, path, mut bytes) = damageable(&some_chunks());
            bytes.truncate(16);
            if known { bytes.extend(b"AAAA"); }
            bytes.extend(&tail);
            std::fs::write(&path, &bytes).unwrap();
            let (chunks, outcome) = read(&path);
            prop_assert!(chunks.is_empty() && outcome.is_err());
        }
    }
}
