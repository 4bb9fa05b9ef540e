//! Surface that lies right under another sheet, as a wall behind a picture or a floor under a rug.

use crate::association::eligibility::VISIBLE_EDGES;
use crate::mesh::graph::{Graph, vertex_spacing};
use crate::rays::RayScene;
use rayon::prelude::*;
use recordings::types::Mesh;

/// Vertices that another sheet covers, so near that the test for visibility cannot tell them apart: what keyframes show there is
/// the other sheet, while next to no light arrives. `[vertex]`
#[must_use]
pub fn covered(mesh: &Mesh, graph: &Graph, scene: &RayScene) -> Vec<bool> {
    let spacing = vertex_spacing(mesh, graph, scene.median_edge());
    let vertices = mesh.positions.par_iter().zip(&mesh.normals).zip(&spacing);
    let is_covered = vertices.map(|((position, normal), spacing)| {
        scene.occluded_within(scene.offset_origin(*position, *normal), *normal, VISIBLE_EDGES * spacing)
    });
    is_covered.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn a_wall_is_covered_where_a_picture_hangs() {
        // Two squares of 21 × 21 vertices that face +Z: the upper one covers the middle of the lower one.
        let mut mesh = Mesh::default();
        for (edge, height) in [(0.1, 0.0), (0.05, 0.03)] {
            let first = mesh.positions.len() as u32;
            for i in 0..441_u32 {
                let at = |k: u32| (k as f32 - 10.0) * edge;
                mesh.positions.push(Vec3::new(at(i % 21), at(i / 21), height));
                mesh.normals.push(Vec3::Z);
                if i % 21 < 20 && i / 21 < 20 {
                    let j = first + i;
                    mesh.triangles.extend([[j, j + 1, j + 22], [j, j + 22, j + 21]]);
                }
            }
        }
        let found = covered(&mesh, &Graph::of(&mesh), &RayScene::new(&mesh));
        for (i, p) in mesh.positions.iter().enumerate() {
            let is_behind = i < 441 && p.abs().max_element() < 0.45;
            let is_beside = i >= 441 || p.abs().max_element() > 0.55;
            assert!(if found[i] { !is_beside } else { !is_behind }, "vertex {i} at {p}");
        }
    }
}
