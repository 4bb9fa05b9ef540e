//! Shape diameter (Shapira, Shamir and Cohen-Or 2008): the thickness of the object below a vertex.

use crate::mesh::graph::Graph;
use crate::numerics::random::unit;
use crate::rays::RayScene;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use recordings::types::Mesh;

/// Cosine of half the opening angle of the cone about the inward normal: 60°.
const CONE_COSINE: f32 = 0.5;

/// Shape diameter of every vertex in the mesh's units, `[vertex]`; `None` where fewer than a third of the `rays` meet the
/// surface from inside, because the scan has no back there.
///
/// Thickness varies slowly: rays are traced from a maximal set of vertices of which no two are neighbours; the others take the
/// mean of their neighbours in the set.
pub fn shape_diameter(mesh: &Mesh, graph: &Graph, scene: &RayScene, rays: usize, seed: u32) -> Vec<Option<f32>> {
    let mut covered = vec![false; graph.vertices()];
    let mut chosen = vec![false; graph.vertices()];
    for i in 0..graph.vertices() {
        if !covered[i] {
            chosen[i] = true;
            graph.neighbours(i).iter().for_each(|&j| covered[j as usize] = true);
        }
    }
    let traced: Vec<Option<f32>> = (0..graph.vertices())
        .into_par_iter()
        .map(|i| chosen[i].then(|| diameter(mesh, scene, i, rays, seed)).flatten())
        .collect();
    (0..graph.vertices())
        .map(|i| {
            if chosen[i] {
                return traced[i];
            }
            let known = graph.neighbours(i).iter().filter_map(|&j| traced[j as usize]);
            let (sum, count) = known.fold((0.0, 0.0), |(s, n), t| (s + t, n + 1.0));
            (count > 0.0).then(|| sum / count)
        })
        .collect()
}

fn diameter(mesh: &Mesh, scene: &RayScene, vertex: usize, rays: usize, seed: u32) -> Option<f32> {
    let inwards = -mesh.normals[vertex];
    if !(inwards.length_squared() > 0.5 && mesh.positions[vertex].is_finite()) {
        return None;
    }
    let (tangent, bitangent) = inwards.any_orthonormal_pair();
    let origin = scene.offset_origin(mesh.positions[vertex], inwards);
    let turn = unit(lowbias32(seed ^ lowbias32(vertex as u32)));
    let mut lengths = Vec::with_capacity(rays);
    for ray in 0..rays {
        // Golden-angle spiral over the cone, turned by a random angle per vertex.
        let cosine = 1.0 - (ray as f32 + 0.5) / rays as f32 * (1.0 - CONE_COSINE);
        let sine = (1.0 - cosine * cosine).sqrt();
        let angle = std::f32::consts::TAU * (0.618_034 * ray as f32 + turn);
        let around = Vec2::new(libm::cosf(angle), libm::sinf(angle)) * sine;
        let direction = inwards * cosine + tangent * around.x + bitangent * around.y;
        if let Some(hit) = scene.closest_hit(origin, direction) {
            let [a, b, c] = mesh.triangles[hit.triangle as usize].map(|k| mesh.normals[k as usize]);
            let normal: Vec3 = a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
            // From inside: the surface faces along the ray.
            if normal.dot(direction) > 0.0 {
                lengths.push(hit.distance);
            }
        }
    }
    if 3 * lengths.len() < rays {
        return None;
    }
    lengths.sort_unstable_by(f32::total_cmp);
    let median = lengths[lengths.len() / 2];
    let mean = lengths.iter().sum::<f32>() / lengths.len() as f32;
    let sigma = (lengths.iter().map(|l| (l - mean) * (l - mean)).sum::<f32>() / lengths.len() as f32).sqrt();
    let near: Vec<f32> = lengths.into_iter().filter(|l| (l - median).abs() <= sigma.max(1e-6 * median)).collect();
    Some(near.iter().sum::<f32>() / near.len() as f32)
}

/// Wellons' 32-bit hash. Not `numerics::random::hash`: other angles would move segment borders of existing results.
fn lowbias32(mut x: u32) -> u32 {
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}
