//! Which scan a file holds, without reading its pictures.

use crate::codec::chunk::ChunkReader;
use crate::codec::digest::sha256;
use crate::codec::header::from_bytes;
use crate::error::{Error, Result};
use crate::scan::file::{HEAD, KIND, KNOWN, VERSION};
use crate::v1::ScanV1;
use std::path::Path;

/// Which scan a file holds, and with what settings it was made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ScanIdentity {
    /// SHA-256 of the headers of all chunks, hexadecimal. They hold a checksum of every chunk, so it changes with every byte.
    pub digest: String,
    /// The settings stored in the scan.
    pub config: String,
}

impl ScanIdentity {
    /// Reads the headers of a scan file. The contents are not checked.
    ///
    /// # Errors
    /// Unreadable, cut off, no scan, or of a newer version.
    pub fn read(path: &Path) -> Result<Self> {
        let invalid = |problem: String| Error::invalid(path, problem, "scan or import it again");
        let mut file = ChunkReader::open(path, KIND, VERSION, KNOWN)?;
        let mut headers = Vec::new();
        let (mut config, mut payload) = (None, Vec::new());
        let mut begin = file.offset();
        while let Some(header) = file.skip()? {
            headers.extend([header.tag, header.length.to_le_bytes(), header.crc.to_le_bytes()].concat());
            if header.tag == HEAD {
                file.seek(begin)?;
                file.next(&mut payload)?;
                config = Some(from_bytes::<ScanV1>(&payload).map_err(invalid)?.0.config);
            }
            begin = file.offset();
        }
        let config = config.ok_or_else(|| invalid("a scan without a header".into()))?;
        Ok(Self { digest: sha256(&headers), config })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::scan;

    #[test]
    fn every_byte_counts() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.lscan");
        let mut scan = scan();
        scan.write(&path).unwrap();
        let first = ScanIdentity::read(&path).unwrap();
        assert_eq!((first.digest.len(), &first.config), (64, &scan.config));
        let again = dir.path().join("b.lscan");
        scan.write(&again).unwrap();
        assert_eq!(ScanIdentity::read(&again).unwrap(), first);
        let last = scan.keyframes.last_mut().unwrap().color.bytes.last_mut().unwrap();
        *last ^= 1;
        scan.write(&again).unwrap();
        assert_ne!(ScanIdentity::read(&again).unwrap().digest, first.digest);
    }

    #[test]
    fn a_file_that_is_cut_off_has_none() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.lscan");
        scan().write(&path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        for length in (0..whole.len()).step_by(1 + whole.len() / 50) {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert!(ScanIdentity::read(&path).is_err(), "{length}");
        }
    }
}
