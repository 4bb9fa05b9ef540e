//! A scene: surfaces with materials and procedural textures, meshed, under distant light and lamps.

use super::bvh::{Bvh, Hit};
use super::emitters::{Emitters, Sphere};
use super::environment::Environment;
use super::material::Material;
use glam::Vec3;
use recordings::types::Mesh;

/// Base colour (linear RGB, 0..1) at a world position.
pub type Texture = Box<dyn Fn(Vec3) -> Vec3 + Send + Sync>;

/// One object: what it looks like, and its mesh in world coordinates with unit vertex normals.
pub struct Part {
    /// Name, as it stands in the truth.
    pub name: &'static str,
    /// How it reflects.
    pub material: Material,
    /// Its base colour.
    pub texture: Texture,
    /// Its surface.
    pub mesh: Mesh,
}

/// Everything the cameras see.
pub struct Scene {
    /// All parts in one mesh.
    pub mesh: Mesh,
    /// Index into `parts`, by vertex.
    pub part_of_vertex: Vec<u16>,
    /// The parts; their meshes have moved to `mesh`.
    pub parts: Vec<Part>,
    /// The light from far away.
    pub environment: Environment,
    /// The light at finite distance.
    pub emitters: Emitters,
    /// Radiance that each part emits from its front.
    pub emission: Vec<Vec3>,
    /// Base colour by vertex in place of the parts' textures, if there is any.
    pub vertex_color: Option<Vec<Vec3>>,
    bvh: Bvh,
}

/// A point of a surface as a ray finds it.
#[derive(Debug, Clone, Copy)]
pub struct Surface {
    /// Ray parameter.
    pub distance: f32,
    /// World position.
    pub position: Vec3,
    /// Unit normal of the triangle, on the ray's side.
    pub facet: Vec3,
    /// Unit interpolated normal, on the ray's side.
    pub normal: Vec3,
    /// True if the ray comes from outside: against the winding's normal.
    pub outside: bool,
    /// Index into the scene's parts.
    pub part: usize,
    /// Corners of the triangle and their weights.
    pub vertices: [u32; 3],
    /// Barycentric weights.
    pub weights: [f32; 3],
}

/// Distance by which rays start off a surface, in metres.
const OFFSET_M: f32 = 1e-4;

impl Scene {
    /// Joins the parts and builds the hierarchy.
    #[must_use]
    pub fn new(mut parts: Vec<Part>, environment: Environment) -> Self {
        let mut mesh = Mesh::default();
        let mut part_of_vertex = Vec::new();
        for (k, part) in parts.iter_mut().enumerate() {
            let own = std::mem::take(&mut part.mesh);
            let first = mesh.positions.len() as u32;
            part_of_vertex.extend(own.positions.iter().map(|_| k as u16));
            mesh.positions.extend(own.positions);
            mesh.normals.extend(own.normals);
            mesh.triangles.extend(own.triangles.iter().map(|t| t.map(|i| i + first)));
        }
        let bvh = Bvh::new(&mesh);
        let emission = vec![Vec3::ZERO; parts.len()];
        Self {
            mesh,
            part_of_vertex,
            parts,
            environment,
            emitters: Emitters::default(),
            emission,
            vertex_color: None,
            bvh,
        }
    }

    /// Adds lights at finite distance: spheres beside the mesh, and parts (by index) that emit from their front.
    #[must_use]
    pub fn with_emitters(mut self, spheres: Vec<Sphere>, parts: &[(usize, Vec3)]) -> Self {
        for &(part, radiance) in parts {
            self.emission[part] = radiance;
        }
        let radiance = |t: &[u32; 3]| self.emission[usize::from(self.part_of_vertex[t[0] as usize])];
        let emitting = self.mesh.triangles.iter().filter(|t| radiance(t) != Vec3::ZERO);
        let patches = emitting.map(|t| (t.map(|i| self.mesh.positions[i as usize]), radiance(t)));
        self.emitters = Emitters::new(spheres, patches);
        self
    }

    /// Radiance that a surface emits towards the ray that found it.
    #[must_use]
    pub fn emitted(&self, surface: &Surface) -> Vec3 {
        if surface.outside { self.emission[surface.part] } else { Vec3::ZERO }
    }

    /// The first surface along a ray with a unit direction.
    #[must_use]
    pub fn intersect(&self, origin: Vec3, direction: Vec3) -> Option<Surface> {
        let Hit { distance, triangle, weights } = self.bvh.closest(origin, direction, f32::INFINITY)?;
        let vertices = self.mesh.triangles[triangle as usize];
        let [a, b, c] = vertices.map(|i| self.mesh.positions[i as usize]);
        let facet = (b - a).cross(c - a).normalize_or_zero();
        let outside = facet.dot(direction) <= 0.0;
        let facet = if outside { facet } else { -facet };
        let normal: Vec3 = vertices.iter().zip(weights).map(|(&i, w)| self.mesh.normals[i as usize] * w).sum();
        let normal = normal.try_normalize().unwrap_or(facet);
        let normal = if normal.dot(facet) < 0.0 { -normal } else { normal };
        let part = usize::from(self.part_of_vertex[vertices[0] as usize]);
        let position = origin + direction * distance;
        Some(Surface { distance, position, facet, normal, outside, part, vertices, weights })
    }

    /// Depth along a ray with any direction: the ray parameter of the first surface.
    #[must_use]
    pub fn distance(&self, origin: Vec3, direction: Vec3) -> Option<f32> {
        self.bvh.closest(origin, direction, f32::INFINITY).map(|hit| hit.distance)
    }

    /// True if something stands between `from` (a point of a surface with that outward normal) and `to`.
    #[must_use]
    pub fn blocked(&self, from: Vec3, normal: Vec3, to: Vec3) -> bool {
        let start = from + normal * OFFSET_M;
        self.bvh.occluded(start, to - start, 1.0)
    }

    /// True if the light from a direction reaches a point of a surface with that outward normal.
    #[must_use]
    pub fn lit(&self, from: Vec3, normal: Vec3, direction: Vec3) -> bool {
        !self.bvh.occluded(from + normal * OFFSET_M, direction, f32::INFINITY)
    }

    /// True if nothing stands on the way of `distance` metres towards a light.
    #[must_use]
    pub fn reached(&self, from: Vec3, normal: Vec3, direction: Vec3, distance: f32) -> bool {
        !self.bvh.occluded(from + normal * OFFSET_M, direction, distance * (1.0 - 1e-3) - OFFSET_M)
    }

    /// The surface that a ray leaving a surface point meets.
    #[must_use]
    pub fn next(&self, from: Vec3, normal: Vec3, direction: Vec3) -> Option<Surface> {
        self.intersect(from + normal * OFFSET_M, direction)
    }

    /// Base colour at a surface point.
    #[must_use]
    pub fn base_color(&self, surface: &Surface) -> Vec3 {
        match &self.vertex_color {
            Some(color) => surface.vertices.iter().zip(surface.weights).map(|(&i, w)| color[i as usize] * w).sum(),
            None => (self.parts[surface.part].texture)(surface.position),
        }
    }

    /// Diffuse albedo (1 − w_s) · base colour, by vertex.
    #[must_use]
    pub fn albedo(&self) -> Vec<Vec3> {
        let of = |(i, &k): (usize, &u16)| {
            let part = &self.parts[usize::from(k)];
            let base = self.vertex_color.as_ref().map_or_else(|| (part.texture)(self.mesh.positions[i]), |c| c[i]);
            base * (1.0 - part.material.w_s)
        };
        self.part_of_vertex.iter().enumerate().map(of).collect()
    }
}
