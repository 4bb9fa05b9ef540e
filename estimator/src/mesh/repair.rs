//! Defects of a scanned mesh: unusable triangles, missing normals, seams, specks.

use crate::mesh::unions::Unions;
use crate::numerics::lists::by_key;
use crate::numerics::robust::median;
use glam::{IVec3, Vec3};
use rayon::prelude::*;
use recordings::types::Mesh;

/// The same vertices with finite positions and unit normals, and the usable triangles.
pub fn repaired(mesh: &Mesh) -> Mesh {
    let triangles = usable_triangles(mesh);
    let made = area_normals(&mesh.positions, &triangles);
    let normals = (0..mesh.positions.len())
        .map(|i| match mesh.normals.get(i) {
            Some(n) if n.is_finite() && n.length_squared() > 1e-6 => n.normalize(),
            _ => made[i],
        })
        .collect();
    let positions = mesh.positions.iter().map(|p| if p.is_finite() { *p } else { Vec3::ZERO }).collect();
    Mesh { positions, normals, triangles }
}

/// The usable triangles and their vertices.
pub fn usable(mesh: &Mesh) -> Mesh {
    compacted(mesh, usable_triangles(mesh))
}

/// Triangles with three different, finite corners and a positive area, each set of corners once.
pub fn usable_triangles(mesh: &Mesh) -> Vec<[u32; 3]> {
    let corner = |i: u32| mesh.positions.get(i as usize).copied().filter(|p| p.is_finite());
    let usable = |t: &[u32; 3]| match (corner(t[0]), corner(t[1]), corner(t[2])) {
        (Some(a), Some(b), Some(c)) => (b - a).cross(c - a).length_squared() > 0.0,
        _ => false,
    };
    let kept: Vec<[u32; 3]> = mesh.triangles.par_iter().copied().filter(usable).collect();
    let is_again = again(&kept, mesh.positions.len());
    kept.into_iter().zip(is_again).filter(|(_, again)| !again).map(|(t, _)| t).collect()
}

/// Whether an earlier triangle has the same corners, in any order: `[triangle]`.
fn again(triangles: &[[u32; 3]], vertices: usize) -> Vec<bool> {
    // Those with the same corners share the lowest one.
    let lowest = |t: &[u32; 3]| t[0].min(t[1]).min(t[2]);
    let (starts, by_lowest) = by_key(vertices, (0..).zip(triangles).map(|(n, t)| (lowest(t), n)));
    let sorted = |n: u32| {
        let mut key = triangles[n as usize];
        key.sort_unstable();
        (key, n)
    };
    let mut again = vec![false; triangles.len()];
    let mut keyed = Vec::new();
    for range in starts.windows(2).filter(|w| w[1] - w[0] > 1) {
        keyed.clear();
        keyed.extend(by_lowest[range[0] as usize..range[1] as usize].iter().map(|n| sorted(*n)));
        keyed.sort_unstable();
        keyed.windows(2).filter(|w| w[0].0 == w[1].0).for_each(|w| again[w[1].1 as usize] = true);
    }
    again
}

/// Unit vertex normals, triangles weighted by area; +Z for vertices without a triangle.
fn area_normals(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut sums = vec![Vec3::ZERO; positions.len()];
    for t in triangles {
        let [a, b, c] = t.map(|i| positions[i as usize]);
        let n = (b - a).cross(c - a);
        for &i in t {
            sums[i as usize] += n;
        }
    }
    sums.into_iter().map(|n| n.try_normalize().unwrap_or(Vec3::Z)).collect()
}

/// Merges vertices within `distance` median edges and drops vertices without a triangle.
pub fn welded(mesh: &Mesh, distance: f32) -> Mesh {
    let cell = distance * median(edge_lengths(mesh)).unwrap_or(0.0);
    if !(cell > 0.0 && cell.is_finite()) {
        return mesh.clone();
    }
    let origin = mesh.positions.iter().copied().fold(Vec3::INFINITY, Vec3::min);
    // Saturating casts: coordinates beyond 2³¹ cells are merged only with each other.
    let mut keyed: Vec<([i32; 3], u32)> = (0u32..)
        .zip(&mesh.positions)
        .map(|(i, p)| (((*p - origin) / cell).round().as_ivec3().min(IVec3::MAX).to_array(), i))
        .collect();
    keyed.par_sort_unstable();
    let mut names = vec![0_u32; mesh.positions.len()];
    let mut first = 0;
    for (k, (key, i)) in keyed.iter().enumerate() {
        if key != &keyed[first].0 {
            first = k;
        }
        names[*i as usize] = keyed[first].1;
    }
    let triangles: Vec<[u32; 3]> = mesh.triangles.iter().map(|t| t.map(|i| names[i as usize])).collect();
    let triangles = usable_triangles(&Mesh { positions: mesh.positions.clone(), normals: vec![], triangles });
    compacted(mesh, triangles)
}

/// Drops connected components with fewer vertices than `share` of the largest: noise of the depth camera.
pub fn without_small_components(mesh: &Mesh, share: f64) -> Mesh {
    let mut unions = Unions::new(mesh.positions.len());
    for t in &mesh.triangles {
        unions.join(t[0], t[1]);
        unions.join(t[0], t[2]);
    }
    let roots: Vec<u32> = (0..mesh.positions.len() as u32).map(|i| unions.first(i)).collect();
    let mut sizes = vec![0_u32; mesh.positions.len()];
    roots.iter().for_each(|&r| sizes[r as usize] += 1);
    let least = share * f64::from(sizes.iter().copied().max().unwrap_or(0));
    let big = |t: &&[u32; 3]| f64::from(sizes[roots[t[0] as usize] as usize]) >= least;
    compacted(mesh, mesh.triangles.iter().filter(big).copied().collect())
}

/// The mesh of these triangles, without the vertices that none of them uses.
pub fn compacted(mesh: &Mesh, mut triangles: Vec<[u32; 3]>) -> Mesh {
    let mut used = vec![false; mesh.positions.len()];
    triangles.iter().flatten().for_each(|&i| used[i as usize] = true);
    let mut names = vec![0_u32; used.len()];
    let (mut positions, mut normals) = (Vec::new(), Vec::new());
    for i in (0..used.len()).filter(|&i| used[i]) {
        names[i] = positions.len() as u32;
        positions.push(mesh.positions[i]);
        normals.push(mesh.normals[i]);
    }
    triangles.iter_mut().flatten().for_each(|i| *i = names[*i as usize]);
    Mesh { positions, normals, triangles }
}

/// Lengths of the triangles' sides in the mesh's units, `[3 · triangle]`: inner edges stand twice.
pub fn edge_lengths(mesh: &Mesh) -> Vec<f32> {
    let length = |a: u32, b: u32| mesh.positions[a as usize].distance(mesh.positions[b as usize]);
    mesh.triangles.iter().flat_map(|t| [length(t[0], t[1]), length(t[1], t[2]), length(t[2], t[0])]).collect()
}

/// Surface area in the mesh's units squared.
pub fn area(mesh: &Mesh) -> f64 {
    let corners = |t: &[u32; 3]| t.map(|i| mesh.positions[i as usize]);
    mesh.triangles.iter().map(corners).map(|[a, b, c]| 0.5 * f64::from((b - a).cross(c - a).length())).sum()
}

/// Edge length at which `vertices` vertices cover an area: an equilateral triangulation has √3/2 edge² per vertex.
pub fn edge_for(area: f64, vertices: u32) -> f32 {
    (area / (0.75f64.sqrt() * f64::from(vertices))).sqrt() as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_set_of_corners_stays_once_where_it_came_first() {
        let positions = vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z, Vec3::ONE, Vec3::NAN];
        let triangles =
            vec![[3, 1, 2], [1, 2, 3], [0, 1, 2], [2, 1, 3], [0, 1, 4], [2, 1, 0], [1, 1, 2], [0, 1, 5], [4, 0, 2]];
        let mesh = Mesh { normals: vec![Vec3::Z; positions.len()], positions, triangles };
        assert_eq!(usable_triangles(&mesh), [[3, 1, 2], [0, 1, 2], [0, 1, 4], [4, 0, 2]]);
    }
}
