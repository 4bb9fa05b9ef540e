//! The files of scenes and results: NumPy arrays, pictures, meshes, JSON.

use glam::Vec3;
use recordings::types::{Mesh, Pose, RgbImage};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io;
use std::path::Path;

/// Writes an array of 32-bit floats in C order.
///
/// # Errors
/// The file cannot be written.
pub fn write_floats(path: &Path, shape: &[usize], data: impl Iterator<Item = f32>) -> io::Result<()> {
    std::fs::write(path, array("<f4", shape, data.flat_map(f32::to_le_bytes).collect()))
}

/// Writes rows of three.
///
/// # Errors
/// The file cannot be written.
pub fn write_vectors(path: &Path, shape: &[usize], data: &[Vec3]) -> io::Result<()> {
    write_floats(path, &[shape, &[3]].concat(), data.iter().flat_map(|v| v.to_array()))
}

/// Writes an array of bytes.
///
/// # Errors
/// The file cannot be written.
pub fn write_bytes(path: &Path, data: &[u8]) -> io::Result<()> {
    std::fs::write(path, array("|u1", &[data.len()], data.to_vec()))
}

pub(super) fn array(kind: &str, shape: &[usize], data: Vec<u8>) -> Vec<u8> {
    let shape: String = shape.iter().map(|n| format!("{n}, ")).collect();
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({}), }}", shape.trim_end());
    // Magic, version and length are 10 bytes; the header ends with a new line at a multiple of 64.
    let padding = 63 - (10 + header.len()) % 64;
    header.push_str(&" ".repeat(padding));
    header.push('\n');
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend((header.len() as u16).to_le_bytes());
    out.extend(header.into_bytes());
    out.extend(data);
    out
}

/// Writes an 8-bit colour picture.
///
/// # Errors
/// The file cannot be written.
pub fn write_picture(path: &Path, picture: &RgbImage) -> io::Result<()> {
    write_png(path, [picture.width, picture.height], png::ColorType::Rgb, &picture.data)
}

/// Writes a mask: 255 where true.
///
/// # Errors
/// The file cannot be written.
pub fn write_mask(path: &Path, size: [u32; 2], mask: &[bool]) -> io::Result<()> {
    let data: Vec<u8> = mask.iter().map(|&m| if m { 255 } else { 0 }).collect();
    write_png(path, size, png::ColorType::Grayscale, &data)
}

fn write_png(path: &Path, size: [u32; 2], color: png::ColorType, data: &[u8]) -> io::Result<()> {
    let mut encoder = png::Encoder::new(io::BufWriter::new(std::fs::File::create(path)?), size[0], size[1]);
    encoder.set_color(color);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    Ok(writer.write_image_data(data)?)
}

/// Reads a mask.
///
/// # Errors
/// The file cannot be read.
pub fn read_mask(path: &Path) -> io::Result<Vec<bool>> {
    let mut reader = png::Decoder::new(io::BufReader::new(std::fs::File::open(path)?)).read_info()?;
    let mut data = vec![0; reader.output_buffer_size().unwrap_or(0)];
    reader.next_frame(&mut data)?;
    Ok(data.iter().map(|&x| x > 127).collect())
}

/// Writes a document.
///
/// # Errors
/// The file cannot be written.
pub fn write_json(path: &Path, value: &Value) -> io::Result<()> {
    std::fs::write(path, serde_json::to_string_pretty(value)? + "\n")
}

/// Reads a document; `None` where there is no such file.
///
/// # Errors
/// The file is damaged.
pub fn read_json(path: &Path) -> io::Result<Option<Value>> {
    match std::fs::read(path) {
        Ok(bytes) => Ok(Some(serde_json::from_slice(&bytes)?)),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(e) => Err(e),
    }
}

/// A pose as a row-major 4×4 matrix in JSON.
#[must_use]
pub fn matrix(pose: &Pose) -> Value {
    json!(pose.to_rows())
}

/// A pose from a row-major 4×4 matrix in JSON.
#[must_use]
pub fn pose(value: &Value) -> Option<Pose> {
    Pose::from_rows(&serde_json::from_value::<[[f64; 4]; 4]>(value.clone()).ok()?)
}

/// Writes a mesh with normals as the truth scenes have it.
///
/// # Errors
/// The file cannot be written.
pub fn write_mesh(path: &Path, mesh: &Mesh) -> io::Result<()> {
    let names = ["x", "y", "z", "nx", "ny", "nz"].map(|n| format!("property float {n}\n")).concat();
    let mut out = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\n{names}element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        mesh.positions.len(),
        mesh.triangles.len()
    )
    .into_bytes();
    for (p, n) in mesh.positions.iter().zip(&mesh.normals) {
        out.extend([p, n].into_iter().flat_map(|v| v.to_array()).flat_map(f32::to_le_bytes));
    }
    for triangle in &mesh.triangles {
        out.push(3);
        out.extend(triangle.iter().flat_map(|i| i.to_le_bytes()));
    }
    std::fs::write(path, out)
}

/// A binary little-endian mesh with any numbers at its vertices.
#[derive(Debug)]
pub struct Table {
    /// Columns by name.
    pub columns: BTreeMap<String, Vec<f32>>,
    /// Triangles.
    pub triangles: Vec<[u32; 3]>,
}

impl Table {
    /// Reads a file.
    ///
    /// # Errors
    /// The file cannot be read or is of another kind.
    pub fn read(path: &Path) -> io::Result<Self> {
        let bytes = std::fs::read(path)?;
        Self::parse(&bytes).ok_or_else(|| io::Error::other(format!("{}: not a mesh that can be read", path.display())))
    }

    fn parse(bytes: &[u8]) -> Option<Self> {
        const END: &[u8] = b"end_header\n";
        let body = bytes.windows(END.len()).position(|w| w == END)? + END.len();
        let header = std::str::from_utf8(&bytes[..body]).ok()?;
        let (mut counts, mut names, mut index_size) = (Vec::new(), Vec::new(), 4);
        for line in header.lines() {
            match line.split(' ').collect::<Vec<_>>()[..] {
                ["element", _, count] => counts.push(count.parse::<usize>().ok()?),
                ["property", "list", _, kind, _] => index_size = size(kind)?,
                ["property", kind, name] => names.push((kind, name)),
                _ => {}
            }
        }
        let [vertices, faces] = counts[..] else { return None };
        let mut columns: Vec<Vec<f32>> = vec![Vec::with_capacity(vertices); names.len()];
        let mut at = body;
        for _ in 0..vertices {
            for ((kind, _), column) in names.iter().zip(&mut columns) {
                let raw = bytes.get(at..at + size(kind)?)?;
                at += raw.len();
                column.push(match *kind {
                    "float" => f32::from_le_bytes(raw.try_into().ok()?),
                    "int" => i32::from_le_bytes(raw.try_into().ok()?) as f32,
                    _ => f32::from(raw[0]),
                });
            }
        }
        let mut triangles = Vec::with_capacity(faces);
        for _ in 0..faces {
            let raw = bytes.get(at + 1..at + 1 + 3 * index_size)?;
            at += 1 + raw.len();
            let index = |k: usize| {
                let mut whole = [0; 4];
                whole[..index_size].copy_from_slice(&raw[k * index_size..(k + 1) * index_size]);
                u32::from_le_bytes(whole)
            };
            triangles.push([index(0), index(1), index(2)]);
        }
        let columns = names.iter().map(|(_, n)| (*n).to_owned()).zip(columns).collect();
        Some(Self { columns, triangles })
    }

    /// Three columns as vectors.
    #[must_use]
    pub fn vectors(&self, names: [&str; 3]) -> Option<Vec<Vec3>> {
        let [x, y, z] = names.map(|n| self.columns.get(n));
        let (x, y, z) = (x?, y?, z?);
        Some((0..x.len()).map(|i| Vec3::new(x[i], y[i], z[i])).collect())
    }

    /// The mesh.
    #[must_use]
    pub fn mesh(&self) -> Option<Mesh> {
        Some(Mesh {
            positions: self.vectors(["x", "y", "z"])?,
            normals: self.vectors(["nx", "ny", "nz"])?,
            triangles: self.triangles.clone(),
        })
    }
}

fn size(kind: &str) -> Option<usize> {
    match kind {
        "float" | "int" | "uint" => Some(4),
        "short" | "ushort" => Some(2),
        "char" | "uchar" => Some(1),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use recordings::import::npy::Array;

    #[test]
    fn arrays_and_meshes_come_back() {
        let dir = tempfile::tempdir().expect("a folder");
        let path = dir.path().join("a.npy");
        write_vectors(&path, &[2], &[Vec3::new(1.0, 2.0, 3.0), Vec3::new(4.0, 5.0, 6.5)]).expect("written");
        let found = Array::read(&path).expect("an array");
        assert_eq!((found.shape, found.data), (vec![2, 3], vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.5]));
        let mesh = Mesh { positions: vec![Vec3::X; 3], normals: vec![Vec3::Z; 3], triangles: vec![[0, 2, 1]] };
        let path = dir.path().join("a.ply");
        write_mesh(&path, &mesh).expect("written");
        assert_eq!(Table::read(&path).expect("read").mesh().expect("a mesh"), mesh);
    }
}
