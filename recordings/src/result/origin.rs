//! What a result was made from: what tells whether it has to be made again.

use crate::codec::chunk::{ChunkReader, Tag};
use crate::error::{Error, Result};
use crate::result::file::{KIND, VERSION};
use crate::v1::from_bytes;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// The chunk. Programs that do not know it skip it.
pub(super) const ORIGIN: Tag = *b"ORIG";

/// What a result was made from. Stands in files: never edited, the next version is another chunk.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Origin {
    /// Digest of the scan ([`crate::scan::ScanIdentity`]).
    pub scan: String,
    /// Digest of the settings of the estimator and of its limits.
    pub settings: String,
    /// Version of the program.
    pub version: String,
}

impl Origin {
    /// Reads it from a result file, whose every chunk is checked; `None` in a result that does not tell.
    ///
    /// # Errors
    /// Unreadable, damaged, no result, or of a newer version.
    pub fn read(path: &Path) -> Result<Option<Self>> {
        let mut file = ChunkReader::open(path, KIND, VERSION, &[(ORIGIN, 1 << 16)])?;
        let (mut origin, mut payload) = (None, Vec::new());
        while file.next(&mut payload)?.is_some() {
            let read = from_bytes::<Self>(&payload);
            origin = Some(read.map_err(|problem| Error::invalid(path, problem, "estimate it again"))?.0);
        }
        Ok(origin)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::result::Estimate;
    use crate::testing::{bumpy_mesh, estimate_on, refuses_damage};

    #[test]
    fn a_result_tells_what_it_was_made_from() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.lres");
        let estimate = estimate_on(bumpy_mesh(6));
        estimate.write(&path).unwrap();
        assert_eq!(Origin::read(&path).unwrap(), None);
        let origin = Origin { scan: "01".repeat(32), settings: "ab".repeat(32), version: "0.1.0".into() };
        estimate.write_from(&path, Some(&origin)).unwrap();
        assert_eq!(Origin::read(&path).unwrap().as_ref(), Some(&origin));
        assert_eq!(Estimate::read(&path).unwrap().segment, estimate.segment);
        refuses_damage(&path, Origin::read);
    }
}
