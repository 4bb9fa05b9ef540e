//! Vertices grouped by grid cell and main direction of their normals.

use glam::Vec3;
use rayon::prelude::*;
use recordings::types::Mesh;

/// A vertex with its group.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct CellVertex {
    /// Grid cell, counted from the mesh's lowest corner.
    pub cell: [i32; 3],
    /// Main direction of the normal, by [`facing`].
    pub facing: usize,
    /// Index of the vertex.
    pub vertex: usize,
}

/// Main direction of a normal: 2 · axis, plus 1 if it is negative.
#[must_use]
pub fn facing(normal: Vec3) -> usize {
    let a = normal.abs();
    let axis = if a.x >= a.y && a.x >= a.z { 0 } else { 1 + usize::from(a.z > a.y) };
    2 * axis + usize::from(normal[axis] < 0.0)
}

/// The vertices for which `keep` holds, sorted by cubic cell of edge `size`, then direction, then index.
pub fn by_cell(mesh: &Mesh, size: f32, keep: impl Fn(usize) -> bool + Sync) -> Vec<CellVertex> {
    let origin = mesh.positions.iter().copied().fold(Vec3::INFINITY, Vec3::min);
    let entry = |vertex: usize| {
        let cell = ((mesh.positions[vertex] - origin) / size).floor().as_ivec3().to_array();
        CellVertex { cell, facing: facing(mesh.normals[vertex]), vertex }
    };
    let kept = (0..mesh.positions.len()).into_par_iter().filter(|&i| keep(i));
    let mut entries: Vec<CellVertex> = kept.map(entry).collect();
    entries.par_sort_unstable();
    entries
}

/// The groups of sorted entries: one per cell and direction.
pub fn groups(entries: &[CellVertex]) -> impl Iterator<Item = &[CellVertex]> {
    entries.chunk_by(|a, b| (a.cell, a.facing) == (b.cell, b.facing))
}
