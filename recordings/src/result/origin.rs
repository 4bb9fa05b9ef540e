//! What a result was made from: what tells whether it has to be made again.

use serde::{Deserialize, Serialize};

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
