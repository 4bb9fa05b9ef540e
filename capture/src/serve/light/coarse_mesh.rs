//! A mesh of few vertices from surfels: the quads of naive surface nets (Gibson 1998), with vertices clustered in larger cells
//! (Rossignac, Borrel 1993) until they are few enough.

use crate::serve::live::surface::Blocks;
use fusion::{CELLS, Surfel};
use glam::{IVec3, Vec3};
use recordings::types::Mesh;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Cells of the largest cluster, along its edge.
const LARGEST: i32 = 64;

/// The mesh of at most `most` vertices.
#[must_use]
pub fn coarse_mesh(blocks: &Blocks, voxel_m: f32, most: usize) -> Mesh {
    let block_m = 8.0 * voxel_m;
    let surfels: HashMap<IVec3, Surfel> = blocks
        .iter()
        .flat_map(|(coord, surfels)| surfels.iter().map(|s| (CELLS as i32 * IVec3::from(*coord) + cell_of(s), *s)))
        .collect();
    let mut size = 1;
    while size < LARGEST
        && surfels.keys().map(|c| c.div_euclid(IVec3::splat(size))).collect::<std::collections::HashSet<_>>().len()
            > most
    {
        size *= 2;
    }
    // In the order of their coordinates, so that the mesh depends on the surface alone.
    let mut clusters: BTreeMap<[i32; 3], Cluster> = BTreeMap::new();
    let of = |cell: IVec3| cell.div_euclid(IVec3::splat(size)).to_array();
    let mut sorted: Vec<(&IVec3, &Surfel)> = surfels.iter().collect();
    sorted.sort_by_key(|(c, _)| c.to_array());
    for (cell, surfel) in &sorted {
        let cluster = clusters.entry(of(**cell)).or_default();
        let block = cell.div_euclid(IVec3::splat(CELLS as i32)).as_vec3();
        cluster.position += (block + Vec3::from(surfel.position.map(f32::from)) / 255.0) * block_m;
        cluster.normal += direction(surfel.normal);
        cluster.count += 1.0;
    }
    for (index, cluster) in clusters.values_mut().enumerate() {
        cluster.index = index as u32;
    }
    let mut triangles: BTreeSet<[u32; 3]> = BTreeSet::new();
    for (cell, surfel) in sorted {
        for axis in (0..3).filter(|axis| surfel.signs >> axis & 1 == 1) {
            let (b, c) = (unit((axis + 1) % 3), unit((axis + 2) % 3));
            let around = [*cell, *cell - b, *cell - b - c, *cell - c];
            if !around.iter().all(|cell| surfels.contains_key(cell)) {
                continue;
            }
            let mut quad = around.map(|cell| clusters.get(&of(cell)).map_or(0, |c| c.index));
            // Counter-clockwise seen from outside: the order above is, where the surface faces along the axis.
            if surfel.signs & 8 == 0 {
                quad.reverse();
            }
            for t in [[quad[0], quad[1], quad[2]], [quad[0], quad[2], quad[3]]] {
                if t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
                    triangles.insert(smallest_first(t));
                }
            }
        }
    }
    compacted(&clusters, &triangles)
}

#[derive(Default)]
struct Cluster {
    index: u32,
    position: Vec3,
    normal: Vec3,
    count: f32,
}

/// The mesh of the clusters that have a triangle.
fn compacted(clusters: &BTreeMap<[i32; 3], Cluster>, triangles: &BTreeSet<[u32; 3]>) -> Mesh {
    let mut used = vec![false; clusters.len()];
    triangles.iter().flatten().for_each(|i| used[*i as usize] = true);
    let mut mesh = Mesh::default();
    let mut place = vec![0; clusters.len()];
    for (i, cluster) in clusters.values().enumerate().filter(|(i, _)| used[*i]) {
        place[i] = mesh.positions.len() as u32;
        mesh.positions.push(cluster.position / cluster.count);
        mesh.normals.push(cluster.normal.normalize_or(Vec3::Z));
    }
    mesh.triangles = triangles.iter().map(|t| t.map(|i| place[i as usize])).collect();
    mesh
}

fn cell_of(s: &Surfel) -> IVec3 {
    let c = i32::from(s.cell);
    IVec3::new(c % 4, c / 4 % 4, c / 16)
}

fn unit(axis: usize) -> IVec3 {
    IVec3::AXES[axis]
}

/// Turns the corners so that the smallest comes first; the orientation stays.
fn smallest_first(t: [u32; 3]) -> [u32; 3] {
    let at = (0..3).min_by_key(|i| t[*i]).unwrap_or(0);
    [t[at], t[(at + 1) % 3], t[(at + 2) % 3]]
}

/// The direction of an octahedral normal.
fn direction([x, y]: [i8; 2]) -> Vec3 {
    let (x, y) = (f32::from(x) / 127.0, f32::from(y) / 127.0);
    let z = 1.0 - x.abs() - y.abs();
    let sign = |v: f32| if v < 0.0 { -1.0 } else { 1.0 };
    let v =
        if z >= 0.0 { Vec3::new(x, y, z) } else { Vec3::new((1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y), z) };
    v.normalize_or(Vec3::Z)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A horizontal plane of 8 × 8 blocks that faces up.
    fn plane() -> Blocks {
        let surfel = |i: u8| {
            let (x, y) = (i % 4, i / 4);
            Surfel {
                cell: 16 + i,
                signs: 8 | 4,
                position: [32 + 64 * x - x, 32 + 64 * y - y, 100],
                normal: [0, 0],
                weight: 90,
            }
        };
        let block = |x, y| ([x, y, 0], (0..16).map(surfel).collect());
        (-4..4).flat_map(|x| (-4..4).map(move |y| block(x, y))).collect()
    }

    #[test]
    fn a_plane_stays_one_with_few_vertices() {
        for (most, vertices) in [(2000, 1024), (1000, 256), (100, 64)] {
            let mesh = coarse_mesh(&plane(), 0.005, most);
            assert_eq!(mesh.positions.len(), vertices);
            let side = (vertices as f64).sqrt() as usize - 1;
            assert_eq!(mesh.triangles.len(), 2 * side * side);
            for t in &mesh.triangles {
                let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
                assert!((b - a).cross(c - a).normalize().z > 0.99, "faces up");
            }
        }
    }

    #[test]
    fn directions_come_back() {
        for n in [[0, 0], [127, 0], [0, -127], [127, 127]] {
            let expected = [Vec3::Z, Vec3::X, -Vec3::Y, -Vec3::Z];
            assert!(expected.iter().any(|e| e.dot(direction(n)) > 0.999), "{n:?}");
        }
    }
}
