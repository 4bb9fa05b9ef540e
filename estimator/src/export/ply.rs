//! The mesh as binary PLY with everything known of each vertex.

use crate::export::encode_srgb;
use recordings::result::Estimate;
use std::fs::File;
use std::io::{BufWriter, Result, Write};
use std::path::Path;

/// Properties of a vertex, in order.
const VERTEX: [(&str, &str); 17] = [
    ("float", "x"),
    ("float", "y"),
    ("float", "z"),
    ("float", "nx"),
    ("float", "ny"),
    ("float", "nz"),
    ("uchar", "red"),
    ("uchar", "green"),
    ("uchar", "blue"),
    ("float", "albedo_r"),
    ("float", "albedo_g"),
    ("float", "albedo_b"),
    ("float", "lit_r"),
    ("float", "lit_g"),
    ("float", "lit_b"),
    ("float", "confidence"),
    ("int", "segment"),
];

/// Writes the mesh to `path`: `red green blue` is the lit colour as viewers show it (sRGB), `albedo_*` and `lit_*` are
/// linear. Nothing appears under that name before it is complete.
///
/// # Errors
/// The disk is full or gone.
pub fn write(result: &Estimate, path: &Path) -> Result<()> {
    super::write_whole(path, |file| write_to(result, BufWriter::new(file)))
}

fn write_to(result: &Estimate, mut out: BufWriter<&File>) -> Result<()> {
    let mesh = &result.mesh;
    writeln!(
        out,
        "ply\nformat binary_little_endian 1.0\ncomment Lumiscan: metres, +Z up, linear albedo and lit colour"
    )?;
    writeln!(out, "element vertex {}", mesh.positions.len())?;
    for (kind, name) in VERTEX {
        writeln!(out, "property {kind} {name}")?;
    }
    writeln!(out, "element face {}\nproperty list uchar int vertex_indices\nend_header", mesh.triangles.len())?;
    for i in 0..mesh.positions.len() {
        let (albedo, lit) = (result.albedo[i], result.lit_color[i]);
        floats(&mut out, mesh.positions[i].as_ref())?;
        floats(&mut out, mesh.normals[i].as_ref())?;
        out.write_all(&lit.to_array().map(encode_srgb))?;
        floats(&mut out, albedo.as_ref())?;
        floats(&mut out, lit.as_ref())?;
        floats(&mut out, &[result.confidence[i]])?;
        out.write_all(&(result.segment[i] as i32).to_le_bytes())?;
    }
    for triangle in &mesh.triangles {
        out.write_all(&[3])?;
        for corner in triangle {
            out.write_all(&(*corner as i32).to_le_bytes())?;
        }
    }
    out.flush()
}

fn floats(out: &mut impl Write, values: &[f32]) -> Result<()> {
    values.iter().try_for_each(|v| out.write_all(&v.to_le_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::tiny;

    #[test]
    fn sizes_and_values_are_where_the_header_says() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.ply");
        let result = tiny();
        write(&result, &path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let size = |kind: &str| if kind == "uchar" { 1 } else { 4 };
        let stride: usize = VERTEX.iter().map(|(kind, _)| size(kind)).sum();
        assert_eq!(bytes.len() - end, 3 * stride + 13);
        let at = |vertex: usize, name: &str| {
            let column = VERTEX.iter().position(|(_, n)| *n == name).unwrap();
            let offset = end + vertex * stride + VERTEX[..column].iter().map(|(k, _)| size(k)).sum::<usize>();
            <[u8; 4]>::try_from(&bytes[offset..offset + 4]).unwrap()
        };
        assert_eq!(f32::from_le_bytes(at(1, "x")), result.mesh.positions[1].x);
        assert_eq!(f32::from_le_bytes(at(2, "albedo_g")), result.albedo[2].y);
        assert_eq!(i32::from_le_bytes(at(2, "segment")), 1);
    }
}
