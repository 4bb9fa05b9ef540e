//! Light sources at finite distance, for next-event estimation: lamps (N2) and emitting pieces of the mesh (N4).

use crate::numerics::cielab::luminance;
use crate::numerics::random::hash;
use crate::rays::RayScene;
use crate::render::bounding_sphere::BoundingSphere;
use crate::render::sampling::{Cone, point};
use glam::Vec3;
use recordings::local_light::{Emitter, Lamp, LocalLight};
use recordings::types::Mesh;
use std::collections::BTreeSet;
use std::f32::consts::PI;
use std::ops::Range;

/// A lamp fills at most the cone of a sphere that is this share of its distance wide: points within it are lit as from there.
const WIDEST: f32 = 0.94;
/// Rays towards a source end this share before it, so that a surface does not hide itself.
const END: f32 = 0.999;

/// A lamp as rays meet it.
#[derive(Debug, Clone, Copy)]
struct Sphere {
    center: Vec3,
    radius: f32,
    radiance: Vec3,
}

/// An emitting triangle.
#[derive(Debug, Clone, Copy)]
struct Patch {
    corners: [Vec3; 3],
    normal: Vec3,
    area: f32,
    radiance: Vec3,
}

/// A direction towards a source.
#[derive(Debug, Clone, Copy)]
pub struct Drawn {
    /// Unit direction.
    pub direction: Vec3,
    /// Free distance that the source needs to be seen, in metres.
    pub distance: f32,
    /// Radiance over the density of the drawing per steradian.
    pub weight: Vec3,
}

/// An emitting piece of the mesh.
#[derive(Debug, Clone)]
struct Piece {
    patches: Vec<Patch>,
    /// Share of the power in patches up to and including each.
    cumulative_power: Vec<f32>,
    bounds: BoundingSphere,
}

/// Lamps and emitting pieces of the mesh: each is a source that rays are aimed at.
#[derive(Debug, Clone, Default)]
pub struct LocalSources {
    spheres: Vec<Sphere>,
    pieces: Vec<Piece>,
    /// Radiance that each vertex emits; empty if none does.
    emission: Vec<Vec3>,
}

impl LocalSources {
    /// The sources of a light on its mesh; what gives no light is left out.
    #[must_use]
    pub fn new(light: &LocalLight, mesh: &Mesh) -> Self {
        let spheres = light.lamps.iter().map(Sphere::new).filter(|s| s.radiance.max_element() > 0.0).collect();
        let pieces: Vec<Piece> = light.emitters.iter().filter_map(|e| Piece::new(e, mesh)).collect();
        let emission = if pieces.is_empty() { Vec::new() } else { light.emission(mesh.positions.len()) };
        Self { spheres, pieces, emission }
    }

    fn count(&self) -> usize {
        self.spheres.len() + self.pieces.len()
    }

    /// True if nothing gives light.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.count() == 0
    }

    /// True if parts of the mesh emit.
    #[must_use]
    pub fn has_emitters(&self) -> bool {
        !self.pieces.is_empty()
    }

    /// Radiance that a vertex emits.
    #[must_use]
    pub fn emission(&self, vertex: u32) -> Vec3 {
        self.emission.get(vertex as usize).copied().unwrap_or(Vec3::ZERO)
    }

    /// Spheres that hold all light of a source each.
    pub fn bounds(&self) -> impl Iterator<Item = BoundingSphere> {
        let lamps = self.spheres.iter().map(|s| BoundingSphere { center: s.center, radius: s.radius });
        lamps.chain(self.pieces.iter().map(|p| p.bounds))
    }

    /// The nearest lamp along a unit direction: its distance and radiance.
    #[must_use]
    pub fn lamp_along(&self, origin: Vec3, direction: Vec3) -> Option<(f32, Vec3)> {
        let met = self.spheres.iter().filter_map(|s| Some((s.distance(origin, direction)?, s.radiance)));
        met.min_by(|a, b| a.0.total_cmp(&b.0))
    }

    fn draw(&self, source: usize, from: Vec3, u: [f32; 2]) -> Option<Drawn> {
        match self.spheres.get(source) {
            Some(sphere) => sphere.draw(from, u),
            None => self.pieces[source - self.spheres.len()].draw(from, u),
        }
    }

    /// Σ over the sources of `value`, drawn with this `range` of rays each: integrals over the light that arrives at a point.
    #[must_use]
    pub fn integrate(&self, from: Vec3, rays: Range<u32>, seed: u32, value: impl Fn(&Drawn) -> Vec3) -> Vec3 {
        let count = rays.len().max(1) as f32;
        let mut sum = Vec3::ZERO;
        for source in 0..self.count() {
            let seed = hash(seed, source as u32 ^ 0x1a3b);
            for ray in rays.clone() {
                sum += self.draw(source, from, point(ray, seed)).map_or(Vec3::ZERO, |drawn| value(&drawn));
            }
        }
        sum / count
    }

    /// Irradiance over π at a surface: `visible` is the share of a drawn direction's light that counts.
    #[must_use]
    pub fn irradiance(
        &self,
        (from, normal): (Vec3, Vec3),
        rays: Range<u32>,
        seed: u32,
        visible: impl Fn(&Drawn) -> f32,
    ) -> Vec3 {
        self.integrate(from, rays, seed, |drawn| {
            let cos = drawn.direction.dot(normal);
            if cos > 0.0 { drawn.weight * (cos / PI * visible(drawn)) } else { Vec3::ZERO }
        })
    }
}

impl LocalSources {
    /// [`Self::irradiance`] where the surfaces of `scene` cast shadows.
    #[must_use]
    pub fn irradiance_in(&self, scene: &RayScene, at: (Vec3, Vec3), rays: Range<u32>, seed: u32) -> Vec3 {
        self.irradiance(at, rays, seed, |drawn| f32::from(u8::from(drawn.is_seen_from(at.0, scene))))
    }
}

impl Drawn {
    /// True if nothing of `scene` hides the source.
    #[must_use]
    pub fn is_seen_from(&self, origin: Vec3, scene: &RayScene) -> bool {
        !scene.occluded_within(origin, self.direction, self.distance)
    }
}

impl Sphere {
    fn new(lamp: &Lamp) -> Self {
        let radiance = Vec3::from_array(lamp.radiance.map(|x| x as f32));
        Self { center: Vec3::from_array(lamp.center), radius: lamp.radius_m, radiance }
    }

    /// Evenly over the cone that the sphere fills.
    fn draw(&self, from: Vec3, u: [f32; 2]) -> Option<Drawn> {
        let away = self.center.distance(from);
        let cone = Cone::towards(from, self.center, self.radius.min(WIDEST * away))?;
        let direction = cone.sample(u);
        let distance = self.distance(from, direction).unwrap_or(away - self.radius).max(0.0);
        Some(Drawn { direction, distance: distance * END, weight: self.radiance * cone.solid_angle() })
    }

    fn distance(&self, origin: Vec3, direction: Vec3) -> Option<f32> {
        let to = self.center - origin;
        let along = to.dot(direction);
        let inside = self.radius * self.radius - (to - direction * along).length_squared();
        let distance = along - inside.max(0.0).sqrt();
        (inside >= 0.0 && distance > 0.0).then_some(distance)
    }
}

impl Piece {
    /// `None` without light or area.
    fn new(emitter: &Emitter, mesh: &Mesh) -> Option<Self> {
        let emits: BTreeSet<u32> = emitter.vertices.iter().copied().collect();
        let radiance = Vec3::from_array(emitter.radiance.map(|x| x as f32));
        let patches: Vec<Patch> = mesh
            .triangles
            .iter()
            .filter_map(|t| {
                // A triangle at the rim emits as far as its corners do.
                let share = t.iter().filter(|i| emits.contains(*i)).count() as f32 / 3.0;
                let corners = t.map(|i| mesh.positions[i as usize]);
                let cross = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
                let area = 0.5 * cross.length();
                let sound = share > 0.0 && area > 0.0 && area.is_finite();
                sound.then(|| Patch { corners, normal: cross.normalize_or_zero(), area, radiance: radiance * share })
            })
            .collect();
        let power = |p: &Patch| p.area * luminance(p.radiance);
        let total: f32 = patches.iter().map(power).sum();
        let mut sum = 0.0;
        let cumulative_power = patches.iter().map(|p| {
            sum += power(p) / total;
            sum
        });
        let cumulative_power = cumulative_power.collect();
        let bounds = BoundingSphere::around(patches.iter().flat_map(|p| p.corners))?;
        (total > 0.0).then_some(Self { patches, cumulative_power, bounds })
    }

    /// By power, then evenly over the triangle.
    fn draw(&self, from: Vec3, u: [f32; 2]) -> Option<Drawn> {
        let k = self.cumulative_power.partition_point(|c| *c <= u[0]).min(self.patches.len() - 1);
        let before = if k > 0 { self.cumulative_power[k - 1] } else { 0.0 };
        let share = self.cumulative_power[k] - before;
        let root = ((u[0] - before) / share.max(f32::MIN_POSITIVE)).clamp(0.0, 1.0).sqrt();
        let Patch { corners: [a, b, c], normal, area, radiance } = self.patches[k];
        let to = a * (1.0 - root) + b * (root * (1.0 - u[1])) + c * (root * u[1]) - from;
        let distance = to.length();
        let direction = to / distance;
        let cos = -direction.dot(normal);
        // Nearer than a tenth of its size a patch counts as at that distance.
        let weight = radiance * (cos * area / (share * (distance * distance).max(0.01 * area)));
        // Written so that NaN fails too.
        let lit = cos > 0.0 && share > 0.0;
        lit.then_some(Drawn { direction, distance: distance * END, weight })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn light(radius_m: f32, distance: f32) -> LocalSources {
        let lamp = Lamp { center: [0.0, 0.0, distance], radius_m, radiance: [3.0, 2.0, 1.0] };
        LocalSources::new(&LocalLight { lamps: vec![lamp], ..LocalLight::default() }, &Mesh::default())
    }

    #[test]
    fn a_sphere_lights_as_the_square_of_its_radius_over_its_distance() {
        for (radius, distance) in [(0.1, 0.5), (0.001, 2.0), (0.4, 0.5)] {
            let e = light(radius, distance).irradiance((Vec3::ZERO, Vec3::Z), 0..4096, 1, |_| 1.0);
            let exact = Vec3::new(3.0, 2.0, 1.0) * (radius / distance).powi(2);
            assert!((e - exact).abs().max_element() < 0.01 * exact.x, "{e} {exact}");
        }
        // From within the sphere all of the hemisphere is nearly the lamp.
        assert!(light(0.5, 0.4).irradiance((Vec3::ZERO, Vec3::Z), 0..256, 1, |_| 1.0).x > 2.0);
    }

    #[test]
    fn a_square_lights_by_its_form_factor_and_from_its_front_alone() {
        // A square of side 2 in the plane z = 1, facing down: parallel to the surface under its middle.
        let corner = |x: f32, y: f32| Vec3::new(x, y, 1.0);
        let positions = vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
        let mesh = Mesh { positions, normals: vec![Vec3::NEG_Z; 4], triangles: vec![[0, 2, 1], [0, 3, 2]] };
        let emitters = vec![Emitter { vertices: vec![0, 1, 2, 3], radiance: [2.0, 1.0, 0.5] }];
        let sources = LocalSources::new(&LocalLight { emitters, ..LocalLight::default() }, &mesh);
        let below = sources.irradiance((Vec3::ZERO, Vec3::Z), 0..16_384, 1, |_| 1.0);
        // Four corners of 1 × 1 at distance 1: each (1/π) (1/√2) atan(1/√2).
        let factor = 4.0 / PI * 0.5f32.sqrt() * libm::atanf(0.5f32.sqrt());
        assert!((below.x - 2.0 * factor).abs() < 0.01 * factor, "{below} {factor}");
        let above = sources.irradiance((Vec3::Z * 2.0, Vec3::NEG_Z), 0..64, 1, |_| 1.0);
        assert_eq!(above, Vec3::ZERO);
    }

    #[test]
    fn a_lamp_is_met_where_it_is_and_one_that_is_off_is_not() {
        let sources = light(0.1, 0.5);
        let (distance, radiance) = sources.lamp_along(Vec3::ZERO, Vec3::Z).unwrap();
        assert!((distance - 0.4).abs() < 1e-6 && radiance.x == 3.0);
        assert!(sources.lamp_along(Vec3::ZERO, Vec3::X).is_none());
        assert!(sources.lamp_along(Vec3::Z, Vec3::Z).is_none());
        let off = Lamp { center: [0.0; 3], radius_m: 0.1, radiance: [0.0; 3] };
        let sources = LocalSources::new(&LocalLight { lamps: vec![off], ..LocalLight::default() }, &Mesh::default());
        assert_eq!(sources.count(), 0);
    }
}
