//! Light on the vertices that the preview shows, as the result describes it.

use crate::numerics::rotation::{product, rotate};
use crate::numerics::sh;
use crate::rays::RayScene;
use crate::render::lighting::local_sources::LocalSources;
use glam::{Quat, Vec3};
use rayon::prelude::*;
use recordings::decision::TransferLevel;
use recordings::local_light::LightModel;
use recordings::result::Estimate;

/// Rays per vertex.
const RAYS: usize = 64;
/// Rays per vertex to each lamp.
const SOURCE_RAYS: u32 = 16;
/// No colour is divided by less: the quotient stays finite, and times an albedo of nothing it is nothing.
const LEAST_ALBEDO: f32 = 1e-6;

/// Light on vertices, the same for every view of them.
pub struct VertexLight<'a> {
    result: &'a Estimate,
    scene: &'a RayScene,
    sources: LocalSources,
    /// Irradiance over π at the transfer level of the result, lamps and emitting surfaces included; 0 where it is not asked for:
    /// `[vertex]`.
    irradiance: Vec<Vec3>,
}

impl<'a> VertexLight<'a> {
    /// Gathers it for the vertices that are `seen`: `[vertex]`. Interreflected light is taken from the lit colours.
    pub fn new(result: &'a Estimate, scene: &'a RayScene, seen: &[bool]) -> Self {
        let sources = LocalSources::new(&result.local_light, &result.mesh);
        let mut light = Self { result, scene, sources, irradiance: Vec::new() };
        let directions = cosine_directions(RAYS);
        let gathered = |(i, seen): (usize, &bool)| if *seen { light.gathered(i, &directions) } else { Vec3::ZERO };
        light.irradiance = seen.par_iter().enumerate().map(gathered).collect();
        light
    }

    /// Radiance of a vertex towards `eye`: Eqs. (9) and (13).
    pub fn radiance(&self, i: usize, eye: Vec3) -> Vec3 {
        let (r, scene) = (self.result, self.scene);
        let diffuse = r.albedo[i] * self.irradiance[i] + self.sources.emission(i as u32);
        let Some(segment) = r.segments.get(r.segment[i] as usize).filter(|s| s.w_s > 0.0) else { return diffuse };
        let (position, normal) = (r.mesh.positions[i], r.mesh.normals[i]);
        let o = (eye - position).normalize_or_zero();
        let mirrored = 2.0 * normal.dot(o) * normal - o;
        if scene.occluded(scene.offset_origin(position, normal), mirrored) {
            return diffuse;
        }
        diffuse * segment.w_d as f32 + self.distant(mirrored) * segment.w_s as f32
    }

    fn gathered(&self, i: usize, directions: &[Vec3]) -> Vec3 {
        let Self { result: r, scene, sources, .. } = self;
        // No light in the result explains these colours: what arrives is what the albedo was found with.
        if r.local_light.model == LightModel::Unexplained {
            return r.lit_color[i] / r.albedo[i].max(Vec3::splat(LEAST_ALBEDO));
        }
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
                None => self.distant(d),
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
        irradiance / directions.len() as f32 + near
    }

    fn distant(&self, direction: Vec3) -> Vec3 {
        let l = sh::radiance(&self.result.light.coefficients, direction.as_dvec3());
        Vec3::from_array(l.map(|c| c as f32)).max(Vec3::ZERO)
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::tiny;

    #[test]
    fn radiance_is_albedo_times_irradiance() {
        // Constant light of coefficient c is radiance 0.282095 c from everywhere; nothing blocks it.
        let result = tiny();
        let scene = RayScene::new(&result.mesh);
        let light = VertexLight::new(&result, &scene, &[true, false, false]);
        let expected = result.albedo[0] * Vec3::new(1.0, 2.0, 3.0) * 0.282_095;
        let eye = Vec3::new(0.0, 0.0, 1.0);
        assert!((light.radiance(0, eye) - expected).length() < 1e-4, "{} {expected}", light.radiance(0, eye));
        assert_eq!(light.radiance(1, eye), Vec3::ZERO, "not asked for");
    }

    #[test]
    fn colors_that_no_light_explains_are_shown_as_they_were() {
        let mut result = tiny();
        result.local_light.model = LightModel::Unexplained;
        result.segments.iter_mut().for_each(|s| s.w_s = 0.0);
        let scene = RayScene::new(&result.mesh);
        (result.albedo[2], result.lit_color[2]) = (Vec3::ZERO, Vec3::splat(100.0));
        let light = VertexLight::new(&result, &scene, &[true; 3]);
        let eye = Vec3::new(0.0, 0.0, 1.0);
        let off = light.radiance(1, eye) - result.lit_color[1];
        assert!(off.length() < 1e-5, "{off}");
        assert_eq!(light.radiance(2, eye), Vec3::ZERO, "an albedo of nothing");
    }

    #[test]
    fn cosine_directions_have_the_mean_of_a_cosine() {
        let mean: Vec3 = cosine_directions(4096).iter().sum::<Vec3>() / 4096.0;
        assert!((mean - Vec3::new(0.0, 0.0, 2.0 / 3.0)).length() < 1e-3, "{mean}");
    }
}
