//! Weights of vertices in the equations of light: at the borders and creases of a mesh, normals are wrong and images mix both
//! sides.

use crate::mesh::graph::Graph;
use recordings::types::Mesh;

/// Cosine between the normals at both ends of an edge below which the edge is a crease.
const CREASE: f32 = 0.95;
/// Distance from a border or crease, in edges, up to which vertices are unreliable.
const REACH: usize = 2;
/// Weight of an unreliable vertex; not 0, so that segments without other vertices are still estimated.
const UNRELIABLE_WEIGHT: f32 = 0.05;

/// Weight of every vertex of a mesh and its `graph`, `[vertex]`: 1, or `UNRELIABLE_WEIGHT` near a border or crease.
#[must_use]
pub fn vertex_weights(mesh: &Mesh, graph: &Graph) -> Vec<f32> {
    let mut unreliable: Vec<bool> = (0..graph.vertices())
        .map(|i| graph.neighbours(i).iter().any(|&j| mesh.normals[i].dot(mesh.normals[j as usize]) < CREASE))
        .collect();
    let sides = |&[a, b, c]: &[u32; 3]| [(a, b), (b, c), (c, a)].map(|(a, b)| [a.min(b), a.max(b)]);
    let mut edges: Vec<[u32; 2]> = mesh.triangles.iter().flat_map(sides).collect();
    edges.sort_unstable();
    // An edge of only one triangle is on the border.
    for border in edges.chunk_by(|a, b| a == b).filter(|same| same.len() == 1).flatten() {
        border.iter().for_each(|&i| unreliable[i as usize] = true);
    }
    for _ in 0..REACH {
        let grown =
            (0..graph.vertices()).map(|i| unreliable[i] || graph.neighbours(i).iter().any(|&j| unreliable[j as usize]));
        unreliable = grown.collect();
    }
    unreliable.into_iter().map(|t| if t { UNRELIABLE_WEIGHT } else { 1.0 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn borders_and_creases_have_a_low_weight() {
        let n = 12;
        let mut mesh = Mesh::default();
        for i in 0..=n {
            for j in 0..=n {
                mesh.positions.push(Vec3::new(i as f32, j as f32, 0.0));
                mesh.normals.push(Vec3::Z);
                if i < n && j < n {
                    let at = |i: u32, j: u32| i * (n + 1) + j;
                    mesh.triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                    mesh.triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
                }
            }
        }
        let at = |i: u32, j: u32| (i * (n + 1) + j) as usize;
        let flat = vertex_weights(&mesh, &Graph::of(&mesh));
        assert_eq!(
            [flat[at(0, 6)], flat[at(2, 6)], flat[at(3, 6)], flat[at(6, 6)]],
            [UNRELIABLE_WEIGHT, UNRELIABLE_WEIGHT, 1.0, 1.0]
        );
        mesh.normals[at(6, 6)] = Vec3::new(0.6, 0.0, 0.8);
        let creased = vertex_weights(&mesh, &Graph::of(&mesh));
        assert_eq!(
            [creased[at(6, 6)], creased[at(3, 6)], creased[at(8, 4)]],
            [UNRELIABLE_WEIGHT, UNRELIABLE_WEIGHT, 1.0]
        );
    }
}
