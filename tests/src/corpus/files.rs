//! The files of scenes and results: NumPy arrays, pictures, meshes, JSON.

use glam::Vec3;
use recordings::ply::write::write_ply;
use recordings::types::{Mesh, Pose, RgbImage};
use serde_json::{Value, json};
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
    let mut bytes = Vec::new();
    write_ply(&mut bytes, "generated scene", mesh, &[])?;
    std::fs::write(path, bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use recordings::import::npy::Array;
    use recordings::ply::read::read_ply;

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
        assert_eq!(read_ply(&path).expect("a mesh"), mesh);
    }
}
