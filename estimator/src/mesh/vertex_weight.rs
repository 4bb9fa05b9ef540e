//! Where a mesh is not to be trusted with light: at its rims and creases, normals are wrong and pictures mix both sides.

use crate::mesh::graph::Graph;
use recordings::types::Mesh;

/// Cosine between the normals of two ends of an edge below which it is a crease.
const CREASE: f32 = 0.95;
/// Edges that the trouble reaches.
const REACH: usize = 2;
/// Weight of such a vertex against others. Not 0: what has nothing else keeps its say.
const TROUBLED: f32 = 0.05;

/// Weight of every vertex in the light's equations: 1, or little near a rim or crease.
#[must_use]
pub fn trust(mesh: &Mesh) -> Vec<f32> {
    let graph = Graph::of(mesh);
    let mut troubled: Vec<bool> = (0..graph.vertices())
        .map(|i| graph.neighbours(i).iter().any(|&j| mesh.normals[i].dot(mesh.normals[j as usize]) < CREASE))
        .collect();
    let sides = |&[a, b, c]: &[u32; 3]| [(a, b), (b, c), (c, a)].map(|(a, b)| [a.min(b), a.max(b)]);
    let mut edges: Vec<[u32; 2]> = mesh.triangles.iter().flat_map(sides).collect();
    edges.sort_unstable();
    // An edge of one triangle only is the mesh's end.
    for rim in edges.chunk_by(|a, b| a == b).filter(|same| same.len() == 1).flatten() {
        rim.iter().for_each(|&i| troubled[i as usize] = true);
    }
    for _ in 0..REACH {
        let grown =
            (0..graph.vertices()).map(|i| troubled[i] || graph.neighbours(i).iter().any(|&j| troubled[j as usize]));
        troubled = grown.collect();
    }
    troubled.into_iter().map(|t| if t { TROUBLED } else { 1.0 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn rims_and_what_is_near_them_count_little() {
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
        let flat = trust(&mesh);
        assert_eq!([flat[at(0, 6)], flat[at(2, 6)], flat[at(3, 6)], flat[at(6, 6)]], [TROUBLED, TROUBLED, 1.0, 1.0]);
        mesh.normals[at(6, 6)] = Vec3::new(0.6, 0.0, 0.8);
        let creased = trust(&mesh);
        assert_eq!([creased[at(6, 6)], creased[at(3, 6)], creased[at(8, 4)]], [TROUBLED, TROUBLED, 1.0]);
    }
}
