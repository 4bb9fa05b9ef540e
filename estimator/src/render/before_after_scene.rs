//! The scene before and after a change: kept, removed and inserted surfaces, and the light around them.

use crate::numerics::random::hash;
use crate::rays::{Hit, RayScene};
use crate::render::bounding_sphere::BoundingSphere;
use crate::render::lighting::environment::Environment;
use crate::render::lighting::local_sources::LocalSources;
use crate::render::objects::material::Brdf;
use crate::render::objects::object::{Object, interpolate};
use crate::render::sampling::{Cone, cosine, cosine_density, ggx_normal, point, smith};
use glam::Vec3;
use std::f32::consts::PI;

/// Maximum number of mirror reflections along a ray.
const MAX_REFLECTIONS: u32 = 4;
/// GGX width below which rays of a lobe find lamps by themselves.
const NARROW: f32 = 0.05;

/// Before the change or after it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// As scanned.
    Before,
    /// With objects removed and inserted.
    After,
}

/// A surface, its hierarchy, and the diffuse light that leaves its vertices.
#[derive(Debug)]
pub struct Body {
    /// Surface and look.
    pub object: Object,
    /// Its ray-tracing hierarchy.
    pub bvh: RayScene,
    /// Diffuse radiance `[vertex]` before the change (of inserted objects: after it).
    pub radiance: Vec<Vec3>,
    /// Diffuse radiance per vertex after the change.
    pub after: Vec<Vec3>,
}

/// A point on a body, seen from one side.
#[derive(Debug, Clone, Copy)]
pub struct SurfacePoint {
    /// Position, lifted off the surface so that rays leave it.
    pub origin: Vec3,
    /// Unit shading normal, towards the side it was seen from.
    pub normal: Vec3,
}

impl Body {
    /// A body whose vertices give off `radiance`.
    #[must_use]
    pub fn new(object: Object, radiance: Vec<Vec3>) -> Self {
        let bvh = RayScene::new(&object.mesh);
        Self { bvh, after: radiance.clone(), radiance, object }
    }

    /// The point that a ray along `direction` from `origin` hits.
    #[must_use]
    pub fn surface_point(&self, origin: Vec3, direction: Vec3, hit: &Hit) -> SurfacePoint {
        let t = self.object.mesh.triangles[hit.triangle as usize];
        let corner = t.map(|i| self.object.mesh.positions[i as usize]);
        let flat = (corner[1] - corner[0]).cross(corner[2] - corner[0]).normalize_or(Vec3::Z);
        let towards = |n: Vec3| if n.dot(direction) > 0.0 { -n } else { n };
        let flat = towards(flat);
        let smooth = interpolate(&self.object.mesh.normals, t, hit).normalize_or(flat);
        let smooth = if smooth.dot(flat) < 0.0 { -smooth } else { smooth };
        SurfacePoint { origin: self.bvh.offset_origin(origin + direction * hit.distance, flat), normal: smooth }
    }

    /// The point at a vertex, on the side of its normal.
    #[must_use]
    pub fn vertex_point(&self, vertex: usize) -> SurfacePoint {
        let normal = self.object.mesh.normals[vertex];
        SurfacePoint { origin: self.bvh.offset_origin(self.object.mesh.positions[vertex], normal), normal }
    }
}

/// Which body a ray meets first.
#[derive(Debug, Clone, Copy)]
pub enum RayTarget<'a> {
    /// A body.
    Body(&'a Body, Hit, Part),
    /// Nothing: the light beyond the scene.
    Beyond,
}

/// Part of the scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// There before and after.
    Kept,
    /// Only there before.
    Removed,
    /// Only there after.
    Inserted,
}

/// The scene before and after.
#[derive(Debug)]
pub struct BeforeAfterScene {
    /// Surface that stays.
    pub kept: Body,
    /// Surface that is removed.
    pub removed: Option<Body>,
    /// Surface that is inserted.
    pub inserted: Option<Body>,
    /// Bounding spheres of removed and inserted objects.
    pub changes: Vec<BoundingSphere>,
    /// Light from far away.
    pub environment: Environment,
    /// Light from lamps and emitting surfaces, which are part of what stays.
    pub local: LocalSources,
}

impl BeforeAfterScene {
    /// The surface of this part, removed or inserted, that a ray meets, whatever stands before it.
    pub(super) fn changing(&self, part: Part, origin: Vec3, direction: Vec3) -> Option<(&Body, Hit)> {
        let body = match part {
            Part::Removed => self.removed.as_ref()?,
            _ => self.inserted.as_ref()?,
        };
        if !self.changes.iter().any(|b| b.is_met(origin, direction)) {
            return None;
        }
        Some((body, body.bvh.closest_hit(origin, direction)?))
    }

    /// What a ray meets first on one side of the change.
    #[must_use]
    pub fn meet(&self, origin: Vec3, direction: Vec3, side: Side) -> RayTarget<'_> {
        let part = if side == Side::Before { Part::Removed } else { Part::Inserted };
        let kept = self.kept.bvh.closest_hit(origin, direction);
        match (kept, self.changing(part, origin, direction)) {
            (Some(k), Some((_, h))) if k.distance <= h.distance => RayTarget::Body(&self.kept, k, Part::Kept),
            (_, Some((body, h))) => RayTarget::Body(body, h, part),
            (Some(k), None) => RayTarget::Body(&self.kept, k, Part::Kept),
            (None, None) => RayTarget::Beyond,
        }
    }

    /// Radiance that a ray brings back. Reconstructed surfaces give off their diffuse light, inserted ones also reflect.
    #[must_use]
    pub fn radiance(&self, origin: Vec3, direction: Vec3, side: Side, depth: u32, seed: u32) -> Vec3 {
        match self.meet(origin, direction, side) {
            RayTarget::Beyond => self.environment.radiance(direction),
            RayTarget::Body(body, hit, part) => self.leaving(body, &hit, part, origin, direction, side, depth, seed),
        }
    }

    /// Radiance that leaves a hit towards where the ray came from.
    #[allow(clippy::too_many_arguments)]
    fn leaving(
        &self,
        body: &Body,
        hit: &Hit,
        part: Part,
        origin: Vec3,
        direction: Vec3,
        side: Side,
        depth: u32,
        seed: u32,
    ) -> Vec3 {
        let t = body.object.mesh.triangles[hit.triangle as usize];
        let values = if side == Side::After { &body.after } else { &body.radiance };
        let mut sum = interpolate(values, t, hit);
        if part == Part::Inserted && depth < MAX_REFLECTIONS {
            let brdf = body.object.brdf(hit);
            if !brdf.is_diffuse() {
                let spot = body.surface_point(origin, direction, hit);
                sum += self.reflected(&spot, &brdf, direction, side, depth + 1, hash(seed, depth), 1, 0);
            }
        }
        sum
    }

    /// Radiance that the glossy lobe of a surface sends back along a ray: GGX normals, Smith's masking.
    #[allow(clippy::too_many_arguments)]
    #[must_use]
    pub fn reflected(
        &self,
        spot: &SurfacePoint,
        brdf: &Brdf,
        direction: Vec3,
        side: Side,
        depth: u32,
        seed: u32,
        samples: u32,
        first: u32,
    ) -> Vec3 {
        let samples = if brdf.alpha < 1e-3 { 1 } else { samples };
        let view = -direction;
        // A wide lobe would meet small sources by chance only.
        let aimed = brdf.alpha >= NARROW;
        let mut sum = if aimed {
            self.local_reflection(spot, brdf, view, side, first..first + samples, seed) * samples as f32
        } else {
            Vec3::ZERO
        };
        for i in 0..samples {
            let (normal, weight) = if brdf.alpha < 1e-3 {
                (spot.normal, 1.0)
            } else {
                let m = ggx_normal(spot.normal, brdf.alpha, point(first + i, seed));
                let out = m * (2.0 * view.dot(m)) - view;
                let (nv, no, nm, vm) =
                    (spot.normal.dot(view).max(1e-3), spot.normal.dot(out), spot.normal.dot(m), view.dot(m));
                if no <= 0.0 || vm <= 0.0 {
                    continue;
                }
                (m, smith(nv, brdf.alpha) * smith(no, brdf.alpha) * vm / (nv * nm.max(1e-3)))
            };
            let out = normal * (2.0 * view.dot(normal)) - view;
            if out.dot(spot.normal) <= 0.0 {
                continue;
            }
            let f = brdf.reflectance(view.dot(normal).abs());
            let out = out.normalize();
            // Only what the camera sees itself shows sources: light that mirrors throw on surfaces is left out.
            let source = if aimed || depth > 0 { None } else { self.source_along(spot.origin, out, side) };
            let arriving = source.unwrap_or_else(|| self.radiance(spot.origin, out, side, depth, seed ^ i));
            sum += f * arriving * weight;
        }
        sum / samples as f32
    }

    /// Irradiance over π at a spot. `first` goes on with a sequence that was begun.
    #[must_use]
    pub fn gather(&self, spot: &SurfacePoint, side: Side, samples: u32, first: u32, seed: u32) -> Vec3 {
        self.gather_rays(spot, side, samples, first, seed) + self.local_irradiance(spot, side, samples, first, seed)
    }

    /// The same without what arrives straight from lamps and emitting surfaces: `samples` directions, half drawn by the
    /// cosine and half by the light from far away (the balance heuristic of Veach).
    #[must_use]
    pub fn gather_rays(&self, spot: &SurfacePoint, side: Side, samples: u32, first: u32, seed: u32) -> Vec3 {
        let mut sum = Vec3::ZERO;
        for i in first..first + samples {
            let u = point(i / 2, seed ^ (i & 1));
            let d = if i & 1 == 0 { cosine(spot.normal, u) } else { self.environment.sample(u) };
            let cos = d.dot(spot.normal);
            if cos <= 0.0 {
                continue;
            }
            let density = 0.5 * (cosine_density(cos) + self.environment.density(d));
            sum += self.radiance(spot.origin, d, side, 0, hash(seed, i)) * (cos / (PI * density));
        }
        sum / samples as f32
    }

    /// By how much irradiance over π changes at a spot: only directions towards what changed are drawn, and the same
    /// ray is followed on both sides, so that what does not change gives exactly 0.
    #[must_use]
    pub fn change(&self, spot: &SurfacePoint, samples: u32, seed: u32) -> Vec3 {
        let cones: Vec<Option<Cone>> =
            self.changes.iter().map(|b| Cone::towards(spot.origin, b.center, b.radius)).collect();
        // Every other ray follows the light: lamps behind the change are small.
        let share = 0.5 / cones.len().max(1) as f32;
        let mut sum = Vec3::ZERO;
        for i in 0..samples {
            let u = point(i / 2, seed ^ (i & 1));
            let d = match cones.get((i / 2) as usize % cones.len().max(1)) {
                _ if i & 1 == 1 => self.environment.sample(u),
                Some(Some(cone)) => cone.sample(u),
                _ => cosine(spot.normal, u),
            };
            let cos = d.dot(spot.normal);
            if cos <= 0.0 {
                continue;
            }
            let before = self.changing(Part::Removed, spot.origin, d);
            let after = self.changing(Part::Inserted, spot.origin, d);
            if before.is_none() && after.is_none() {
                continue;
            }
            let kept = self.kept.bvh.closest_hit(spot.origin, d);
            let nearest = |h: Option<(&Body, Hit)>| {
                h.filter(|(_, h)| kept.is_none_or(|k| h.distance < k.distance)).map(|(_, h)| h)
            };
            let (before, after) = (nearest(before), nearest(after));
            if before.is_none() && after.is_none() {
                continue;
            }
            let seed = hash(seed, i);
            let arriving = |side: Side, hit: Option<Hit>| match (hit, kept, side) {
                (Some(h), _, Side::Before) => {
                    self.removed.as_ref().map(|b| self.leaving(b, &h, Part::Removed, spot.origin, d, side, 0, seed))
                }
                (Some(h), _, Side::After) => {
                    self.inserted.as_ref().map(|b| self.leaving(b, &h, Part::Inserted, spot.origin, d, side, 0, seed))
                }
                (None, Some(k), _) => Some(self.leaving(&self.kept, &k, Part::Kept, spot.origin, d, side, 0, seed)),
                (None, None, _) => Some(self.environment.radiance(d)),
            };
            let difference =
                arriving(Side::After, after).unwrap_or_default() - arriving(Side::Before, before).unwrap_or_default();
            let mut density = 0.5 * self.environment.density(d);
            for cone in &cones {
                density += share * cone.as_ref().map_or_else(|| cosine_density(cos), |c| c.density(d));
            }
            sum += difference * (cos / (PI * density));
        }
        sum / samples as f32 + self.local_change(spot, samples, seed)
    }

    /// An upper bound of the share of irradiance that the change can touch at a spot, under even light.
    #[must_use]
    pub fn reach(&self, spot: &SurfacePoint) -> f32 {
        let one = |b: &BoundingSphere| {
            Cone::towards(spot.origin, b.center, b.radius)
                .map_or(1.0, |c| c.solid_angle() * c.highest_cosine(spot.normal) / PI)
        };
        self.changes.iter().map(one).sum()
    }
}
