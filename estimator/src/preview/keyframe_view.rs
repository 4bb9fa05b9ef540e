//! The mesh seen from a keyframe, coloured by anything that vertices have.

use crate::mesh::raster::{MISS, Raster, camera_positions, scaled};
use crate::preview::vertex_light::VertexLight;
use crate::texture::detail::Detail;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use recordings::result::{Estimate, ResultKeyframe};
use recordings::types::{Intrinsics, RgbImage};

/// Samples along each side of a pixel.
const SUPERSAMPLING: u32 = 2;
/// Nearer than this share of the scene's depth nothing is drawn.
const NEAR_SHARE: f64 = 1e-3;

/// What one keyframe sees of the mesh.
pub struct KeyframeView<'a> {
    result: &'a Estimate,
    keyframe: &'a ResultKeyframe,
    /// Supersampled.
    raster: Raster,
    corners: Vec<DVec3>,
}

/// An RGB picture in linear or display values, row-major; `None` where nothing is seen.
pub struct Panel {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Display values, 0 to 1, and the covered share of the pixel.
    pub pixels: Vec<([f32; 3], f32)>,
}

impl<'a> KeyframeView<'a> {
    /// Rasterises the mesh into the keyframe's (undistorted) camera at `width` pixels a row.
    pub fn new(result: &'a Estimate, keyframe: &'a ResultKeyframe, width: u32) -> Self {
        let full = keyframe.camera.intrinsics;
        let camera = scaled(&full, f64::from(width * SUPERSAMPLING) / f64::from(full.width.max(1)));
        let corners = camera_positions(&result.mesh, &keyframe.world_from_camera);
        let raster = Raster::new(&corners, &result.mesh.triangles, &camera, near(&corners));
        Self { result, keyframe, raster, corners }
    }

    /// Paints every sample with the interpolated `values` of its triangle's corners, turned into a display value.
    pub fn paint(&self, values: &[Vec3], display: impl Fn(Vec3) -> [f32; 3] + Sync) -> Panel {
        self.paint_with(None, values, display)
    }

    /// The same with values that follow the albedo, as fine as the texture has it.
    pub fn paint_with(
        &self,
        detail: Option<&Detail>,
        values: &[Vec3],
        display: impl Fn(Vec3) -> [f32; 3] + Sync,
    ) -> Panel {
        let (w, h) = (self.raster.camera.width / SUPERSAMPLING, self.raster.camera.height / SUPERSAMPLING);
        let pixels = (0..w * h).into_par_iter().map(|i| {
            let (mut sum, mut covered) = ([0.0f32; 3], 0.0f32);
            for s in 0..SUPERSAMPLING * SUPERSAMPLING {
                let x = (i % w * SUPERSAMPLING + s % SUPERSAMPLING) as usize;
                let y = (i / w * SUPERSAMPLING + s / SUPERSAMPLING) as usize;
                let triangle = self.raster.triangle[y * self.raster.camera.width as usize + x];
                if triangle == MISS {
                    continue;
                }
                let t = self.result.mesh.triangles[triangle as usize].map(|c| c as usize);
                let weights = self.raster.weights(x, y, t.map(|c| self.corners[c]));
                let mut value = values[t[0]] * weights[0] + values[t[1]] * weights[1] + values[t[2]] * weights[2];
                if let Some(detail) = detail {
                    value *= detail.ratio(triangle, weights);
                }
                sum = std::array::from_fn(|c| sum[c] + display(value)[c]);
                covered += 1.0;
            }
            let all = (SUPERSAMPLING * SUPERSAMPLING) as f32;
            (sum.map(|c| if covered > 0.0 { c / covered } else { 0.0 }), covered / all)
        });
        Panel { width: w, height: h, pixels: pixels.collect() }
    }

    /// Name of the keyframe.
    pub fn name(&self) -> &str {
        &self.keyframe.name
    }

    /// Share of the picture that the mesh covers.
    pub fn coverage(&self) -> f64 {
        let seen = self.raster.triangle.iter().filter(|t| **t != MISS).count();
        seen as f64 / self.raster.triangle.len().max(1) as f64
    }

    /// How much each vertex faces the camera, 0.35 to 1: shape without light.
    pub fn headlight(&self) -> Vec<f32> {
        let eye = self.keyframe.world_from_camera.translation.as_vec3();
        let mesh = &self.result.mesh;
        let facing = |(p, n): (&Vec3, &Vec3)| 0.35 + 0.65 * (eye - *p).normalize_or_zero().dot(*n).abs();
        mesh.positions.iter().zip(&mesh.normals).map(facing).collect()
    }

    /// The vertices of every triangle in view: `[vertex]`.
    pub fn seen(&self) -> Vec<bool> {
        let mut seen = vec![false; self.result.mesh.positions.len()];
        for t in self.raster.triangle.iter().filter(|t| **t != MISS) {
            self.result.mesh.triangles[*t as usize].iter().for_each(|c| seen[*c as usize] = true);
        }
        seen
    }

    /// Radiance towards the camera of every vertex in view by Eqs. (9) and (13): albedo × irradiance at the transfer
    /// level of the result, plus gloss and emission. Black out of view.
    pub fn model(&self, light: &VertexLight) -> Vec<Vec3> {
        let eye = self.keyframe.world_from_camera.translation.as_vec3();
        let radiance = |(i, seen): (usize, &bool)| if *seen { light.radiance(i, eye) } else { Vec3::ZERO };
        self.seen().par_iter().enumerate().map(radiance).collect()
    }

    /// The keyframe's own picture, without the lens's distortion, at the panel's size.
    pub fn photo(&self, picture: &RgbImage) -> Panel {
        let camera = scaled(&self.raster.camera, 1.0 / f64::from(SUPERSAMPLING));
        let pixels = (0..camera.width * camera.height).into_par_iter().map(|i| {
            let (x, y) = (f64::from(i % camera.width), f64::from(i / camera.width));
            let color = self.photo_pixel(picture, &camera, x, y);
            (color.unwrap_or_default(), if color.is_some() { 1.0 } else { 0.0 })
        });
        Panel { width: camera.width, height: camera.height, pixels: pixels.collect() }
    }

    /// Mean of the samples within one pixel of the panel.
    fn photo_pixel(&self, picture: &RgbImage, camera: &Intrinsics, x: f64, y: f64) -> Option<[f32; 3]> {
        let (mut sum, mut n) = ([0.0f32; 3], 0.0);
        for (dx, dy) in [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)] {
            let ray = DVec3::new((x + dx - camera.cx) / camera.fx, (y + dy - camera.cy) / camera.fy, 1.0);
            let Some((u, v)) = self.keyframe.camera.project(ray) else { continue };
            let Some(color) = bilinear(picture, u, v) else { continue };
            sum = std::array::from_fn(|c| sum[c] + color[c]);
            n += 1.0;
        }
        (n > 0.0).then(|| sum.map(|c| c / n))
    }
}

fn bilinear(picture: &RgbImage, u: f64, v: f64) -> Option<[f32; 3]> {
    let (w, h) = (picture.width as usize, picture.height as usize);
    if w == 0 || h == 0 || !(u > -0.5 && v > -0.5 && u < w as f64 - 0.5 && v < h as f64 - 0.5) {
        return None;
    }
    let (u, v) = (u.clamp(0.0, (w - 1) as f64), v.clamp(0.0, (h - 1) as f64));
    let (x, y) = (u as usize, v as usize);
    let (fx, fy) = ((u - x as f64) as f32, (v - y as f64) as f32);
    let at = |x: usize, y: usize, c: usize| f32::from(picture.data[3 * (y.min(h - 1) * w + x.min(w - 1)) + c]) / 255.0;
    Some(std::array::from_fn(|c| {
        let top = at(x, y, c) * (1.0 - fx) + at(x + 1, y, c) * fx;
        let bottom = at(x, y + 1, c) * (1.0 - fx) + at(x + 1, y + 1, c) * fx;
        top * (1.0 - fy) + bottom * fy
    }))
}

/// A near plane that follows the size of the scene.
fn near(corners: &[DVec3]) -> f64 {
    let farthest = corners.iter().map(|p| p.z).filter(|z| z.is_finite()).fold(0.0, f64::max);
    (farthest * NEAR_SHARE).max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::tiny;

    #[test]
    fn paint_shows_the_triangle_where_the_camera_sees_it() {
        let result = tiny();
        let view = KeyframeView::new(&result, &result.keyframes[0], 64);
        let panel = view.paint(&[Vec3::ONE; 3], |v| v.to_array());
        assert_eq!((panel.width, panel.height), (64, 48));
        // The triangle spans ±10 px about the principal point.
        let covered = |x: usize, y: usize| panel.pixels[y * 64 + x].1;
        assert_eq!((covered(32, 20), covered(5, 20), covered(32, 45)), (1.0, 0.0, 0.0));
        let area: f32 = panel.pixels.iter().map(|p| p.1).sum();
        assert!((area - 195.0).abs() < 12.0, "{area}");
    }
}
