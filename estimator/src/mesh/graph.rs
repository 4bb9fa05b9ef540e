//! The mesh as a graph: vertices that share a triangle edge are neighbours.

use crate::numerics::lists::by_key;
use foldhash::{HashSet, HashSetExt};
use glam::Vec3;
use recordings::types::Mesh;

/// Vertex adjacency in compressed sparse rows, ascending within a row.
#[derive(Debug)]
pub struct Graph {
    /// Row starts in `targets`: `[vertex + 1]`.
    pub offsets: Vec<u32>,
    /// Neighbours of all vertices: `[directed edge]`.
    pub targets: Vec<u32>,
}

impl Graph {
    /// The edges of `triangles` over `vertices` vertices, each once in both directions; edges from a vertex to itself are
    /// dropped.
    #[must_use]
    pub fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        let n = vertices;
        let directed = |&[a, b, c]: &[u32; 3]| [(a, b), (b, a), (b, c), (c, b), (c, a), (a, c)];
        let (mut offsets, mut targets) = by_key(n, triangles.iter().flat_map(directed).filter(|(p, q)| p != q));
        // Two triangles list an inner edge twice in both its rows: sort and keep one.
        let mut kept = 0;
        let mut start = 0;
        for i in 0..n {
            let end = offsets[i + 1] as usize;
            targets[start..end].sort_unstable();
            let first = kept;
            for k in start..end {
                if kept == first || targets[kept - 1] != targets[k] {
                    targets[kept] = targets[k];
                    kept += 1;
                }
            }
            start = end;
            offsets[i + 1] = kept as u32;
        }
        targets.truncate(kept);
        Self { offsets, targets }
    }

    /// The adjacency of a mesh.
    #[must_use]
    pub fn of(mesh: &Mesh) -> Self {
        Self::new(mesh.positions.len(), &mesh.triangles)
    }

    /// Neighbours of vertex `i`.
    #[must_use]
    pub fn neighbours(&self, i: usize) -> &[u32] {
        &self.targets[self.offsets[i] as usize..self.offsets[i + 1] as usize]
    }

    /// Edges from vertex `i`: index into `targets`, neighbour.
    pub fn edges(&self, i: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        (self.offsets[i] as usize..self.offsets[i + 1] as usize).map(|e| (e, self.targets[e] as usize))
    }

    /// Number of vertices.
    #[must_use]
    pub fn vertices(&self) -> usize {
        self.offsets.len() - 1
    }

    /// The unvisited vertices connected to `start` through unvisited ones, breadth first; marks them as visited.
    pub fn component(&self, start: usize, visited: &mut [bool]) -> Vec<usize> {
        self.grow(vec![start], visited, |_| true)
    }

    /// `from` and the unvisited vertices connected to it through unvisited ones that are `passable`, breadth first; marks
    /// them as visited.
    pub fn grow(&self, from: Vec<usize>, visited: &mut [bool], passable: impl Fn(usize) -> bool) -> Vec<usize> {
        let mut list = from;
        list.iter().for_each(|&i| visited[i] = true);
        let mut next = 0;
        while next < list.len() {
            for n in self.neighbours(list[next]).iter().map(|&n| n as usize) {
                if !visited[n] && passable(n) {
                    visited[n] = true;
                    list.push(n);
                }
            }
            next += 1;
        }
        list
    }

    /// Marks every vertex connected to `start` through vertices for which `passable` holds: `[vertex]`.
    #[must_use]
    pub fn flood(&self, start: usize, passable: impl Fn(usize) -> bool) -> Vec<bool> {
        let mut inside = vec![false; self.vertices()];
        self.grow(vec![start], &mut inside, passable);
        inside
    }

    /// `start` and vertices at most `reach` edges from it through `passable` ones, breadth first, `most` of them at most.
    #[must_use]
    pub fn around(&self, start: usize, reach: usize, most: usize, passable: impl Fn(usize) -> bool) -> Vec<u32> {
        let mut listed: HashSet<u32> = HashSet::with_capacity(most);
        listed.insert(start as u32);
        let (mut list, mut inner) = (Vec::with_capacity(most), 0);
        list.push(start as u32);
        for _ in 0..reach {
            let ring = inner..list.len();
            inner = ring.end;
            for n in ring {
                for &j in self.neighbours(list[n] as usize) {
                    if list.len() < most && passable(j as usize) && listed.insert(j) {
                        list.push(j);
                    }
                }
            }
        }
        list
    }

    /// Gives vertices without a colour the mean of their neighbours' colours, ring by ring, at most `rings` times.
    pub fn fill(&self, colors: &mut [Option<Vec3>], rings: usize) {
        let mut open: Vec<usize> = (0..colors.len()).filter(|&i| colors[i].is_none()).collect();
        for _ in 0..rings {
            let around = |i: usize| self.neighbours(i).iter().filter_map(|&j| colors[j as usize]);
            let reached: Vec<(usize, Vec3)> = open.iter().filter_map(|&i| Some((i, mean(around(i))?))).collect();
            if reached.is_empty() {
                break;
            }
            reached.into_iter().for_each(|(i, color)| colors[i] = Some(color));
            open.retain(|&i| colors[i].is_none());
        }
    }
}

/// Mean of colours; `None` of none.
#[must_use]
pub fn mean(colors: impl Iterator<Item = Vec3>) -> Option<Vec3> {
    let (sum, count) = colors.fold((Vec3::ZERO, 0.0), |(s, n), c| (s + c, n + 1.0));
    (count > 0.0).then(|| sum / count)
}

/// Mean edge length at every vertex in the mesh's units, `[vertex]`; `fallback` where it has no edge.
#[must_use]
pub fn vertex_spacing(mesh: &Mesh, graph: &Graph, fallback: f32) -> Vec<f32> {
    (0..graph.vertices())
        .map(|i| {
            let row = graph.neighbours(i);
            let sum: f32 = row.iter().map(|&j| mesh.positions[i].distance(mesh.positions[j as usize])).sum();
            let mean = sum / row.len() as f32;
            if mean.is_finite() && mean > 0.0 { mean } else { fallback }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_edge_once_in_both_directions() {
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::ONE, Vec3::Z],
            normals: vec![],
            triangles: vec![[0, 1, 2], [2, 1, 3], [0, 0, 1]],
        };
        let graph = Graph::of(&mesh);
        let rows: Vec<&[u32]> = (0..5).map(|i| graph.neighbours(i)).collect();
        assert_eq!(rows, [&[1, 2][..], &[0, 2, 3], &[0, 1, 3], &[1, 2], &[]]);
        assert_eq!(vertex_spacing(&mesh, &graph, 7.0)[4], 7.0);
    }
}
