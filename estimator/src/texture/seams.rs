//! The mesh for programs that know one texture coordinate per vertex: vertices on seams are there once per chart.

use crate::export::picture::encode_jpeg;
use glam::Vec2;
use recordings::result::Texture;
use recordings::types::{Mesh, Response};
use std::collections::HashMap;
use std::io::{Error, Result};

/// A mesh cut along the seams of its texture.
pub struct Unwrapped {
    /// Index of the mesh's vertex: `[vertex here]`.
    pub vertex: Vec<u32>,
    /// Texture coordinates, (0, 0) at the left top corner of the picture: `[vertex here]`.
    pub coordinates: Vec<[f32; 2]>,
    /// In the order of the mesh's triangles.
    pub triangles: Vec<[u32; 3]>,
}

impl Unwrapped {
    /// Cuts a mesh.
    #[must_use]
    pub fn new(mesh: &Mesh, texture: &Texture) -> Self {
        let size = Vec2::new(texture.width as f32, texture.height as f32);
        let mut number: HashMap<(u32, u32), u32> = HashMap::with_capacity(mesh.positions.len());
        let (mut vertex, mut coordinates) = (Vec::new(), Vec::new());
        let mut corner = |v: u32, chart: u32| {
            *number.entry((v, chart)).or_insert_with(|| {
                let texel = texture.charts[chart as usize].texel(mesh.positions[v as usize]);
                vertex.push(v);
                coordinates.push(((texel + 0.5) / size).to_array());
                (vertex.len() - 1) as u32
            })
        };
        let triangles = mesh.triangles.iter().zip(&texture.chart).map(|(t, &c)| t.map(|v| corner(v, c))).collect();
        Self { vertex, coordinates, triangles }
    }
}

/// The picture of a texture for programs whose colours end at 1, as a JPEG file.
///
/// # Errors
/// The picture is damaged.
pub fn jpeg_up_to_one(texture: &Texture) -> Result<Vec<u8>> {
    if texture.scale <= 1.0 {
        return Ok(texture.jpeg.clone());
    }
    let mut picture = texture.picture().map_err(Error::other)?;
    let table = texture.table().map(|albedo| Response::Srgb.encode(albedo));
    picture.data.iter_mut().for_each(|value| *value = table[*value as usize]);
    encode_jpeg(texture.width, texture.height, &picture.data, 95)
}
