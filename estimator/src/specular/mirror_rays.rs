//! Mirror directions of the observations, and what they hit.

use crate::association::Association;
use crate::rays::{Hit, RayScene};
use glam::{DVec3, Vec3};
use recordings::types::Mesh;
use std::sync::OnceLock;

/// A mirror direction and what it hits.
#[derive(Debug, Clone, Copy)]
pub(super) struct MirrorRay {
    /// Unit vector.
    pub direction: Vec3,
    /// `None` if it is free.
    pub hit: Option<Hit>,
}

/// The mirror direction at a surface point seen along the unit vector `to_camera`, and what it hits; `None` if the surface
/// is seen from behind.
pub(super) fn mirror_ray(scene: &RayScene, position: Vec3, normal: Vec3, to_camera: Vec3) -> Option<MirrorRay> {
    let cosine = normal.dot(to_camera);
    if cosine <= 0.0 || !cosine.is_finite() {
        return None;
    }
    let direction = (normal * (2.0 * cosine) - to_camera).normalize_or_zero();
    let hit = scene.closest_hit(scene.offset_origin(position, normal), direction);
    (direction != Vec3::ZERO).then_some(MirrorRay { direction, hit })
}

/// Mirror rays of every observation, traced when a vertex is first asked for: neither surface nor poses change while gloss is
/// fitted again and again.
pub(super) struct MirrorRays<'a> {
    mesh: &'a Mesh,
    scene: &'a RayScene,
    /// `[vertex][observation]`.
    rays: Vec<OnceLock<Box<[Option<MirrorRay>]>>>,
}

impl<'a> MirrorRays<'a> {
    /// Nothing is traced yet.
    pub fn new(mesh: &'a Mesh, scene: &'a RayScene) -> Self {
        Self { mesh, scene, rays: mesh.positions.iter().map(|_| OnceLock::new()).collect() }
    }

    /// Rays of the observations of a vertex, in their order.
    pub fn of(&self, association: &Association, vertex: usize) -> &[Option<MirrorRay>] {
        self.rays[vertex].get_or_init(|| {
            let (position, normal) = (self.mesh.positions[vertex], self.mesh.normals[vertex]);
            let range = association.offsets[vertex] as usize..association.offsets[vertex + 1] as usize;
            let ray = |keyframe: u16| {
                let camera = association.views[keyframe as usize].world_from_camera.translation;
                let to_camera = (camera - position.as_dvec3()).normalize_or(DVec3::Z).as_vec3();
                mirror_ray(self.scene, position, normal, to_camera)
            };
            association.observations[range].iter().map(|o| ray(o.keyframe)).collect()
        })
    }
}
