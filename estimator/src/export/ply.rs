//! The mesh as binary PLY with everything known of each vertex.

use crate::export::file::write_whole;
use recordings::ply::write::{Column, write_ply};
use recordings::result::Estimate;
use recordings::types::Response;
use std::io::{BufWriter, Result};
use std::path::Path;

/// Writes the mesh to `path`: `red green blue` is the lit colour as viewers show it (sRGB), `albedo_*`, `lit_*` and, where
/// a surface emits, `emission_*` (radiance from its front) are linear. Nothing appears under that name before it is complete.
///
/// # Errors
/// The disk is full or gone.
pub fn write(result: &Estimate, path: &Path) -> Result<()> {
    let shown: Vec<[u8; 3]> = result.lit_color.iter().map(|c| c.to_array().map(|c| Response::Srgb.encode(c))).collect();
    let segment: Vec<i32> = result.segment.iter().map(|s| *s as i32).collect();
    let emission = result.local_light.emission(result.mesh.positions.len());
    let mut columns = vec![
        (&["red", "green", "blue"][..], Column::Bytes(&shown)),
        (&["albedo_r", "albedo_g", "albedo_b"], Column::Floats(&result.albedo)),
        (&["lit_r", "lit_g", "lit_b"], Column::Floats(&result.lit_color)),
        (&["confidence"], Column::Float(&result.confidence)),
        (&["segment"], Column::Int(&segment)),
    ];
    if !result.local_light.emitters.is_empty() {
        columns.push((&["emission_r", "emission_g", "emission_b"], Column::Floats(&emission)));
    }
    write_whole(path, |file| {
        let comment = "Lumiscan: metres, +Z up, linear albedo and lit colour";
        write_ply(&mut BufWriter::new(file), comment, &result.mesh, &columns)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::tiny;
    use recordings::ply::read::parse_ply;

    #[test]
    fn every_column_is_written() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.ply");
        let result = tiny();
        write(&result, &path).unwrap();
        let names = ["albedo_g", "lit_r", "green", "confidence", "segment"];
        let (mesh, columns) = parse_ply(&std::fs::read(&path).unwrap(), &names).unwrap();
        assert_eq!((&mesh.positions, &mesh.triangles), (&result.mesh.positions, &result.mesh.triangles));
        assert_eq!(columns.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(), names);
        let [albedo, lit, green, confidence, segment] = [0, 1, 2, 3, 4].map(|k| &columns[k].values);
        assert_eq!(**albedo, result.albedo.iter().map(|a| a.y).collect::<Vec<_>>());
        assert_eq!(**lit, result.lit_color.iter().map(|a| a.x).collect::<Vec<_>>());
        assert_eq!((green[2], confidence[1], segment[2]), (255.0, 1.0, 1.0));
    }
}
