//! An object from a PLY file: what `recordings` reads, with its colours and texture coordinates.

use crate::render::objects::material::Material;
use crate::render::objects::object::{Object, finish};
use glam::{Vec2, Vec3};
use recordings::ply::read::{VertexColumn, parse_ply};
use recordings::types::Response;

/// Names of colours and texture coordinates: any of them that a file has.
const COLORS: [[&str; 3]; 3] = [["albedo_r", "albedo_g", "albedo_b"], ["red", "green", "blue"], ["r", "g", "b"]];
const COORDINATES: [[&str; 2]; 3] = [["u", "v"], ["s", "t"], ["texture_u", "texture_v"]];

/// Reads an object; world axes (+Z up), metres.
///
/// # Errors
/// What is wrong with the bytes.
pub fn read(bytes: &[u8]) -> Result<Object, String> {
    let wanted: Vec<&str> = COLORS.as_flattened().iter().chain(COORDINATES.as_flattened()).copied().collect();
    let (mesh, columns) = parse_ply(bytes, &wanted)?;
    let column = |name: &str| columns.iter().find(|c| c.name == name);
    let mut object = Object { mesh, materials: vec![Material::default()], ..Object::default() };
    if let Some([r, g, b]) = COLORS.iter().find_map(|n| Some([column(n[0])?, column(n[1])?, column(n[2])?])) {
        let table = Response::Srgb.linear_table();
        // Bytes are sRGB, floats are linear.
        let linear =
            |c: &VertexColumn, v: usize| if c.is_byte { table[c.values[v] as u8 as usize] } else { c.values[v] };
        let color = |v: usize| Vec3::new(linear(r, v), linear(g, v), linear(b, v));
        object.color = (0..object.mesh.positions.len()).map(color).collect();
    }
    if let Some((u, v)) = COORDINATES.iter().find_map(|n| column(n[0]).zip(column(n[1]))) {
        object.uv = u.values.iter().zip(&v.values).map(|(u, v)| Vec2::new(*u, 1.0 - *v)).collect();
    }
    finish(object)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: &str = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
        property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\nproperty list uchar int vertex_indices\n\
        end_header\n0 0 0 255 0 0\n1 0 0 255 0 0\n0 1 0 255 0 0\n3 0 1 2\n";

    #[test]
    fn a_triangle_is_read_and_every_truncation_is_an_error() {
        let object = read(TRIANGLE.as_bytes()).unwrap();
        assert_eq!(object.mesh.triangles, [[0, 1, 2]]);
        assert_eq!((object.mesh.normals[0], object.color[0]), (Vec3::Z, Vec3::X));
        for n in 0..TRIANGLE.len() - 1 {
            assert!(read(&TRIANGLE.as_bytes()[..n]).is_err(), "{n}");
        }
    }

    #[test]
    fn what_cannot_be_used_is_named() {
        let say = |from: &str, to: &str| read(TRIANGLE.replace(from, to).as_bytes()).unwrap_err();
        assert!(say("1 0 0 255", "nan 0 0 255").contains("NaN"));
        assert!(say("3 0 1 2", "3 0 1 7").contains("vertex 7 of 3"));
        assert!(say("3 0 1 2", "2 0 1").contains("no triangles"));
        assert!(say("element vertex 3", "element vertex 99999999999").contains("end early"));
        assert!(say("format ascii", "format klingon").contains("klingon"));
    }
}
