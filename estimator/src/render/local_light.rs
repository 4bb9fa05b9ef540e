//! Lamps and emitting surfaces in a changed scene: what arrives from them, what a change hides of them, and how they shine
//! on glossy surfaces. Sources are aimed at (next-event estimation): rays by the cosine would meet them by chance.

use crate::render::before_after_scene::{BeforeAfterScene, Part, RayTarget, Side, SurfacePoint};
use crate::render::lighting::local_sources::Drawn;
use crate::render::objects::material::Brdf;
use crate::render::objects::object::interpolate;
use glam::Vec3;
use std::ops::Range;

/// Rays into all directions for one that is aimed at a source.
const RAYS_PER_AIMED: u32 = 4;

impl BeforeAfterScene {
    fn source_hidden(&self, origin: Vec3, drawn: &Drawn, side: Side) -> bool {
        let part = if side == Side::Before { Part::Removed } else { Part::Inserted };
        self.hides(part, origin, drawn) || !drawn.is_seen_from(origin, &self.kept.bvh)
    }

    fn hides(&self, part: Part, origin: Vec3, drawn: &Drawn) -> bool {
        self.changing(part, origin, drawn.direction).is_some_and(|(_, hit)| hit.distance < drawn.distance)
    }

    /// Irradiance over π at a spot straight from lamps and emitting surfaces, beside `samples` rays into all directions from
    /// the sequence's number `first` on.
    #[must_use]
    pub fn local_irradiance(&self, spot: &SurfacePoint, side: Side, samples: u32, first: u32, seed: u32) -> Vec3 {
        let rays = first.div_ceil(RAYS_PER_AIMED)..(first + samples).div_ceil(RAYS_PER_AIMED);
        self.local.irradiance((spot.origin, spot.normal), rays, seed, |drawn| {
            f32::from(u8::from(!self.source_hidden(spot.origin, drawn, side)))
        })
    }

    /// By how much that changes: shadows of what was inserted, light where something was removed.
    #[must_use]
    pub fn local_change(&self, spot: &SurfacePoint, rays: u32, seed: u32) -> Vec3 {
        if !self.reaches_sources(spot) {
            return Vec3::ZERO;
        }
        self.local.irradiance((spot.origin, spot.normal), 0..rays, seed, |drawn| {
            let [before, after] = [Part::Removed, Part::Inserted].map(|part| self.hides(part, spot.origin, drawn));
            if before == after || !drawn.is_seen_from(spot.origin, &self.kept.bvh) {
                return 0.0;
            }
            if after { -1.0 } else { 1.0 }
        })
    }

    /// True if something that changes may stand between a spot and a source.
    #[must_use]
    pub fn reaches_sources(&self, spot: &SurfacePoint) -> bool {
        self.local.bounds().any(|source| {
            let in_front = (source.center - spot.origin).dot(spot.normal) > -source.radius;
            in_front && self.changes.iter().any(|ball| ball.is_between(spot.origin, &source))
        })
    }

    /// What the glossy lobe of a surface reflects of the sources towards the unit direction `view`.
    #[must_use]
    pub fn local_reflection(
        &self,
        spot: &SurfacePoint,
        brdf: &Brdf,
        view: Vec3,
        side: Side,
        rays: Range<u32>,
        seed: u32,
    ) -> Vec3 {
        self.local.integrate(spot.origin, rays, seed ^ 0x6105, |drawn| {
            let lobe = brdf.lobe(spot.normal, view, drawn.direction);
            if lobe == Vec3::ZERO || self.source_hidden(spot.origin, drawn, side) {
                return Vec3::ZERO;
            }
            lobe * drawn.weight
        })
    }

    /// Radiance of a source that a ray meets before anything else.
    #[must_use]
    pub fn source_along(&self, origin: Vec3, direction: Vec3, side: Side) -> Option<Vec3> {
        let lamp = self.local.lamp_along(origin, direction);
        if lamp.is_none() && !self.local.has_emitters() {
            return None;
        }
        match self.meet(origin, direction, side) {
            RayTarget::Beyond => lamp.map(|(_, radiance)| radiance),
            RayTarget::Body(_, hit, _) if lamp.is_some_and(|(distance, _)| distance < hit.distance) => {
                lamp.map(|(_, radiance)| radiance)
            }
            RayTarget::Body(body, hit, Part::Kept) => {
                let t = body.object.mesh.triangles[hit.triangle as usize];
                let corners = t.map(|i| body.object.mesh.positions[i as usize]);
                let front = (corners[1] - corners[0]).cross(corners[2] - corners[0]).dot(direction) < 0.0;
                let emitted = interpolate(&t.map(|i| self.local.emission(i)), [0, 1, 2], &hit);
                (front && emitted != Vec3::ZERO).then_some(emitted)
            }
            RayTarget::Body(..) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::before_after_scene::Body;
    use crate::render::bounding_sphere::BoundingSphere;
    use crate::render::lighting::environment::Environment;
    use crate::render::lighting::local_sources::LocalSources;
    use crate::render::objects::object::Object;
    use recordings::local_light::{Lamp, LocalLight};
    use recordings::types::Mesh;

    /// A square of this half side at a height, facing up.
    fn square(half: f32, height: f32) -> Body {
        let corner = |x: f32, y: f32| Vec3::new(x * half, y * half, height);
        let mesh = Mesh {
            positions: vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)],
            normals: vec![Vec3::Z; 4],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        Body::new(Object { mesh, ..Object::default() }, vec![Vec3::ZERO; 4])
    }

    /// A floor under a lamp at a height of 1, and a small plate half way between.
    fn scene(radius_m: f32) -> BeforeAfterScene {
        let plate = square(0.05, 0.5);
        let lamp = Lamp { center: [0.0, 0.0, 1.0], radius_m, radiance: [2.0 / f64::from(radius_m).powi(2); 3] };
        let light = LocalLight { lamps: vec![lamp], ..LocalLight::default() };
        BeforeAfterScene {
            kept: square(2.0, 0.0),
            removed: None,
            changes: BoundingSphere::around(plate.object.mesh.positions.iter().copied()).into_iter().collect(),
            inserted: Some(plate),
            environment: Environment::from_fn(|_| Vec3::ZERO),
            local: LocalSources::new(&light, &Mesh::default()),
        }
    }

    #[test]
    fn a_plate_casts_the_shadow_of_a_lamp_where_it_falls() {
        let scene = scene(0.01);
        let at = |x: f32| SurfacePoint { origin: Vec3::new(x, 0.0, 1e-4), normal: Vec3::Z };
        let change = |x: f32| scene.local_change(&at(x), 64, 1).x;
        let before = |x: f32| scene.local_irradiance(&at(x), Side::Before, 256, 0, 1).x;
        assert!((before(0.0) - 2.0).abs() < 0.01, "{}", before(0.0));
        assert!((change(0.0) + before(0.0)).abs() < 0.01, "all of the lamp is hidden: {}", change(0.0));
        assert!(scene.local_irradiance(&at(0.0), Side::After, 256, 0, 1) == Vec3::ZERO);
        // The plate's rim at 0.05 throws its shadow to 0.1.
        assert!(change(0.09) < -1.9 && change(0.11) == 0.0, "{} {}", change(0.09), change(0.11));
    }

    #[test]
    fn a_large_lamp_casts_a_soft_shadow() {
        let scene = scene(0.1);
        let share = |x: f32| {
            let spot = SurfacePoint { origin: Vec3::new(x, 0.0, 1e-4), normal: Vec3::Z };
            -scene.local_change(&spot, 1024, 1).x / scene.local_irradiance(&spot, Side::Before, 4096, 0, 1).x
        };
        // Penumbra from 0 to 0.2: half of the lamp shows past the rim at 0.1.
        assert!((share(0.1) - 0.5).abs() < 0.06, "{}", share(0.1));
        assert!(share(0.15) > 0.02 && share(0.15) < 0.4, "{}", share(0.15));
    }

    #[test]
    fn a_mirror_shows_the_lamp_and_a_lobe_its_flux() {
        let mut scene = scene(0.1);
        scene.inserted = None;
        let spot = SurfacePoint { origin: Vec3::new(0.0, 0.0, 1e-4), normal: Vec3::Z };
        assert_eq!(scene.source_along(spot.origin, Vec3::Z, Side::After), Some(Vec3::splat(200.0)));
        assert_eq!(scene.source_along(spot.origin, Vec3::X, Side::After), None);
        // A rough lobe: reflectance · D G / 4 cos · flux, nearly all of it head-on.
        let brdf = Brdf { diffuse: Vec3::ZERO, f0: Vec3::splat(0.5), f90: 0.5, alpha: 0.5 };
        let found = scene.local_reflection(&spot, &brdf, Vec3::Z, Side::After, 0..256, 1).x;
        let flux = 200.0 * std::f32::consts::PI * 0.01;
        let expected = 0.5 / (std::f32::consts::PI * 0.25) / 4.0 * flux;
        assert!((found / expected - 1.0).abs() < 0.05, "{found} {expected}");
    }
}
