//! The mesh seen from a keyframe, coloured by anything that vertices have.

use crate::mesh::raster::{MISS, Raster, camera_positions, scaled};
use crate::numerics::rotation::{product, rotate};
use crate::numerics::sh;
use crate::rays::RayScene;
use crate::render::lighting::local_sources::LocalSources;
use crate::texture::detail::Detail;
use glam::{DVec3, Quat, Vec3};
use rayon::prelude::*;
use recordings::decision::TransferLevel;
use recordings::result::{Estimate, ResultKeyframe};
use recordings::types::{Intrinsics, RgbImage};

/// Samples along each side of a pixel.
const SUPERSAMPLING: u32 = 2;
/// Rays per vertex for the picture of albedo × light.
const RAYS: usize = 128;
/// Rays per vertex to each lamp.
const SOURCE_RAYS: u32 = 16;
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

/// What lights a vertex.
struct Around {
    scene: RayScene,
    sources: LocalSources,
    directions: Vec<Vec3>,
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

    /// Radiance towards the camera of every vertex in view by Eqs. (9) and (13): albedo × irradiance at the transfer
    /// level of the result, plus gloss, lamps and emitting surfaces. Interreflected light is gathered from the lit colours.
    /// Black out of view.
    pub fn model(&self) -> Vec<Vec3> {
        let mut seen = vec![false; self.result.mesh.positions.len()];
        for t in self.raster.triangle.iter().filter(|t| **t != MISS) {
            self.result.mesh.triangles[*t as usize].iter().for_each(|c| seen[*c as usize] = true);
        }
        let around = Around {
            scene: RayScene::new(&self.result.mesh),
            sources: LocalSources::new(&self.result.local_light, &self.result.mesh),
            directions: cosine_directions(RAYS),
        };
        let eye = self.keyframe.world_from_camera.translation.as_vec3();
        let radiance = |i: usize| self.vertex_radiance(i, eye, &around);
        (0..seen.len()).into_par_iter().map(|i| if seen[i] { radiance(i) } else { Vec3::ZERO }).collect()
    }

    fn vertex_radiance(&self, i: usize, eye: Vec3, around: &Around) -> Vec3 {
        let (r, Around { scene, sources, directions }) = (self.result, around);
        let (position, normal) = (r.mesh.positions[i], r.mesh.normals[i]);
        let origin = scene.offset_origin(position, normal);
        // A turn of its own for every vertex trades bands of error for grain.
        let turn = Quat::from_rotation_z(i as f32 * 2.399_963);
        let to_world = product(Quat::from_rotation_arc(Vec3::Z, normal), turn);
        let mut irradiance = Vec3::ZERO;
        for d in directions {
            let d = rotate(to_world, *d);
            let hit = if r.transfer == TransferLevel::Diffuse { None } else { scene.closest_hit(origin, d) };
            irradiance += match hit {
                None => self.light(d),
                Some(hit) if r.transfer == TransferLevel::Gi => {
                    // Emitting surfaces are aimed at below.
                    let color =
                        |k| if sources.emission(k) == Vec3::ZERO { r.lit_color[k as usize] } else { Vec3::ZERO };
                    let [a, b, c] = r.mesh.triangles[hit.triangle as usize].map(color);
                    a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v
                }
                Some(_) => Vec3::ZERO,
            };
        }
        let near = sources.irradiance_in(scene, (origin, normal), 0..SOURCE_RAYS, i as u32);
        let diffuse = r.albedo[i] * (irradiance / directions.len() as f32 + near) + sources.emission(i as u32);
        let Some(segment) = r.segments.get(r.segment[i] as usize) else { return diffuse };
        let mut radiance = diffuse;
        if segment.w_s > 0.0 {
            let o = (eye - position).normalize_or_zero();
            let mirrored = 2.0 * normal.dot(o) * normal - o;
            if !scene.occluded(origin, mirrored) {
                // Eq. (13)
                radiance = diffuse * segment.w_d as f32 + self.light(mirrored) * segment.w_s as f32;
            }
        }
        radiance
    }

    fn light(&self, direction: Vec3) -> Vec3 {
        let l = sh::radiance(&self.result.light.coefficients, direction.as_dvec3());
        Vec3::from_array(l.map(|c| c as f32)).max(Vec3::ZERO)
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

/// Cosine-distributed directions about +Z: a sunflower on the disk, lifted.
fn cosine_directions(n: usize) -> Vec<Vec3> {
    const GOLDEN_ANGLE: f32 = 2.399_963;
    (0..n)
        .map(|i| {
            let r2 = (i as f32 + 0.5) / n as f32;
            let (sin, cos) = libm::sincosf(i as f32 * GOLDEN_ANGLE);
            let r = r2.sqrt();
            Vec3::new(r * cos, r * sin, (1.0 - r2).sqrt())
        })
        .collect()
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

    #[test]
    fn model_is_albedo_times_irradiance() {
        // Constant light of coefficient c is radiance 0.282095 c from everywhere; nothing blocks it.
        let result = tiny();
        let model = KeyframeView::new(&result, &result.keyframes[0], 64).model();
        let expected = result.albedo[0] * Vec3::new(1.0, 2.0, 3.0) * 0.282_095;
        assert!((model[0] - expected).length() < 1e-4, "{} {expected}", model[0]);
    }

    #[test]
    fn cosine_directions_have_the_mean_of_a_cosine() {
        let mean: Vec3 = cosine_directions(4096).iter().sum::<Vec3>() / 4096.0;
        assert!((mean - Vec3::new(0.0, 0.0, 2.0 / 3.0)).length() < 1e-3, "{mean}");
    }
}
