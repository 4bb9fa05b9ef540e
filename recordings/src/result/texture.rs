//! Albedo at the resolution of the photographs: a texture atlas over the mesh of a result, and its chunk.
//!
//! A chart is an orthographic view of a part of the mesh, so its texture coordinates follow from the vertices' positions: what is
//! stored is a frame per chart, a chart per triangle and the picture.

use crate::codec::header::{from_bytes, to_bytes};
use crate::codec::image::PictureHeader;
use crate::codec::pack::{Input, put_bytes, put_varint, take_bytes};
use crate::types::{ColorEncoding, Response, RgbImage};
use glam::{Vec2, Vec3};
use serde::{Deserialize, Serialize};

/// Longest side of an atlas, in texels.
pub const MAX_TEXTURE_SIDE: u32 = 4096;

/// An orthographic view of a part of the mesh.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Chart {
    /// The texel of a position p is (x·p + x_offset, y·p + y_offset), with the axes in texels per metre.
    pub x_axis: [f32; 3],
    /// See `x_axis`.
    pub y_axis: [f32; 3],
    /// Texel column of the world's origin.
    pub x_offset: f32,
    /// Texel row of the world's origin.
    pub y_offset: f32,
}

impl Chart {
    /// Texel of a position in the world; texel centres stand at integers.
    #[must_use]
    pub fn texel(&self, p: Vec3) -> Vec2 {
        Vec2::new(
            Vec3::from_array(self.x_axis).dot(p) + self.x_offset,
            Vec3::from_array(self.y_axis).dot(p) + self.y_offset,
        )
    }

    fn is_finite(&self) -> bool {
        self.x_axis.iter().chain(&self.y_axis).chain([&self.x_offset, &self.y_offset]).all(|x| x.is_finite())
    }
}

/// Albedo at the resolution of the photographs.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    /// Texels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Width of a texel on the surface, metres.
    pub texel_m: f32,
    /// Linear albedo of the value 255.
    pub scale: f32,
    /// The charts.
    pub charts: Vec<Chart>,
    /// Index into `charts`: `[triangle]`.
    pub chart: Vec<u32>,
    /// Albedo over `scale`, sRGB, as a JPEG file.
    pub jpeg: Vec<u8>,
}

/// Head of the chunk; the charts of the triangles and the picture follow.
#[derive(Debug, Serialize, Deserialize)]
struct TextureV1 {
    width: u32,
    height: u32,
    texel_m: f32,
    scale: f32,
    charts: Vec<Chart>,
    triangles: u32,
    chart_bytes: u32,
}

impl Texture {
    /// Decodes the picture.
    ///
    /// # Errors
    /// The picture is damaged.
    pub fn picture(&self) -> Result<RgbImage, String> {
        RgbImage::decode(&self.jpeg)
    }

    /// Linear albedo of 8-bit values.
    #[must_use]
    pub fn table(&self) -> [f32; 256] {
        Response::Srgb.linear_table().map(|x| x * self.scale)
    }

    /// What makes this no texture of a mesh with so many triangles, if anything.
    pub(crate) fn check(&self, triangles: usize) -> Result<(), String> {
        let sides = 1..=MAX_TEXTURE_SIDE;
        let header = PictureHeader::read(&self.jpeg)?;
        if !sides.contains(&self.width) || !sides.contains(&self.height) {
            return Err(format!("a texture of {} × {} texels", self.width, self.height));
        }
        if (header.width, header.height, header.encoding) != (self.width, self.height, ColorEncoding::Jpeg) {
            return Err("the texture's picture is not of its size".into());
        }
        if self.chart.len() != triangles || self.chart.iter().any(|c| *c as usize >= self.charts.len()) {
            return Err("the texture's charts do not fit the mesh".into());
        }
        let positive = |x: f32| x.is_finite() && x > 0.0;
        if !positive(self.texel_m) || !positive(self.scale) || !self.charts.iter().all(Chart::is_finite) {
            return Err("the texture holds numbers that make no sense".into());
        }
        Ok(())
    }

    /// The chunk; `order` are the triangles in the order in which the file lists them.
    pub(crate) fn pack(&self, order: &[u32]) -> Result<Vec<u8>, String> {
        let (mut numbers, mut before) = (Vec::new(), 0u32);
        for chart in order.iter().map(|t| self.chart[*t as usize]) {
            let difference = chart.wrapping_sub(before) as i32;
            put_varint(&mut numbers, ((difference << 1) ^ (difference >> 31)) as u32);
            before = chart;
        }
        let head = TextureV1 {
            width: self.width,
            height: self.height,
            texel_m: self.texel_m,
            scale: self.scale,
            charts: self.charts.clone(),
            triangles: order.len() as u32,
            chart_bytes: numbers.len() as u32,
        };
        let mut out = to_bytes(&head)?;
        put_bytes(&mut out, &numbers);
        out.extend(&self.jpeg);
        Ok(out)
    }

    /// Reads a chunk of [`Texture::pack`].
    pub(crate) fn unpack(bytes: &[u8]) -> Result<Self, String> {
        let (head, rest) = from_bytes::<TextureV1>(bytes)?;
        let mut input = Input(rest);
        let numbers = take_bytes(&mut input, head.chart_bytes as usize)?;
        if head.triangles as usize > numbers.len() {
            return Err("more triangles than charts are listed for".into());
        }
        let (mut numbers, mut before) = (Input(&numbers), 0u32);
        let mut chart = Vec::with_capacity(head.triangles as usize);
        for _ in 0..head.triangles {
            let code = numbers.varint()?;
            before = before.wrapping_add((code >> 1) ^ (code & 1).wrapping_neg());
            chart.push(before);
        }
        let TextureV1 { width, height, texel_m, scale, charts, .. } = head;
        Ok(Self { width, height, texel_m, scale, charts, chart, jpeg: input.0.to_vec() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::result::Estimate;
    use crate::testing::{bumpy_mesh, estimate_on, refuses_damage, textured};
    use proptest::prelude::*;

    #[test]
    fn a_texture_comes_back_with_the_triangles_in_their_new_order() {
        let estimate = textured(estimate_on(bumpy_mesh(8)));
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.lres");
        estimate.write(&path).unwrap();
        let read = Estimate::read(&path).unwrap();
        let (texture, expected) = (read.texture.unwrap(), estimate.texture.unwrap());
        assert_eq!(Texture { chart: vec![], ..texture.clone() }, Texture { chart: vec![], ..expected.clone() });
        let sorted = |t: [u32; 3]| {
            let mut t = t;
            t.sort_unstable();
            t
        };
        let mut before: Vec<_> = estimate.mesh.triangles.iter().map(|t| sorted(*t)).zip(expected.chart).collect();
        let mut after: Vec<_> = read.mesh.triangles.iter().map(|t| sorted(*t)).zip(texture.chart).collect();
        before.sort_unstable();
        after.sort_unstable();
        assert_eq!(before, after);
        refuses_damage(&path, Estimate::read);
    }

    #[test]
    fn nonsense_is_no_texture() {
        let good = textured(estimate_on(bumpy_mesh(4)));
        let triangles = good.mesh.triangles.len();
        let texture = good.texture.unwrap();
        assert_eq!(texture.check(triangles), Ok(()));
        let refused = |change: &dyn Fn(&mut Texture)| {
            let mut bad = texture.clone();
            change(&mut bad);
            bad.check(triangles).is_err()
        };
        assert!(refused(&|t| t.chart[0] = 7));
        assert!(refused(&|t| t.chart.truncate(1)));
        assert!(refused(&|t| t.width += 1));
        assert!(refused(&|t| t.scale = f32::NAN));
        assert!(refused(&|t| t.texel_m = 0.0));
        assert!(refused(&|t| t.charts[0].x_offset = f32::INFINITY));
        assert!(refused(&|t| t.jpeg.truncate(30)));
    }

    proptest! {
        #[test]
        fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = Texture::unpack(&bytes);
        }
    }
}
