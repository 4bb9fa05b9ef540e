//! Mesh + posed photos (`mesh.ply`, `transforms.json` in the NeRF convention) straight to a scan.

use crate::error::Result;
use crate::scan::Scan;
use std::path::Path;

/// Reads `dir/transforms.json`, its pictures, and the mesh (`mesh`, by default `dir/mesh.ply`).
///
/// # Errors
/// Missing files, a mesh without triangles or with NaN, poses that are no rigid transforms, truncated pictures.
pub fn import_photos(_dir: &Path, _mesh: Option<&Path>) -> Result<Scan> {
    unimplemented!()
}
