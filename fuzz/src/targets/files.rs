//! Files of ours. Checksums are put right first, so that mutations reach what stands behind them; `container` alone takes the
//! bytes as they are.

use crate::scratch;
use recordings::codec::chunk::{ChunkReader, kind_of};
use recordings::codec::depth::DepthDecoder;
use recordings::recording::{Event, RecordingReader};
use recordings::result::{Estimate, Origin};
use recordings::scan::{Scan, ScanIdentity};

const HEADER_BYTES: usize = 16;
const CHUNK_HEADER_BYTES: usize = 12;

/// The container, with chunks of every kind of knowledge: known, unknown, too long.
pub fn container(bytes: &[u8]) {
    let path = scratch::file("container", bytes);
    let _ = kind_of(&path);
    const KNOWN: &[([u8; 4], u32)] = &[(*b"KNOW", 1 << 16), (*b"TINY", 4)];
    let open = || ChunkReader::open(&path, *b"TEST", 1, KNOWN);
    let Ok(mut reader) = open() else { return };
    let mut payload = Vec::new();
    while let Ok(Some(_)) = reader.next(&mut payload) {}
    let Ok(mut reader) = open() else { return };
    while let Ok(Some(_)) = reader.skip() {}
}

/// The bytes with every chunk's checksum as it should be.
fn checked(bytes: &[u8]) -> Vec<u8> {
    let mut out = bytes.to_vec();
    let mut at = HEADER_BYTES;
    while let Some(header) = out.get(at..at + CHUNK_HEADER_BYTES) {
        let length = u32::from_le_bytes([header[4], header[5], header[6], header[7]]) as usize;
        let begin = at + CHUNK_HEADER_BYTES;
        let Some(payload) = out.get(begin..begin + length) else { break };
        let crc = crc32(&[&header[..8], payload]);
        out[at + 8..begin].copy_from_slice(&crc.to_le_bytes());
        at = begin + length;
    }
    out
}

fn crc32(parts: &[&[u8]]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    parts.iter().for_each(|part| hasher.update(part));
    hasher.finalize()
}

pub fn scan(bytes: &[u8]) {
    let path = scratch::file("scan.lscan", &checked(bytes));
    let _ = ScanIdentity::read(&path);
    let Ok(scan) = Scan::read(&path) else { return };
    // What is read can be written, and is the same then.
    let again = path.with_file_name("again.lscan");
    scan.write(&again).expect("a scan that was read");
    Scan::read(&again).expect("a scan that was written");
}

pub fn result(bytes: &[u8]) {
    let path = scratch::file("result.lres", &checked(bytes));
    let _ = Origin::read(&path);
    let Ok(estimate) = Estimate::read(&path) else { return };
    let again = path.with_file_name("again.lres");
    estimate.write(&again).expect("a result that was read");
    Estimate::read(&again).expect("a result that was written");
}

pub fn recording(bytes: &[u8]) {
    let path = scratch::file("recording.lrec", &checked(bytes));
    let Ok(mut reader) = RecordingReader::open(&path) else { return };
    // A sensor may say that it has more pixels than are worth the time.
    let pixels = |i: &recordings::types::Intrinsics| u64::from(i.width) * u64::from(i.height);
    if pixels(&reader.sensor().depth.intrinsics) > 1 << 16 {
        return;
    }
    while let Ok(Some(event)) = reader.next_event() {
        if let Event::Color(color) = event
            && color.width.saturating_mul(color.height) <= 1 << 16
        {
            let _ = color.decode();
        }
    }
}

/// The coded depth of one image; the first two bytes are its size.
pub fn depth(bytes: &[u8]) {
    let [width, height, coded @ ..] = bytes else { return };
    let _ = DepthDecoder::new().decode(coded, usize::from(*width), usize::from(*height));
}
