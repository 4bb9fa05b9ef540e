//! Light in the mirror direction: f_s of Eq. (13).

use crate::association::Association;
use crate::factorisation::Factorised;
use crate::numerics::sh;
use crate::rays::{Hit, RayScene};
use crate::specular::gloss::LOBES;
use glam::Vec3;
use recordings::types::Mesh;

/// What predicts reflected light.
#[derive(Clone, Copy)]
pub struct Reflection<'a> {
    /// Mesh with unit normals.
    pub mesh: &'a Mesh,
    /// The same for rays.
    pub scene: &'a RayScene,
    /// Coefficients of the light: `[k][channel]`.
    pub light: &'a [[f64; 3]],
    /// Irradiance over π, linear RGB: `[vertex]`.
    pub irradiance: &'a [Vec3],
}

impl<'a> Reflection<'a> {
    /// Reflection of the light found, in the bands that mirrors show.
    #[must_use]
    pub fn new(mesh: &'a Mesh, scene: &'a RayScene, found: &'a Factorised) -> Self {
        let light = &found.solution.light;
        let light = &light[..light.len().min(sh::MIRRORED_BANDS * sh::MIRRORED_BANDS)];
        Self { mesh, scene, light, irradiance: &found.irradiance }
    }

    /// The mirror direction at a surface point seen along the unit vector `to_camera`, and what it hits; `None` if the surface
    /// is seen from behind.
    pub(super) fn mirror(&self, position: Vec3, normal: Vec3, to_camera: Vec3) -> Option<(Vec3, Option<Hit>)> {
        let cosine = normal.dot(to_camera);
        if cosine <= 0.0 || !cosine.is_finite() {
            return None;
        }
        let mirror = (normal * (2.0 * cosine) - to_camera).normalize_or_zero();
        let hit = self.scene.closest_hit(self.scene.offset_origin(position, normal), mirror);
        (mirror != Vec3::ZERO).then_some((mirror, hit))
    }

    /// f_s of Eq. (13), linear RGB: light in the mirror direction; `None` if the scene blocks it.
    #[must_use]
    pub fn at(&self, position: Vec3, normal: Vec3, to_camera: Vec3) -> Option<[f64; 3]> {
        match self.mirror(position, normal, to_camera)? {
            (mirror, None) => Some(sh::radiance(self.light, mirror.as_dvec3()).map(|x| x.max(0.0))),
            _ => None,
        }
    }

    /// Lit colour at the hit of a mirror direction; `None` where it was never seen from its lit side.
    pub(super) fn lit_at(&self, association: &Association, mirror: Vec3, hit: &Hit) -> Option<[f64; 3]> {
        let corners = self.mesh.triangles[hit.triangle as usize].map(|i| i as usize);
        let weights = [1.0 - hit.u - hit.v, hit.u, hit.v];
        let mix = |values: &[Vec3]| corners.iter().zip(weights).map(|(&i, w)| values[i] * w).sum::<Vec3>();
        let seen = corners.iter().all(|&i| association.lit_weight[i] > 0.0);
        (seen && mix(&self.mesh.normals).dot(mirror) < 0.0)
            .then(|| mix(&association.lit_color).to_array().map(f64::from))
    }

    /// The light blurred by each lobe: `[lobe][k][channel]`.
    pub(super) fn blurred(&self) -> [Vec<[f64; 3]>; LOBES.len()] {
        LOBES.map(|width| {
            let window = |k: usize| {
                let l = sh::band(k) as f64;
                libm::exp(-width * l)
            };
            self.light.iter().enumerate().map(|(k, c)| c.map(|x| x * window(k))).collect()
        })
    }
}
