//! Vertices of one mesh that stand for those of another.

use glam::{IVec3, Vec3};
use recordings::types::Mesh;
use std::collections::HashMap;

/// Smallest cosine between the normals of vertices that are compared.
const AGREEING: f32 = 0.4;

/// The vertices of a mesh, by cubic cell.
pub struct Vertices<'a> {
    mesh: &'a Mesh,
    cell: f32,
    cells: HashMap<IVec3, Vec<usize>>,
}

impl<'a> Vertices<'a> {
    /// Those of `mesh`, to be found from at least `cell` away.
    #[must_use]
    pub fn new(mesh: &'a Mesh, cell: f32) -> Self {
        let mut cells: HashMap<IVec3, Vec<usize>> = HashMap::new();
        for (k, p) in mesh.positions.iter().enumerate() {
            cells.entry((p / cell).floor().as_ivec3()).or_default().push(k);
        }
        Self { mesh, cell, cells }
    }

    /// The nearest one whose normal agrees, within the cell of a point and those around it.
    #[must_use]
    pub fn nearest(&self, point: Vec3, normal: Vec3) -> Option<usize> {
        let key = (point / self.cell).floor().as_ivec3();
        let around = (0..27).map(|k| key + IVec3::new(k % 3, k / 3 % 3, k / 9) - 1);
        let candidates = around.filter_map(|c| self.cells.get(&c)).flatten().copied();
        let agreeing = candidates.filter(|&k| self.mesh.normals[k].dot(normal) > AGREEING);
        let away = |k: usize| point.distance_squared(self.mesh.positions[k]);
        agreeing.min_by(|&a, &b| away(a).total_cmp(&away(b)))
    }
}
