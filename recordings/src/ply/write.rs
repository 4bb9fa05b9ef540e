//! Writes PLY meshes, binary little-endian, with any further per-vertex columns.

use crate::types::Mesh;
use glam::Vec3;
use std::io::{Error, ErrorKind, Result, Write};

/// Values of a per-vertex column.
#[derive(Debug, Clone, PartialEq)]
pub enum Column<'a> {
    /// `float`.
    Float(&'a [f32]),
    /// Three `float` columns, one a component.
    Floats(&'a [Vec3]),
    /// `int`.
    Int(&'a [i32]),
    /// `uchar`.
    Byte(&'a [u8]),
    /// Three `uchar` columns, one a component.
    Bytes(&'a [[u8; 3]]),
}

impl Column<'_> {
    /// Type of the property and number of vertices.
    fn kind(&self) -> (&'static str, usize) {
        match self {
            Self::Float(v) => ("float", v.len()),
            Self::Floats(v) => ("float", v.len()),
            Self::Int(v) => ("int", v.len()),
            Self::Byte(v) => ("uchar", v.len()),
            Self::Bytes(v) => ("uchar", v.len()),
        }
    }

    fn write(&self, vertex: usize, out: &mut impl Write) -> Result<()> {
        match self {
            Self::Float(v) => out.write_all(&v[vertex].to_le_bytes()),
            Self::Floats(v) => out.write_all(bytemuck::bytes_of(&v[vertex].to_array().map(f32::to_le_bytes))),
            Self::Int(v) => out.write_all(&v[vertex].to_le_bytes()),
            Self::Byte(v) => out.write_all(&[v[vertex]]),
            Self::Bytes(v) => out.write_all(&v[vertex]),
        }
    }
}

/// Writes a mesh: `comment` (one line), x y z, nx ny nz if the mesh has normals, the columns with the names of their
/// properties, and the triangles.
///
/// # Errors
/// A column of another length than the mesh, or the file cannot be written.
pub fn write_ply(out: &mut impl Write, comment: &str, mesh: &Mesh, columns: &[(&[&str], Column)]) -> Result<()> {
    let n = mesh.positions.len();
    let positions = (&["x", "y", "z"][..], Column::Floats(&mesh.positions));
    let normals = (!mesh.normals.is_empty()).then_some((&["nx", "ny", "nz"][..], Column::Floats(&mesh.normals)));
    let columns: Vec<_> = [Some(positions), normals].into_iter().flatten().chain(columns.iter().cloned()).collect();
    write!(out, "ply\nformat binary_little_endian 1.0\ncomment {comment}\nelement vertex {n}\n")?;
    for (names, column) in &columns {
        let (kind, length) = column.kind();
        if length != n {
            let problem = format!("column {} has {length} values for {n} vertices", names.concat());
            return Err(Error::new(ErrorKind::InvalidInput, problem));
        }
        for name in *names {
            writeln!(out, "property {kind} {name}")?;
        }
    }
    write!(out, "element face {}\nproperty list uchar int vertex_indices\nend_header\n", mesh.triangles.len())?;
    for vertex in 0..n {
        columns.iter().try_for_each(|(_, column)| column.write(vertex, out))?;
    }
    for triangle in &mesh.triangles {
        out.write_all(&[3])?;
        out.write_all(bytemuck::bytes_of(&triangle.map(u32::to_le_bytes)))?;
    }
    out.flush()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ply::read::parse_ply;
    use crate::testing::bumpy_mesh;

    #[test]
    fn written_meshes_come_back() {
        let mesh = bumpy_mesh(6);
        let (floats, ints, bytes) = ([0.5; 36], [-7; 36], [[200, 1, 2]; 36]);
        let columns = [
            (&["confidence"][..], Column::Float(&floats)),
            (&["segment"], Column::Int(&ints)),
            (&["red", "green", "blue"], Column::Bytes(&bytes)),
        ];
        let mut file = Vec::new();
        write_ply(&mut file, "metres", &mesh, &columns).unwrap();
        let (back, found) = parse_ply(&file, &["red", "segment", "confidence"]).unwrap();
        assert_eq!((&back.positions, &back.triangles), (&mesh.positions, &mesh.triangles));
        assert!(back.normals.iter().zip(&mesh.normals).all(|(a, b)| (a - b).length() < 1e-6));
        assert_eq!([found[0].values[3], found[1].values[4], found[2].values[35]], [200.0, -7.0, 0.5]);
        assert!(write_ply(&mut file, "", &mesh, &[(&["short"], Column::Int(&[1]))]).is_err());
    }
}
