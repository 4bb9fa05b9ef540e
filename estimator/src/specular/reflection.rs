//! Light in the mirror direction: f_s of Eq. (13).

use crate::association::Association;
use crate::factorisation::Factorised;
use crate::numerics::sh;
use crate::rays::{Hit, RayScene};
use crate::specular::gloss::LOBES;
use crate::specular::mirror_rays::{MirrorRay, mirror_ray};
use glam::Vec3;
use recordings::types::Mesh;
use std::borrow::Cow;

/// Lobes times channels.
pub(super) const BLURRED: usize = 3 * LOBES.len();

/// What predicts reflected light.
#[derive(Clone)]
pub struct Reflection<'a> {
    /// Mesh with unit normals.
    pub mesh: &'a Mesh,
    /// The same for rays.
    pub scene: &'a RayScene,
    /// Coefficients of the light: `[k][channel]`.
    pub light: Cow<'a, [[f64; 3]]>,
    /// Irradiance over π, linear RGB: `[vertex]`.
    pub irradiance: &'a [Vec3],
}

impl<'a> Reflection<'a> {
    /// Reflection of the light found, in the bands that mirrors show.
    #[must_use]
    pub fn new(mesh: &'a Mesh, scene: &'a RayScene, found: &'a Factorised) -> Self {
        Self { mesh, scene, light: found.mirrored_light(), irradiance: &found.irradiance }
    }

    /// f_s of Eq. (13), linear RGB: light in the mirror direction; `None` if the scene blocks it.
    #[must_use]
    pub fn at(&self, position: Vec3, normal: Vec3, to_camera: Vec3) -> Option<[f64; 3]> {
        let MirrorRay { direction, hit } = mirror_ray(self.scene, position, normal, to_camera)?;
        hit.is_none().then(|| sh::radiance(&self.light, direction.as_dvec3()).map(|x| x.max(0.0)))
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

    /// The light blurred by each lobe, channels of a lobe in a row: `[k][lobe and channel]`.
    pub(super) fn blurred(&self) -> Vec<[f64; BLURRED]> {
        let window = |k: usize, lobe: usize| libm::exp(-LOBES[lobe] * sh::band(k) as f64);
        let coefficient = |(k, c): (usize, &[f64; 3])| std::array::from_fn(|i| c[i % 3] * window(k, i / 3));
        self.light.iter().enumerate().map(coefficient).collect()
    }
}
