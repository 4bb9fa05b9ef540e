//! Lamps beside the scene (N2): spheres of radiance L, radius r and centre c; their power is P = L r².

use crate::light_model::visibility::{sees, visible_share};
use crate::numerics::random::{hash, unit};
use crate::rays::RayScene;
use glam::Vec3;
use rayon::prelude::*;
use recordings::types::Mesh;

/// Golden angle, radians.
const GOLDEN_ANGLE: f32 = 2.399_963;

/// A sphere that shines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// Centre, world.
    pub center: Vec3,
    /// Radius, in the mesh's units.
    pub radius: f32,
}

/// g of (N2) at a vertex: V max(0, n·d^) / |d|², the visibility V averaged over the sphere's disc. The power is its coefficient.
#[must_use]
pub fn form_factor(mesh: &Mesh, scene: &RayScene, vertex: usize, sphere: &Sphere) -> f32 {
    let (position, normal) = (mesh.positions[vertex], mesh.normals[vertex]);
    let toward = sphere.center - position;
    let direction = toward.normalize_or_zero();
    let cosine = direction.dot(normal);
    if cosine.is_nan() || cosine <= 0.0 {
        return 0.0;
    }
    let origin = scene.offset_origin(position, normal);
    let visible = if sphere.radius > 0.0 {
        let (x, y) = direction.any_orthonormal_pair();
        let turn = std::f32::consts::TAU * unit(hash(vertex as u32, 0x1a3b));
        visible_share(|ray, of| {
            let radius = sphere.radius * ((ray as f32 + 0.5) / of as f32).sqrt();
            let (sin, cos) = libm::sincosf(GOLDEN_ANGLE * ray as f32 + turn);
            sees(scene, origin, sphere.center + (x * cos + y * sin) * radius)
        })
    } else {
        f32::from(sees(scene, origin, sphere.center))
    };
    cosine * visible / toward.length_squared().max(sphere.radius * sphere.radius)
}

/// The same at many vertices.
#[must_use]
pub fn form_factors(mesh: &Mesh, scene: &RayScene, vertices: &[u32], sphere: &Sphere) -> Vec<f32> {
    vertices.par_iter().map(|&i| form_factor(mesh, scene, i as usize, sphere)).collect()
}
