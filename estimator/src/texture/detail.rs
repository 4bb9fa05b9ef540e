//! Reads a texture: albedo at points of the surface, and how it differs from that of the vertices.

use glam::Vec3;
use recordings::result::Texture;
use recordings::types::{Mesh, RgbImage};
use std::borrow::Cow;

/// Share of the albedo of the value 255 below which there is no ratio: 8 bits have a few steps there. Surfaces that emit have
/// such albedos however bright they are.
const BLACK: f32 = 3e-3;

/// A texture, decoded, over its mesh.
#[derive(Debug)]
pub struct Detail<'a> {
    texture: Cow<'a, Texture>,
    picture: RgbImage,
    table: [f32; 256],
    mesh: Cow<'a, Mesh>,
    /// `[vertex]`.
    albedo: Cow<'a, [Vec3]>,
}

impl<'a> Detail<'a> {
    /// Decodes the texture of a mesh with these albedos at its vertices.
    ///
    /// # Errors
    /// The picture is damaged.
    pub fn new(texture: &'a Texture, mesh: &'a Mesh, albedo: &'a [Vec3]) -> Result<Self, String> {
        let (picture, table) = (texture.picture()?, texture.table());
        let (texture, mesh, albedo) = (Cow::Borrowed(texture), Cow::Borrowed(mesh), Cow::Borrowed(albedo));
        Ok(Self { texture, picture, table, mesh, albedo })
    }

    /// The same with a copy of the mesh, the charts and the albedo.
    #[must_use]
    pub fn into_owned(self) -> Detail<'static> {
        // The packed picture is not needed any more.
        let texture = Texture { jpeg: Vec::new(), ..self.texture.into_owned() };
        Detail {
            texture: Cow::Owned(texture),
            picture: self.picture,
            table: self.table,
            mesh: Cow::Owned(self.mesh.into_owned()),
            albedo: Cow::Owned(self.albedo.into_owned()),
        }
    }

    /// Linear albedo at barycentric `weights` of a triangle.
    #[must_use]
    pub fn albedo(&self, triangle: u32, weights: [f32; 3]) -> Vec3 {
        let chart = &self.texture.charts[self.texture.chart[triangle as usize] as usize];
        let corners = self.mesh.triangles[triangle as usize];
        let point = corners.iter().zip(weights).map(|(&i, w)| self.mesh.positions[i as usize] * w).sum::<Vec3>();
        let (w, h) = (self.texture.width, self.texture.height);
        let at = chart.texel(point).max(glam::Vec2::ZERO);
        let (x, y) = ((at.x as u32).min(w - 1), (at.y as u32).min(h - 1));
        let (right, below) = ((x + 1).min(w - 1), (y + 1).min(h - 1));
        let (fx, fy) = ((at.x - x as f32).min(1.0), (at.y - y as f32).min(1.0));
        let value = |x: u32, y: u32| {
            let i = 3 * (y as usize * w as usize + x as usize);
            Vec3::from_array(std::array::from_fn(|c| self.table[self.picture.data[i + c] as usize]))
        };
        let top = value(x, y) * (1.0 - fx) + value(right, y) * fx;
        let bottom = value(x, below) * (1.0 - fx) + value(right, below) * fx;
        top * (1.0 - fy) + bottom * fy
    }

    /// Albedo of the texture over that of the vertices, by channel.
    #[must_use]
    pub fn ratio(&self, triangle: u32, weights: [f32; 3]) -> Vec3 {
        let corners = self.mesh.triangles[triangle as usize];
        let smooth = corners.iter().zip(weights).map(|(&i, w)| self.albedo[i as usize] * w).sum::<Vec3>();
        let sharp = self.albedo(triangle, weights);
        let black = BLACK * self.texture.scale;
        let one = |s: f32, v: f32| if v > black { s / v } else { 1.0 };
        Vec3::new(one(sharp.x, smooth.x), one(sharp.y, smooth.y), one(sharp.z, smooth.z))
    }
}
