//! Light at finite distance: spheres beside the mesh, and parts of the mesh that emit.

use glam::Vec3;
use std::f32::consts::TAU;

/// A lamp that is not in the mesh: a sphere that emits evenly. It casts no shadow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// Centre, metres.
    pub center: Vec3,
    /// Radius, metres.
    pub radius_m: f32,
    /// Radiance, linear RGB.
    pub radiance: Vec3,
}

/// A triangle that emits from the front.
#[derive(Debug, Clone, Copy)]
struct Patch {
    corners: [Vec3; 3],
    /// Unit normal by the winding.
    normal: Vec3,
    area: f32,
    radiance: Vec3,
}

/// A direction towards a light.
#[derive(Debug, Clone, Copy)]
pub struct Drawn {
    /// Unit vector from the shaded point.
    pub direction: Vec3,
    /// Distance to the emitting surface, metres.
    pub distance: f32,
    /// Radiance that arrives if nothing stands between, over the density per steradian of the drawing.
    pub weight: Vec3,
}

/// All lights at finite distance. Spheres are drawn one by one, emitting parts together.
#[derive(Debug, Clone, Default)]
pub struct Emitters {
    /// Lamps beside the mesh.
    pub spheres: Vec<Sphere>,
    patches: Vec<Patch>,
    /// Cumulated share of the patches' power; last entry 1.
    cumulated: Vec<f32>,
}

/// Patches are sampled as if no nearer than this, metres.
const NEAREST_M: f32 = 0.01;

impl Emitters {
    /// `triangles`: corners and radiance of every emitting triangle.
    #[must_use]
    pub fn new(spheres: Vec<Sphere>, triangles: impl IntoIterator<Item = ([Vec3; 3], Vec3)>) -> Self {
        let patch = |(corners, radiance): ([Vec3; 3], Vec3)| {
            let cross = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            Patch { corners, normal: cross.normalize_or_zero(), area: 0.5 * cross.length(), radiance }
        };
        let patches: Vec<Patch> = triangles.into_iter().map(patch).collect();
        let power = |p: &Patch| p.area * p.radiance.element_sum();
        let total: f32 = patches.iter().map(power).sum();
        let mut below = 0.0;
        let cumulated = patches
            .iter()
            .map(|p| {
                below += power(p) / total;
                below
            })
            .collect();
        Self { spheres, patches, cumulated }
    }

    /// Number of lights for [`Emitters::draw`].
    #[must_use]
    pub fn count(&self) -> usize {
        self.spheres.len() + usize::from(!self.patches.is_empty())
    }

    /// A direction from a point towards a light; `None` from within a sphere and from behind a patch.
    #[must_use]
    pub fn draw(&self, light: usize, from: Vec3, u: [f32; 2]) -> Option<Drawn> {
        match self.spheres.get(light) {
            Some(sphere) => sphere.draw(from, u),
            None => self.draw_patch(from, u),
        }
    }

    /// By power, then uniformly over the triangle.
    fn draw_patch(&self, from: Vec3, u: [f32; 2]) -> Option<Drawn> {
        let k = self.cumulated.partition_point(|&c| c <= u[0]).min(self.patches.len() - 1);
        let start = if k > 0 { self.cumulated[k - 1] } else { 0.0 };
        let share = self.cumulated[k] - start;
        let root = ((u[0] - start) / share.max(1e-12)).clamp(0.0, 1.0).sqrt();
        let Patch { corners: [a, b, c], normal, area, radiance } = self.patches[k];
        let to = a * (1.0 - root) + b * (root * (1.0 - u[1])) + c * (root * u[1]) - from;
        let distance = to.length();
        let direction = to / distance.max(1e-9);
        let cosine = -direction.dot(normal);
        let squared = distance.max(NEAREST_M) * distance.max(NEAREST_M);
        (cosine > 0.0).then(|| Drawn { direction, distance, weight: radiance * (cosine * area / (squared * share)) })
    }

    /// The nearest sphere along a ray with a unit direction: its distance and radiance.
    #[must_use]
    pub fn along(&self, origin: Vec3, direction: Vec3) -> Option<(f32, Vec3)> {
        let met = self.spheres.iter().filter_map(|s| Some((s.distance(origin, direction)?, s.radiance)));
        met.min_by(|a, b| a.0.total_cmp(&b.0))
    }
}

impl Sphere {
    /// Uniform over the cone that the sphere fills.
    fn draw(&self, from: Vec3, u: [f32; 2]) -> Option<Drawn> {
        let to = self.center - from;
        let squared = to.length_squared();
        let sine2 = self.radius_m * self.radius_m / squared;
        if sine2 >= 1.0 {
            return None;
        }
        // 1 − cos of the cone, without cancellation.
        let cap = sine2 / (1.0 + (1.0 - sine2).sqrt());
        let cosine = 1.0 - cap * u[0];
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        let axis = to / squared.sqrt();
        let (t, b) = axis.any_orthonormal_pair();
        let (s, c) = libm::sincosf(TAU * u[1]);
        let direction = (axis * cosine + t * (sine * c) + b * (sine * s)).normalize();
        let distance = self.distance(from, direction).unwrap_or(squared.sqrt());
        Some(Drawn { direction, distance, weight: self.radiance * (TAU * cap) })
    }

    fn distance(&self, origin: Vec3, direction: Vec3) -> Option<f32> {
        let to = self.center - origin;
        let along = to.dot(direction);
        let inside = self.radius_m * self.radius_m - (to - direction * along).length_squared();
        let distance = along - inside.max(0.0).sqrt();
        (inside >= 0.0 && distance > 0.0).then_some(distance)
    }
}

/// An opening through which distant light comes into a closed room: a parallelogram.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Portal {
    /// One corner, metres.
    pub corner: Vec3,
    /// Edges from there, at right angles.
    pub edges: [Vec3; 2],
}

impl Portal {
    /// The direction to a point of the opening.
    #[must_use]
    pub fn draw(&self, from: Vec3, u: [f32; 2]) -> Vec3 {
        (self.corner + self.edges[0] * u[0] + self.edges[1] * u[1] - from).normalize_or_zero()
    }

    /// Density per steradian with which [`Portal::draw`] draws a direction.
    #[must_use]
    pub fn density(&self, from: Vec3, direction: Vec3) -> f32 {
        let cross = self.edges[0].cross(self.edges[1]);
        let area = cross.length();
        let normal = cross / area;
        let cosine = direction.dot(normal);
        let distance = (self.corner - from).dot(normal) / cosine;
        if !(distance > 0.0 && distance.is_finite()) {
            return 0.0;
        }
        let at = from + direction * distance - self.corner;
        let inside = self.edges.iter().all(|e| (0.0..=1.0).contains(&(at.dot(*e) / e.length_squared())));
        if inside { distance * distance / (area * cosine.abs().max(1e-6)) } else { 0.0 }
    }
}
