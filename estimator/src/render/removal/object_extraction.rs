//! Extracts the object that rises from a planar support. A fused scan is one connected surface, and its segments are
//! patches of one colour, so neither delimits an object.

use crate::mesh::graph::Graph;
use glam::{DMat3, Vec3};
use recordings::types::Mesh;

/// Vertices whose tangent planes are tried as the support.
const CANDIDATES: usize = 256;
/// Share of the vertices that a support has at least.
const SMALLEST_SUPPORT: f32 = 0.02;
/// A support's vertices lie within this many edges of its plane, and agree with its normal to this cosine.
const THICKNESS: f32 = 2.0;
const SAME_NORMAL: f32 = 0.9;
/// Cosine to a plane tried before under which another is the same.
const SAME_PLANE: f32 = 0.98;
/// Share of an object's border that must lie on its support: otherwise the plane cuts the object in two.
const STANDS: f32 = 0.7;
/// A larger share of the vertices is the scene, not an object on its support.
const LARGEST: f64 = 0.75;

/// A plane; its unit normal points to what stands on it.
#[derive(Debug, Clone, Copy)]
struct Plane {
    at: Vec3,
    normal: Vec3,
}

impl Plane {
    fn height(&self, p: Vec3) -> f32 {
        (p - self.at).dot(self.normal)
    }
}

/// The smallest object around the vertex `seed` that stands on a large plane, as `[vertex]` membership; `edge` is the mesh's
/// median edge (m). `None` without such a support, or where the object would be most of the scan.
#[must_use]
pub fn object_on_support(mesh: &Mesh, graph: &Graph, edge: f32, seed: usize) -> Option<Vec<bool>> {
    let n = mesh.positions.len();
    let thickness = THICKNESS * edge;
    let mut planes: Vec<(usize, Plane)> = (0..n)
        .step_by((n / CANDIDATES).max(1))
        .filter_map(|v| {
            let plane = Plane { at: mesh.positions[v], normal: mesh.normals[v] };
            let carries = plane.height(mesh.positions[seed]) > thickness;
            carries.then(|| ((0..n).filter(|&i| lies_on(mesh, &plane, i, thickness)).count(), plane))
        })
        .filter(|(count, _)| *count as f32 >= SMALLEST_SUPPORT * n as f32)
        .collect();
    planes.sort_by_key(|(count, _)| std::cmp::Reverse(*count));
    let mut tried: Vec<Plane> = Vec::new();
    let mut best: Option<(usize, Vec<bool>)> = None;
    for (_, plane) in planes {
        let same = |t: &Plane| t.normal.dot(plane.normal) > SAME_PLANE && t.height(plane.at).abs() < thickness;
        if tried.iter().any(same) {
            continue;
        }
        tried.push(plane);
        let Some(rough) = standing_on(mesh, graph, &plane, thickness, seed) else { continue };
        // A table is not that flat: repeat with the plane fitted around the object.
        let near = plane_about(mesh, &plane, thickness, &rough);
        let found = near.and_then(|p| standing_on(mesh, graph, &p, thickness, seed)).unwrap_or(rough);
        let count = found.iter().filter(|x| **x).count();
        if best.as_ref().is_none_or(|(smallest, _)| count < *smallest) {
            best = Some((count, found));
        }
    }
    best.map(|(_, found)| found)
}

fn lies_on(mesh: &Mesh, plane: &Plane, vertex: usize, thickness: f32) -> bool {
    plane.height(mesh.positions[vertex]).abs() < thickness && mesh.normals[vertex].dot(plane.normal) > SAME_NORMAL
}

/// What is connected to `seed` above a plane without passing along it.
fn standing_on(mesh: &Mesh, graph: &Graph, plane: &Plane, thickness: f32, seed: usize) -> Option<Vec<bool>> {
    let above = |v: usize| plane.height(mesh.positions[v]) > -thickness && !lies_on(mesh, plane, v, thickness);
    let inside = above(seed).then(|| graph.flood(seed, above))?;
    let count = inside.iter().filter(|x| **x).count();
    if count as f64 > LARGEST * inside.len() as f64 {
        return None;
    }
    let mut border: Vec<u32> =
        (0..inside.len()).filter(|&v| inside[v]).flat_map(|v| graph.neighbours(v)).copied().collect();
    border.retain(|&v| !inside[v as usize]);
    border.sort_unstable();
    border.dedup();
    let on = border.iter().filter(|&&v| lies_on(mesh, plane, v as usize, thickness)).count();
    (on as f32 >= STANDS * border.len() as f32).then_some(inside)
}

/// The least-squares plane of the support within twice an object's radius.
fn plane_about(mesh: &Mesh, plane: &Plane, thickness: f32, object: &[bool]) -> Option<Plane> {
    let members = || (0..object.len()).filter(|&v| object[v]).map(|v| mesh.positions[v]);
    let middle = members().sum::<Vec3>() / members().count().max(1) as f32;
    let radius = members().fold(0.0f32, |r, p| r.max(p.distance(middle)));
    let near: Vec<Vec3> = (0..object.len())
        .filter(|&v| lies_on(mesh, plane, v, thickness) && mesh.positions[v].distance(middle) < 2.0 * radius)
        .map(|v| mesh.positions[v])
        .collect();
    let at = near.iter().sum::<Vec3>() / near.len().max(1) as f32;
    let spread = near.iter().fold(DMat3::ZERO, |m, p| {
        let d = (*p - at).as_dvec3();
        m + DMat3::from_cols(d * d.x, d * d.y, d * d.z)
    });
    let spread = nalgebra::Matrix3::from_column_slice(&spread.to_cols_array());
    let eigen = spread.symmetric_eigen();
    let smallest = eigen.eigenvalues.imin();
    let axis = eigen.eigenvectors.column(smallest);
    let normal = Vec3::new(axis[0] as f32, axis[1] as f32, axis[2] as f32).try_normalize()?;
    let normal = if normal.dot(plane.normal) < 0.0 { -normal } else { normal };
    (normal.dot(plane.normal) > SAME_NORMAL && near.len() >= 8).then_some(Plane { at, normal })
}

/// The members and their neighbours: includes the rim of the contact.
#[must_use]
pub fn grown(inside: &[bool], graph: &Graph) -> Vec<bool> {
    (0..inside.len()).map(|v| inside[v] || graph.neighbours(v).iter().any(|&i| inside[i as usize])).collect()
}
