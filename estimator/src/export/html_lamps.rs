//! Lamps and emitting surfaces in the page: what each lamp brings to every vertex at its present place, shadows and bounces
//! included, so that its power is a factor. A lamp that is moved in the page lights without shadows.

use crate::numerics::random::hash;
use crate::rays::RayScene;
use crate::render::lighting::local_sources::LocalSources;
use crate::transfer::{Traced, bounce_light};
use glam::Vec3;
use rayon::prelude::*;
use recordings::local_light::{Lamp, LocalLight};
use recordings::result::Estimate;
use recordings::types::Mesh;

/// Lamps that can be changed one by one: a vertex attribute has four numbers. Further ones go with the emitting surfaces.
const LAMPS: usize = 4;
/// Rays per vertex to each source.
const RAYS: u32 = 32;

/// Four numbers per vertex as bytes that hold square roots: (byte / 255)² · scale.
#[derive(Default)]
pub struct Coded {
    /// `[vertex][4]`; empty where there is nothing to tell.
    pub bytes: Vec<[u8; 4]>,
    /// Value of 255 in each column.
    pub scale: [f32; 4],
}

impl Coded {
    fn new(rows: &[[f32; 4]]) -> Self {
        let most = |k: usize| rows.iter().map(|r| r[k]).fold(f32::MIN_POSITIVE, f32::max);
        let scale = [0, 1, 2, 3].map(most);
        let byte = |r: &[f32; 4], k: usize| ((r[k].max(0.0) / scale[k]).sqrt() * 255.0).round() as u8;
        let bytes = rows.iter().map(|r| [0, 1, 2, 3].map(|k| byte(r, k))).collect();
        Self { bytes, scale }
    }

    /// Bytes of these vertices; none where there is nothing to tell.
    pub fn at(&self, vertices: &[u32]) -> Vec<u8> {
        vertices.iter().filter_map(|&i| self.bytes.get(i as usize)).flatten().copied().collect()
    }

    fn colors(colors: &[Vec3]) -> Self {
        Self::new(&colors.iter().map(|c| c.extend(0.0).to_array()).collect::<Vec<_>>())
    }
}

/// Light of lamps and emitting surfaces.
pub struct NearLight {
    /// Lamps that can be changed.
    pub lamps: Vec<Lamp>,
    /// Irradiance over π of each of them at radiance 1.
    pub transfer: Coded,
    /// Irradiance over π of all other sources, RGB.
    pub others: Coded,
    /// Radiance that vertices emit, RGB.
    pub emission: Coded,
    /// Irradiance over π of all sources as scanned: `[vertex]`.
    pub irradiance: Vec<Vec3>,
}

impl NearLight {
    /// Of a result, by the hits of its rays.
    pub fn new(result: &Estimate, scene: &RayScene, traced: &Traced) -> Self {
        let all = &result.local_light;
        let (mine, rest) = all.lamps.split_at(all.lamps.len().min(LAMPS));
        let lit = |light: &LocalLight| {
            bounce_light(traced, &result.albedo, &direct(&LocalSources::new(light, &result.mesh), &result.mesh, scene))
        };
        let mut irradiance = vec![Vec3::ZERO; result.mesh.positions.len()];
        let (mut transfer, mut others, mut emission) = (Coded::default(), Coded::default(), Coded::default());
        if !mine.is_empty() {
            let mut rows = vec![[0.0f32; LAMPS]; irradiance.len()];
            for (l, lamp) in mine.iter().enumerate() {
                let unit = Lamp { radiance: [1.0; 3], ..*lamp };
                let radiance = Vec3::from_array(lamp.radiance.map(|x| x as f32));
                for (v, e) in lit(&LocalLight { lamps: vec![unit], ..LocalLight::default() }).into_iter().enumerate() {
                    rows[v][l] = e.element_sum() / 3.0;
                    irradiance[v] += e * radiance;
                }
            }
            transfer = Coded::new(&rows);
        }
        let fixed = LocalLight { lamps: rest.to_vec(), emitters: all.emitters.clone(), ..LocalLight::default() };
        if !fixed.lamps.is_empty() || !fixed.emitters.is_empty() {
            let of_fixed = lit(&fixed);
            irradiance.iter_mut().zip(&of_fixed).for_each(|(sum, e)| *sum += *e);
            others = Coded::colors(&of_fixed);
            emission = Coded::colors(&fixed.emission(irradiance.len()));
        }
        Self { lamps: mine.to_vec(), transfer, others, emission, irradiance }
    }
}

fn direct(sources: &LocalSources, mesh: &Mesh, scene: &RayScene) -> Vec<Vec3> {
    let at = |v: usize| {
        let (normal, origin) = (mesh.normals[v], scene.offset_origin(mesh.positions[v], mesh.normals[v]));
        sources.irradiance_in(scene, (origin, normal), 0..RAYS, hash(v as u32, 1))
    };
    (0..mesh.positions.len()).into_par_iter().map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::tiny;
    use crate::mesh::graph::Graph;
    use crate::transfer::Tracer;

    #[test]
    fn a_lamp_is_told_by_what_it_brings_to_each_vertex() {
        let mut result = tiny();
        // Above the triangle's first corner, whose normal is −Z.
        let lamp = Lamp { center: [-0.2, -0.2, -0.5], radius_m: 0.05, radiance: [8.0, 4.0, 2.0] };
        result.local_light.lamps = vec![lamp];
        let scene = RayScene::new(&result.mesh);
        let traced = Tracer { mesh: &result.mesh, graph: &Graph::of(&result.mesh), scene: &scene, bands: 1, seed: 1 }
            .trace(16, &|_| {});
        let near = NearLight::new(&result, &scene, &traced);
        let told = |v: usize| (f32::from(near.transfer.bytes[v][0]) / 255.0).powi(2) * near.transfer.scale[0];
        // (r / d)², but for the offset of a ray's origin, a share of this large triangle's edge.
        assert!((told(0) / 0.01 - 1.0).abs() < 0.1, "{}", told(0));
        assert!((0.4..0.6).contains(&(told(1) / told(0))), "{}", told(1) / told(0));
        assert!((near.irradiance[0].y / (4.0 * told(0)) - 1.0).abs() < 0.02);
        assert!(near.others.bytes.is_empty() && near.emission.bytes.is_empty());
    }
}
