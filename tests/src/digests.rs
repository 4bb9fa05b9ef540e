//! Checksums of results, committed in `tests/digests/<scene>.json`: they show whether a change of the code changed a
//! result.
//!
//! A scan file is compared byte for byte. A result file is decoded first, so a new chunk or a new text in it is no
//! change. To write the checksums anew, run the failing tests with `UPDATE_DIGESTS=1` and `LUMISCAN_SHARED` set, and
//! say in CHANGELOG.md why the results changed. The checksums hold for x86-64.

use recordings::result::Estimate;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// CRC-32 by the name of the part.
pub type Digests = BTreeMap<String, String>;

/// Checksum of the bytes of a file, named `part`.
///
/// # Panics
/// The file is missing.
#[must_use]
pub fn of_file(part: &str, path: &Path) -> Digests {
    let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    [(part.to_owned(), format!("{:08x}", crc32fast::hash(&bytes)))].into()
}

/// Checksums of the parts of a result file, decoded.
///
/// # Panics
/// The file is missing or damaged.
#[must_use]
pub fn of_result(path: &Path) -> Digests {
    let result = Estimate::read(path).unwrap_or_else(|e| panic!("{e}"));
    let mesh = &result.mesh;
    let light = &result.light;
    let segments = || result.segments.iter();
    let keyframes = || result.keyframes.iter();
    let mut digests = Digests::new();
    let mut add = |part: &str, values: &mut dyn Iterator<Item = u64>| {
        let mut hasher = crc32fast::Hasher::new();
        values.for_each(|v| hasher.update(&v.to_le_bytes()));
        digests.insert(part.to_owned(), format!("{:08x}", hasher.finalize()));
    };
    let vector = |v: &glam::Vec3| v.to_array().map(|x| u64::from(x.to_bits()));
    let doubles = |row: &[f64; 3]| row.map(f64::to_bits);
    add(
        "mesh",
        &mut (mesh.positions.iter().chain(&mesh.normals).flat_map(vector))
            .chain(mesh.triangles.iter().flatten().map(|i| u64::from(*i))),
    );
    add("segments", &mut result.segment.iter().map(|s| u64::from(*s)));
    add("lit_color", &mut result.lit_color.iter().flat_map(vector));
    add("albedo", &mut result.albedo.iter().flat_map(vector).chain(segments().flat_map(|s| doubles(&s.albedo))));
    add("confidence", &mut result.confidence.iter().map(|c| u64::from(c.to_bits())));
    add("light", &mut light.coefficients.iter().chain(&light.standard_deviation).flat_map(doubles));
    add("radiance", &mut light.directions.iter().chain(&light.radiance).flatten().map(|x| u64::from(x.to_bits())));
    add("gloss", &mut segments().flat_map(|s| doubles(&[s.w_d, s.w_s, s.w_s_error])));
    add("exposures", &mut keyframes().flat_map(|k| doubles(&k.gain)));
    add("poses", &mut keyframes().flat_map(|k| k.world_from_camera.to_rows().into_iter().flatten().map(f64::to_bits)));
    digests
}

/// Asserts that the checksums of `scene` are those committed; with `UPDATE_DIGESTS` set, commits these instead.
///
/// # Panics
/// They differ, or none are committed.
pub fn assert_unchanged(scene: &str, found: &Digests) {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/digests")).join(format!("{scene}.json"));
    if std::env::var_os("UPDATE_DIGESTS").is_some() {
        let text = serde_json::to_string_pretty(found).expect("strings");
        std::fs::write(&path, text + "\n").unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    }
    let committed: Digests = serde_json::from_value(crate::truth::json(&path)).expect("checksums by name");
    let changed: Vec<&String> = found.keys().filter(|part| found.get(*part) != committed.get(*part)).collect();
    assert!(
        changed.is_empty() && found.len() == committed.len(),
        "{scene}: {changed:?} differ from {}; if that is meant, see tests/src/digests.rs",
        path.display()
    );
}
