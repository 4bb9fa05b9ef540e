//! A mesh with materials: what is inserted, and how a reconstructed surface looks to light.

use crate::numerics::rotation::rotate;
use crate::rays::Hit;
use crate::render::objects::material::{Brdf, Material};
use glam::{Quat, Vec2, Vec3};
use recordings::types::{Mesh, vertex_normals};

/// A mesh with looks. `color` and `uv` are as long as the vertices or empty; `material` as long as the triangles.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Object {
    /// Geometry, world frame (+Z up) in metres, normals filled.
    pub mesh: Mesh,
    /// Linear colour per vertex, multiplied with the base colour.
    pub color: Vec<Vec3>,
    /// Texture coordinates per vertex.
    pub uv: Vec<Vec2>,
    /// Index into `materials` per triangle.
    pub material: Vec<u32>,
    /// Materials.
    pub materials: Vec<Material>,
}

/// Weights of a hit's three corners.
#[must_use]
pub fn weights(hit: &Hit) -> [f32; 3] {
    [1.0 - hit.u - hit.v, hit.u, hit.v]
}

/// A vertex attribute at a hit.
#[must_use]
pub fn interpolate(values: &[Vec3], triangle: [u32; 3], hit: &Hit) -> Vec3 {
    let [a, b, c] = weights(hit);
    values[triangle[0] as usize] * a + values[triangle[1] as usize] * b + values[triangle[2] as usize] * c
}

impl Object {
    /// How the surface looks at a hit.
    #[must_use]
    pub fn brdf(&self, hit: &Hit) -> Brdf {
        let t = self.mesh.triangles[hit.triangle as usize];
        let color = if self.color.is_empty() { Vec3::ONE } else { interpolate(&self.color, t, hit) };
        let uv = || {
            let [a, b, c] = weights(hit);
            let at = |i: u32| self.uv.get(i as usize).copied().unwrap_or(Vec2::ZERO);
            at(t[0]) * a + at(t[1]) * b + at(t[2]) * c
        };
        let index = self.material.get(hit.triangle as usize).copied().unwrap_or(0);
        let Some(m) = self.materials.get(index as usize) else {
            return Brdf::lambertian(color);
        };
        let mut base = m.base_color * color;
        let (mut metallic, mut roughness) = (m.metallic, m.roughness);
        if let Some(texture) = &m.texture {
            base *= texture.at(uv());
        }
        if let Some(texture) = &m.metallic_roughness {
            let x = texture.at(uv());
            (roughness, metallic) = (roughness * x.y, metallic * x.z);
        }
        let (metallic, roughness) = (metallic.clamp(0.0, 1.0), roughness.clamp(0.0, 1.0));
        let dielectric = 0.04 * m.specular;
        Brdf {
            diffuse: (base * (1.0 - metallic)).clamp(Vec3::ZERO, Vec3::ONE),
            f0: (Vec3::splat(dielectric * (1.0 - metallic) + m.mirror) + base * metallic).clamp(Vec3::ZERO, Vec3::ONE),
            f90: (m.specular * (1.0 - metallic) + metallic + m.mirror).clamp(0.0, 1.0),
            alpha: roughness * roughness,
        }
    }

    /// The look at a vertex, by the first triangle that holds it: `[vertex]`.
    #[must_use]
    pub fn vertex_brdfs(&self) -> Vec<Brdf> {
        let mut brdfs = vec![Brdf::lambertian(Vec3::ZERO); self.mesh.positions.len()];
        for (index, t) in self.mesh.triangles.iter().enumerate().rev() {
            for (corner, &v) in t.iter().enumerate() {
                let (u, w) = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)][corner];
                brdfs[v as usize] = self.brdf(&Hit { distance: 0.0, triangle: index as u32, u, v: w });
            }
        }
        brdfs
    }

    /// Lowest and highest corner of the bounding box.
    #[must_use]
    pub fn bounds(&self) -> (Vec3, Vec3) {
        let p = &self.mesh.positions;
        p.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(*p), high.max(*p)))
    }

    /// Adds another object's surface.
    pub fn append(&mut self, other: &Self) {
        let (vertices, materials) = (self.mesh.positions.len(), self.materials.len() as u32);
        let all = vertices + other.mesh.positions.len();
        append_attribute(&mut self.color, &other.color, Vec3::ONE, vertices, all);
        append_attribute(&mut self.uv, &other.uv, Vec2::ZERO, vertices, all);
        self.mesh.positions.extend(&other.mesh.positions);
        self.mesh.normals.extend(&other.mesh.normals);
        self.mesh.triangles.extend(other.mesh.triangles.iter().map(|t| t.map(|i| i + vertices as u32)));
        self.material.extend(other.material.iter().map(|m| m + materials));
        self.materials.extend(other.materials.iter().cloned());
    }

    /// Turns about +Z through the origin, scales, then moves.
    pub fn place(&mut self, position: Vec3, yaw_rad: f32, scale: f32) {
        let (s, c) = libm::sincosf(yaw_rad);
        let turn = |p: Vec3| Vec3::new(c * p.x - s * p.y, s * p.x + c * p.y, p.z);
        self.mesh.positions.iter_mut().for_each(|p| *p = turn(*p) * scale + position);
        self.mesh.normals.iter_mut().for_each(|n| *n = turn(*n));
    }

    /// Turns +Z to the unit direction `up`, then moves.
    pub fn stand(&mut self, position: Vec3, up: Vec3) {
        let turn = |p: Vec3| if up == Vec3::Z { p } else { rotate(Quat::from_rotation_arc(Vec3::Z, up), p) };
        self.mesh.positions.iter_mut().for_each(|p| *p = turn(*p) + position);
        self.mesh.normals.iter_mut().for_each(|n| *n = turn(*n));
    }

    /// Splits edges longer than `longest` until none is left or `most` triangles are reached: light is kept per vertex.
    pub fn subdivide(&mut self, longest: f32, most: usize) {
        while self.mesh.triangles.len() < most {
            let long = |a: u32, b: u32, p: &[Vec3]| p[a as usize].distance(p[b as usize]) > longest;
            let mut middle = std::collections::BTreeMap::new();
            let (mut triangles, mut material) = (Vec::new(), Vec::new());
            for (i, t) in self.mesh.triangles.clone().into_iter().enumerate() {
                let m = self.material.get(i).copied().unwrap_or(0);
                let mut split = |a: u32, b: u32| {
                    long(a, b, &self.mesh.positions)
                        .then(|| *middle.entry((a.min(b), a.max(b))).or_insert_with(|| self.add_middle(a, b)))
                };
                let [ab, bc, ca] = [split(t[0], t[1]), split(t[1], t[2]), split(t[2], t[0])];
                let parts = split_triangle(t, [ab, bc, ca]);
                material.extend(std::iter::repeat_n(m, parts.len()));
                triangles.extend(parts);
            }
            (self.mesh.triangles, self.material) = (triangles, material);
            if middle.is_empty() {
                break;
            }
        }
    }

    fn add_middle(&mut self, a: u32, b: u32) -> u32 {
        let (a, b) = (a as usize, b as usize);
        let m = &mut self.mesh;
        m.positions.push((m.positions[a] + m.positions[b]) * 0.5);
        m.normals.push((m.normals[a] + m.normals[b]).try_normalize().unwrap_or(m.normals[a]));
        if !self.color.is_empty() {
            self.color.push((self.color[a] + self.color[b]) * 0.5);
        }
        if !self.uv.is_empty() {
            self.uv.push((self.uv[a] + self.uv[b]) * 0.5);
        }
        m.positions.len() as u32 - 1
    }
}

/// The parts of a triangle some of whose edges (ab, bc, ca) got a middle; neighbours agree on shared edges.
fn split_triangle([a, b, c]: [u32; 3], middles: [Option<u32>; 3]) -> Vec<[u32; 3]> {
    match middles {
        [None, None, None] => vec![[a, b, c]],
        [Some(m), None, None] => vec![[a, m, c], [m, b, c]],
        [None, Some(m), None] => vec![[b, m, a], [m, c, a]],
        [None, None, Some(m)] => vec![[c, m, b], [m, a, b]],
        [Some(m), Some(n), None] => vec![[m, b, n], [a, m, n], [a, n, c]],
        [None, Some(m), Some(n)] => vec![[m, c, n], [b, m, n], [b, n, a]],
        [Some(n), None, Some(m)] => vec![[m, a, n], [c, m, n], [c, n, b]],
        [Some(x), Some(y), Some(z)] => vec![[a, x, z], [x, b, y], [z, y, c], [x, y, z]],
    }
}

/// Appends `other` to the first `vertices` values; where only one of the two has values, the other gets the `default`.
fn append_attribute<T: Copy>(values: &mut Vec<T>, other: &[T], default: T, vertices: usize, all: usize) {
    if !(values.is_empty() && other.is_empty()) {
        values.resize(vertices, default);
        values.extend(other);
        values.resize(all, default);
    }
}

/// Checks what every object must be, and fills in normals.
///
/// # Errors
/// NaN, indices out of range, no triangles.
pub fn finish(mut object: Object) -> Result<Object, String> {
    let n = object.mesh.positions.len();
    if object.mesh.triangles.is_empty() {
        return Err("there are no triangles in it".into());
    }
    if let Some(p) = object.mesh.positions.iter().find(|p| !p.is_finite()) {
        return Err(format!("a vertex is not finite: {p}"));
    }
    if let Some(i) = object.mesh.triangles.iter().flatten().find(|i| **i as usize >= n) {
        return Err(format!("a triangle names vertex {i} of {n}"));
    }
    if object.color.iter().any(|c| !c.is_finite()) {
        return Err("a colour is not finite".into());
    }
    if object.mesh.normals.len() != n || object.mesh.normals.iter().any(|x| !x.is_finite()) {
        object.mesh.normals = vertex_normals(&object.mesh.positions, &object.mesh.triangles);
    }
    object.material.resize(object.mesh.triangles.len(), 0);
    Ok(object)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quad() -> Object {
        let positions = vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y];
        let triangles = vec![[0, 1, 2], [0, 2, 3]];
        let normals = vec![Vec3::Z; positions.len()];
        Object {
            mesh: Mesh { positions, normals, triangles },
            material: vec![0, 0],
            materials: vec![Material::default()],
            ..Object::default()
        }
    }

    #[test]
    fn subdivision_keeps_the_area_and_bounds_the_edges() {
        let mut object = quad();
        object.subdivide(0.3, 10_000);
        let p = &object.mesh.positions;
        let area: f32 = object
            .mesh
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| p[i as usize]);
                assert!(a.distance(b).max(b.distance(c)).max(c.distance(a)) <= 0.3);
                (b - a).cross(c - a).z * 0.5
            })
            .sum();
        assert!((area - 1.0).abs() < 1e-5, "{area}");
        assert_eq!(object.material.len(), object.mesh.triangles.len());
        assert_eq!(object.mesh.normals.len(), p.len());
    }

    #[test]
    fn placing_turns_then_scales_then_moves() {
        let mut object = quad();
        object.place(Vec3::new(0.0, 0.0, 5.0), std::f32::consts::FRAC_PI_2, 2.0);
        assert!((object.mesh.positions[1] - Vec3::new(0.0, 2.0, 5.0)).length() < 1e-5);
    }

    #[test]
    fn a_metal_reflects_its_colour_and_scatters_nothing() {
        let mut object = quad();
        object.materials[0] =
            Material { base_color: Vec3::new(0.9, 0.5, 0.1), metallic: 1.0, roughness: 0.0, ..Material::default() };
        let brdf = object.brdf(&Hit { distance: 0.0, triangle: 0, u: 0.2, v: 0.2 });
        assert_eq!((brdf.diffuse, brdf.f0, brdf.alpha), (Vec3::ZERO, Vec3::new(0.9, 0.5, 0.1), 0.0));
        assert!((brdf.reflectance(0.0) - Vec3::ONE).length() < 1e-6);
    }
}
