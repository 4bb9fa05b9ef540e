//! Extracts the object that rises from a planar support. A fused scan is one connected surface, and its segments are
//! patches of one colour, so neither delimits an object.

use crate::mesh::graph::Graph;
use firmware_config::tuning::RemovalTuning;
use glam::{DMat3, Vec3};
use recordings::types::Mesh;

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
pub fn object_on_support(
    mesh: &Mesh,
    graph: &Graph,
    edge: f32,
    seed: usize,
    tuning: &RemovalTuning,
) -> Option<Vec<bool>> {
    let search = Search { mesh, graph, thickness: tuning.support_thickness as f32 * edge, tuning };
    let mut best: Option<(usize, Vec<bool>)> = None;
    for plane in search.supports(seed) {
        let Some(rough) = search.standing_on(&plane, seed) else { continue };
        // A table is not that flat: repeat with the plane fitted around the object.
        let near = search.plane_about(&plane, &rough);
        let found = near.and_then(|p| search.standing_on(&p, seed)).unwrap_or(rough);
        let count = found.iter().filter(|x| **x).count();
        if best.as_ref().is_none_or(|(smallest, _)| count < *smallest) {
            best = Some((count, found));
        }
    }
    best.map(|(_, found)| found)
}

/// What every step of the extraction needs.
struct Search<'a> {
    mesh: &'a Mesh,
    graph: &'a Graph,
    /// Half thickness of a support in metres.
    thickness: f32,
    tuning: &'a RemovalTuning,
}

impl Search<'_> {
    /// Distinct planes below the vertex `seed` that many vertices lie on, most vertices first.
    fn supports(&self, seed: usize) -> Vec<Plane> {
        let mesh = self.mesh;
        let n = mesh.positions.len();
        let mut planes: Vec<(usize, Plane)> = (0..n)
            .step_by((n / self.tuning.support_candidates as usize).max(1))
            .filter_map(|v| {
                let plane = Plane { at: mesh.positions[v], normal: mesh.normals[v] };
                let carries = plane.height(mesh.positions[seed]) > self.thickness;
                carries.then(|| ((0..n).filter(|&i| self.lies_on(&plane, i)).count(), plane))
            })
            .filter(|(count, _)| *count as f32 >= self.tuning.smallest_support as f32 * n as f32)
            .collect();
        planes.sort_by_key(|(count, _)| std::cmp::Reverse(*count));
        let mut distinct: Vec<Plane> = Vec::new();
        for (_, plane) in planes {
            let same = |t: &Plane| {
                t.normal.dot(plane.normal) > self.tuning.same_plane as f32 && t.height(plane.at).abs() < self.thickness
            };
            if !distinct.iter().any(same) {
                distinct.push(plane);
            }
        }
        distinct
    }

    fn lies_on(&self, plane: &Plane, vertex: usize) -> bool {
        plane.height(self.mesh.positions[vertex]).abs() < self.thickness
            && self.mesh.normals[vertex].dot(plane.normal) > self.tuning.support_normal as f32
    }

    /// Vertices connected to `seed` above a plane without passing along it.
    fn standing_on(&self, plane: &Plane, seed: usize) -> Option<Vec<bool>> {
        let above = |v: usize| plane.height(self.mesh.positions[v]) > -self.thickness && !self.lies_on(plane, v);
        let inside = above(seed).then(|| self.graph.flood(seed, above))?;
        let count = inside.iter().filter(|x| **x).count();
        if count as f64 > self.tuning.largest_object * inside.len() as f64 {
            return None;
        }
        let mut border: Vec<u32> =
            (0..inside.len()).filter(|&v| inside[v]).flat_map(|v| self.graph.neighbours(v)).copied().collect();
        border.retain(|&v| !inside[v as usize]);
        border.sort_unstable();
        border.dedup();
        let on = border.iter().filter(|&&v| self.lies_on(plane, v as usize)).count();
        (on as f32 >= self.tuning.border_on_support as f32 * border.len() as f32).then_some(inside)
    }

    /// The least-squares plane of the support within twice an object's radius.
    fn plane_about(&self, plane: &Plane, object: &[bool]) -> Option<Plane> {
        let positions = &self.mesh.positions;
        let members = || (0..object.len()).filter(|&v| object[v]).map(|v| positions[v]);
        let middle = members().sum::<Vec3>() / members().count().max(1) as f32;
        let radius = members().fold(0.0f32, |r, p| r.max(p.distance(middle)));
        let near: Vec<Vec3> = (0..object.len())
            .filter(|&v| self.lies_on(plane, v) && positions[v].distance(middle) < 2.0 * radius)
            .map(|v| positions[v])
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
        (normal.dot(plane.normal) > self.tuning.support_normal as f32 && near.len() >= 8)
            .then_some(Plane { at, normal })
    }
}

/// The members and their neighbours: includes the rim of the contact.
#[must_use]
pub fn grown(inside: &[bool], graph: &Graph) -> Vec<bool> {
    (0..inside.len()).map(|v| inside[v] || graph.neighbours(v).iter().any(|&i| inside[i as usize])).collect()
}
