//! `GET /scans/ID/NAME` and `/scans/ID.tar`: the files of a scan, one or all, whole or in part.

use crate::serve::api::ranges::{Wanted, wanted};
use crate::serve::context::Context;
use crate::serve::http::request::Request;
use crate::serve::http::response::{Body, Response};
use std::collections::VecDeque;
use std::collections::hash_map::DefaultHasher;
use std::fs::{File, OpenOptions};
use std::hash::{Hash, Hasher};
use std::io::{Read, Seek, SeekFrom};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// Bytes of a tar record.
const RECORD: u64 = 512;
/// The viewer's own policy: it carries its scripts and data in itself, and is kept apart from the box's pages, so that it
/// can give no orders.
const VIEWER_POLICY: &str = "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; \
    style-src 'unsafe-inline'; img-src data: blob:; media-src data: blob:; connect-src data: blob:; worker-src blob:; \
    base-uri 'none'; form-action 'none'; frame-ancestors 'self'";

/// The folder of a published scan; `None` if there is none of this name.
#[must_use]
pub fn folder_of(device: &Path, id: &str) -> Option<PathBuf> {
    let harmless = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    if id.is_empty() || id.starts_with('.') || !id.chars().all(harmless) {
        return None;
    }
    let folder = device.join("scans").join(id);
    // A link would lead out of the device folder.
    std::fs::symlink_metadata(&folder).is_ok_and(|m| m.is_dir()).then_some(folder)
}

/// A file of a scan, opened; `None` if there is no such regular file.
fn open(folder: &Path, name: &str) -> Option<(File, std::fs::Metadata)> {
    if name.starts_with('.') || name.contains(['/', '\\', '\0']) {
        return None;
    }
    let no_links = rustix::fs::OFlags::NOFOLLOW | rustix::fs::OFlags::NONBLOCK;
    let file = OpenOptions::new().read(true).custom_flags(no_links.bits() as i32).open(folder.join(name)).ok()?;
    let metadata = file.metadata().ok()?;
    metadata.is_file().then_some((file, metadata))
}

/// Names of the regular files of a scan, in order.
#[must_use]
pub fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let regular = entries.filter(|e| e.file_type().is_ok_and(|t| t.is_file()));
    let mut names: Vec<String> = regular.filter_map(|e| e.file_name().into_string().ok()).collect();
    names.retain(|n| !n.starts_with('.') && !n.ends_with(".part"));
    names.sort();
    names
}

/// One file.
pub fn file(context: &Context, request: &Request, id: &str, name: &str) -> Response {
    let opened = folder_of(&context.device, id).and_then(|folder| open(&folder, name));
    let Some((file, metadata)) = opened else { return Response::error(404, "there is no such file") };
    let changed = seconds(&metadata);
    let content_type = match name.rsplit_once('.').map_or("", |(_, e)| e) {
        "png" => "image/png",
        "html" => "text/html; charset=utf-8",
        "json" => "application/json",
        "txt" => "text/plain; charset=utf-8",
        _ => "application/octet-stream",
    };
    let tag = format!("\"{}-{changed}\"", metadata.len());
    let response = partial(request, vec![Part::File(file, metadata.len())], content_type, &tag);
    let response =
        if name.ends_with(".html") { response.with("Content-Security-Policy", VIEWER_POLICY) } else { response };
    if request.query.contains_key("download") || content_type == "application/octet-stream" {
        response.with("Content-Disposition", format!("attachment; filename=\"{id}-{name}\""))
    } else {
        response
    }
}

/// All files of a scan as a tar archive.
pub fn archive(context: &Context, request: &Request, id: &str) -> Response {
    let Some(folder) = folder_of(&context.device, id) else { return Response::error(404, "there is no such scan") };
    let mut parts = Vec::new();
    let mut tag = DefaultHasher::new();
    for name in names(&folder) {
        let Some((file, metadata)) = open(&folder, &name) else { continue };
        let (length, changed) = (metadata.len(), seconds(&metadata));
        (&name, length, changed).hash(&mut tag);
        let mut header = tar::Header::new_ustar();
        if header.set_path(format!("{id}/{name}")).is_err() {
            continue;
        }
        header.set_size(length);
        header.set_mtime(changed);
        header.set_mode(0o644);
        header.set_cksum();
        parts.push(Part::Bytes(header.as_bytes().to_vec()));
        parts.push(Part::File(file, length));
        parts.push(Part::Bytes(vec![0; ((RECORD - length % RECORD) % RECORD) as usize]));
    }
    parts.push(Part::Bytes(vec![0; 2 * RECORD as usize]));
    partial(request, parts, "application/x-tar", &format!("\"{:016x}\"", tag.finish()))
        .with("Content-Disposition", format!("attachment; filename=\"{id}.tar\""))
}

fn seconds(metadata: &std::fs::Metadata) -> u64 {
    metadata.modified().ok().and_then(|t| t.duration_since(UNIX_EPOCH).ok()).map_or(0, |d| d.as_secs())
}

/// A piece of a long answer.
enum Part {
    Bytes(Vec<u8>),
    File(File, u64),
}

impl Part {
    fn length(&self) -> u64 {
        match self {
            Self::Bytes(b) => b.len() as u64,
            Self::File(_, n) => *n,
        }
    }
}

/// The parts one after the other, or the range of them that the request asks for.
fn partial(request: &Request, parts: Vec<Part>, content_type: &str, tag: &str) -> Response {
    let total = parts.iter().map(Part::length).sum();
    // A range of what has changed since would be spliced to something else.
    let same = request.header("if-range").is_none_or(|t| t == tag);
    let (status, start, length) = match wanted(request.header("range").filter(|_| same), total) {
        Wanted::All => (200, 0, total),
        Wanted::Part(start, length) => (206, start, length),
        Wanted::Outside => {
            return Response::error(416, "there is nothing there").with("Content-Range", format!("bytes */{total}"));
        }
    };
    let Ok(reader) = PartsReader::at(parts, start) else { return Response::error(500, "the file cannot be read") };
    let response = Response::new(status, content_type, Body::Reader(Box::new(reader), length))
        .with("Accept-Ranges", "bytes")
        .with("ETag", tag)
        .with("Cache-Control", "private, no-cache");
    if status == 206 {
        response.with("Content-Range", format!("bytes {start}-{}/{total}", start + length - 1))
    } else {
        response
    }
}

struct PartsReader {
    parts: VecDeque<Box<dyn Read + Send>>,
}

impl PartsReader {
    fn at(parts: Vec<Part>, mut start: u64) -> std::io::Result<Self> {
        let mut readers: VecDeque<Box<dyn Read + Send>> = VecDeque::new();
        for part in parts {
            let length = part.length();
            let skipped = start.min(length);
            start -= skipped;
            match part {
                Part::Bytes(bytes) => {
                    readers.push_back(Box::new(std::io::Cursor::new(bytes[skipped as usize..].to_vec())))
                }
                Part::File(mut file, _) => {
                    file.seek(SeekFrom::Start(skipped))?;
                    readers.push_back(Box::new(file.take(length - skipped)));
                }
            }
        }
        Ok(Self { parts: readers })
    }
}

impl Read for PartsReader {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        while let Some(part) = self.parts.front_mut() {
            match part.read(buffer)? {
                0 => drop(self.parts.pop_front()),
                n => return Ok(n),
            }
        }
        Ok(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_published_scans_are_found() {
        let device = tempfile::tempdir().unwrap();
        let scans = device.path().join("scans");
        for name in ["20261121T110534Z-a", ".capture-b"] {
            std::fs::create_dir_all(scans.join(name)).unwrap();
        }
        std::os::unix::fs::symlink("/etc", scans.join("link")).unwrap();
        std::os::unix::fs::symlink("/etc/passwd", scans.join("20261121T110534Z-a/passwd")).unwrap();
        std::fs::write(scans.join("20261121T110534Z-a/x.txt"), "abc").unwrap();
        let folder = folder_of(device.path(), "20261121T110534Z-a").unwrap();
        for id in [".capture-b", "link", "..", "", "a/b", "nothing", "a\0", "../scans/20261121T110534Z-a"] {
            assert!(folder_of(device.path(), id).is_none(), "{id}");
        }
        assert!(open(&folder, "x.txt").is_some());
        for name in ["passwd", "..", "../x", "y", ".", ""] {
            assert!(open(&folder, name).is_none(), "{name}");
        }
        assert_eq!(names(&folder), ["x.txt"]);
    }

    #[test]
    fn any_range_of_the_parts_is_that_of_the_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("f");
        std::fs::write(&path, b"defgh").unwrap();
        for start in 0..=10 {
            let parts = vec![
                Part::Bytes(b"abc".to_vec()),
                Part::File(File::open(&path).unwrap(), 5),
                Part::Bytes(b"ij".to_vec()),
            ];
            let mut text = String::new();
            PartsReader::at(parts, start).unwrap().read_to_string(&mut text).unwrap();
            assert_eq!(text, "abcdefghij"[start as usize..]);
        }
    }
}
