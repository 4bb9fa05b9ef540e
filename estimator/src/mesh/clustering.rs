//! Fewer vertices by clustering: much faster than remeshing, less regular.

use crate::mesh::cells::{by_cell, groups};
use crate::mesh::repair::{area, edge_for, repaired, usable};
use crate::mesh::unions::Unions;
use glam::{IVec3, Vec3, Vec4};
use rayon::prelude::*;
use recordings::types::Mesh;

/// Smallest cosine between the normals of neighbours in a patch.
const AGREEING: f32 = 0.5;
/// Smallest length of the mean of a patch's normals.
const FLAT: f32 = 0.85;
/// Grids that are tried, each half as wide as the one before.
const GRIDS: usize = 2;
/// Times that patches which meet in more than one place are taken apart.
const REPAIRS: usize = 4;

/// A repaired mesh of about `vertices` vertices.
#[must_use]
pub fn coarsened(mesh: &Mesh, vertices: usize) -> Mesh {
    let fine = repaired(mesh);
    let cell = edge_for(area(&fine), vertices.min(u32::MAX as usize) as u32);
    if vertices >= fine.positions.len() || fine.triangles.is_empty() || !(cell > 0.0 && cell.is_finite()) {
        return fine;
    }
    clustered(&fine, cell)
}

/// A mesh of some more than `vertices` vertices: vertices in one cell that face one way are one. In a fraction of the time of [`coarsened`], and
/// without its care for thin things, borders and edges with two triangles.
#[must_use]
pub fn sketched(mesh: &Mesh, vertices: usize) -> Mesh {
    let count = mesh.positions.len();
    let is_whole = mesh.normals.len() == count && mesh.triangles.iter().flatten().all(|i| (*i as usize) < count);
    if vertices >= count || !is_whole {
        return repaired(mesh);
    }
    let cell = edge_for(area(mesh), vertices as u32);
    if !(cell > 0.0 && cell.is_finite()) {
        return repaired(mesh);
    }
    let mut patch_of: Vec<u32> = (0..count as u32).collect();
    let is_usable = |i: usize| mesh.positions[i].is_finite() && mesh.normals[i].is_finite();
    for group in groups(&by_cell(mesh, cell, is_usable)) {
        group.iter().for_each(|of| patch_of[of.vertex] = group[0].vertex as u32);
    }
    joined(mesh, &patch_of, &vec![false; count])
}

/// What the vertices of a patch add up to.
#[derive(Clone, Copy, Default)]
struct Patch {
    position: Vec3,
    /// Vertices in `position`.
    placed: f32,
    on_border: bool,
    normal: Vec3,
}

/// A mesh whose vertices are the means of patches: connected vertices in one cell of a grid of edge `cell`, the normals of neighbours
/// similar. Where a patch is not flat, as on things thinner than a cell, the grid is finer, and in the end its vertices stay,
/// as do those of patches that meet another one in more than one place, so that no edge gets more than two triangles.
/// Patches on a border are placed by their vertices on it, so that the border stays.
#[must_use]
pub fn clustered(mesh: &Mesh, cell: f32) -> Mesh {
    let count = mesh.positions.len();
    let origin = mesh.positions.iter().copied().fold(Vec3::INFINITY, Vec3::min);
    let on_border = on_border(mesh);
    let mut patch_of: Vec<u32> = (0..count as u32).collect();
    let mut open = vec![true; count];
    for grid in 0..GRIDS {
        let edge = cell / (1 << grid) as f32;
        let cells: Vec<IVec3> = mesh.positions.par_iter().map(|p| ((*p - origin) / edge).floor().as_ivec3()).collect();
        let mut unions = Unions::new(count);
        for t in &mesh.triangles {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                let (i, j) = (a as usize, b as usize);
                // An inner edge stands in two triangles, in both directions.
                if (a < b || on_border[i])
                    && open[i]
                    && open[j]
                    && cells[i] == cells[j]
                    && mesh.normals[i].dot(mesh.normals[j]) > AGREEING
                {
                    unions.join(a, b);
                }
            }
        }
        let mut normals = vec![Vec4::ZERO; count];
        for i in (0..count).filter(|&i| open[i]) {
            patch_of[i] = unions.first(i as u32);
            normals[patch_of[i] as usize] += mesh.normals[i].extend(1.0);
        }
        let flat = |sum: Vec4| sum.truncate().length() >= FLAT * sum.w;
        (0..count).for_each(|i| open[i] = open[i] && !flat(normals[patch_of[i] as usize]));
    }
    for i in (0..count).filter(|&i| open[i]) {
        patch_of[i] = i as u32;
    }
    for _ in 0..REPAIRS {
        let pinched = pinched(&between(mesh, &patch_of));
        if pinched.is_empty() {
            break;
        }
        for (i, patch) in (0..).zip(&mut patch_of) {
            if pinched.binary_search(patch).is_ok() {
                *patch = i;
            }
        }
    }
    joined(mesh, &patch_of, &on_border)
}

/// The mesh of the patches.
fn joined(mesh: &Mesh, patch_of: &[u32], on_border: &[bool]) -> Mesh {
    let mut patches = vec![Patch::default(); mesh.positions.len()];
    for (i, patch) in patch_of.iter().enumerate() {
        patches[*patch as usize].add(mesh.positions[i], mesh.normals[i], on_border[i]);
    }
    let positions = patches.iter().map(|p| p.position / p.placed.max(1.0)).collect();
    let normals = patches.iter().map(|p| p.normal.normalize_or(Vec3::Z)).collect();
    usable(&Mesh { positions, normals, triangles: between(mesh, patch_of) })
}

/// Triangles between three patches.
fn between(mesh: &Mesh, patch_of: &[u32]) -> Vec<[u32; 3]> {
    let named = mesh.triangles.par_iter().map(|t| t.map(|i| patch_of[i as usize]));
    named.filter(|[a, b, c]| a != b && b != c && c != a).collect()
}

/// The patches, ascending, that meet another one in more than one place: they have an edge with more than two triangles.
fn pinched(triangles: &[[u32; 3]]) -> Vec<u32> {
    let sides = |&[a, b, c]: &[u32; 3]| [(a, b), (b, c), (c, a)].map(|(a, b)| (a.min(b), a.max(b)));
    let mut edges: Vec<(u32, u32)> = triangles.par_iter().flat_map_iter(sides).collect();
    edges.par_sort_unstable();
    let many = edges.chunk_by(|a, b| a == b).filter(|same| same.len() > 2);
    let mut found: Vec<u32> = many.flat_map(|same| [same[0].0, same[0].1]).collect();
    found.sort_unstable();
    found.dedup();
    found
}

impl Patch {
    fn add(&mut self, position: Vec3, normal: Vec3, on_border: bool) {
        if on_border && !self.on_border {
            (self.position, self.placed, self.on_border) = (Vec3::ZERO, 0.0, true);
        }
        if on_border == self.on_border {
            self.position += position;
            self.placed += 1.0;
        }
        self.normal += normal;
    }
}

/// True for vertices whose triangles do not form closed fans, `[vertex]`.
fn on_border(mesh: &Mesh) -> Vec<bool> {
    // In a closed fan every neighbour follows and precedes another one.
    let mut balance = vec![0_i64; mesh.positions.len()];
    for &[a, b, c] in &mesh.triangles {
        for (at, next, last) in [(a, b, c), (b, c, a), (c, a, b)] {
            balance[at as usize] += i64::from(next) - i64::from(last);
        }
    }
    balance.into_iter().map(|b| b != 0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid of points `at(row, column)` with normals, joined to triangles; closed along the columns if `around`.
    fn grid(rows: u32, columns: u32, around: bool, at: impl Fn(u32, u32) -> (Vec3, Vec3)) -> Mesh {
        let (mut mesh, last) = (Mesh::default(), if around { columns } else { columns - 1 });
        for r in 0..rows {
            for c in 0..columns {
                let (position, normal) = at(r, c);
                mesh.positions.push(position);
                mesh.normals.push(normal);
            }
        }
        for r in 0..rows - 1 {
            for c in 0..last {
                let i = |r: u32, c: u32| r * columns + c % columns;
                mesh.triangles.push([i(r, c), i(r + 1, c), i(r + 1, c + 1)]);
                mesh.triangles.push([i(r, c), i(r + 1, c + 1), i(r, c + 1)]);
            }
        }
        mesh
    }

    fn bounds(mesh: &Mesh) -> (Vec3, Vec3) {
        let fold = |start, f: fn(Vec3, Vec3) -> Vec3| mesh.positions.iter().copied().fold(start, f);
        (fold(Vec3::INFINITY, Vec3::min), fold(Vec3::NEG_INFINITY, Vec3::max))
    }

    #[test]
    fn a_sketch_is_small_and_near_the_surface() {
        let height = |r: u32, c: u32| 3.0 * libm::sinf(r as f32 * 0.1) * libm::cosf(c as f32 * 0.1);
        let mesh = grid(100, 100, false, |r, c| (Vec3::new(r as f32, c as f32, height(r, c)), Vec3::Z));
        let sketch = sketched(&mesh, 400);
        assert!((300..900).contains(&sketch.positions.len()), "{}", sketch.positions.len());
        assert!(sketch.triangles.len() > 400);
        let away = |p: &Vec3| (height(p.x.round() as u32, p.y.round() as u32) - p.z).abs();
        assert!(sketch.positions.iter().all(|p| away(p) < 1.0));
        assert_eq!(sketched(&mesh, 20_000).positions.len(), 10_000, "nothing is left out without need");
        let mut broken = mesh;
        broken.triangles.push([0, 1, 1_000_000]);
        assert!(!sketched(&broken, 400).triangles.is_empty(), "what no vertex has is left out");
    }

    #[test]
    fn sheets_in_one_cell_stay_apart_and_keep_their_borders() {
        let mut mesh = grid(60, 60, false, |r, c| (Vec3::new(r as f32, c as f32, 0.0), Vec3::Z));
        let back = grid(60, 60, false, |r, c| (Vec3::new(c as f32, r as f32, -0.5), Vec3::NEG_Z));
        let n = mesh.positions.len() as u32;
        mesh.positions.extend(&back.positions);
        mesh.normals.extend(&back.normals);
        mesh.triangles.extend(back.triangles.iter().map(|t| t.map(|i| i + n)));
        let coarse = clustered(&mesh, 4.0);
        assert!(coarse.positions.len() < mesh.positions.len() / 8, "{} vertices", coarse.positions.len());
        assert!(
            coarse
                .positions
                .iter()
                .zip(&coarse.normals)
                .all(|(p, n)| *n == if p.z == 0.0 { Vec3::Z } else { Vec3::NEG_Z })
        );
        let ((low, high), (low_before, high_before)) = (bounds(&coarse), bounds(&mesh));
        assert!(low.distance(low_before) < 2.5 && high.distance(high_before) < 2.5, "{low} … {high}");
        let edges = coarse.positions.iter().filter(|p| p.x == 0.0 || p.x == 59.0 || p.y == 0.0 || p.y == 59.0).count();
        assert!(edges > 80, "{edges} vertices on the straight borders");
    }

    #[test]
    fn a_rod_thinner_than_a_cell_keeps_its_thickness() {
        let rod = grid(100, 24, true, |r, c| {
            let (s, k) = libm::sincosf(std::f32::consts::TAU * c as f32 / 24.0);
            (Vec3::new(k, s, 0.25 * r as f32), Vec3::new(k, s, 0.0))
        });
        let coarse = clustered(&rod, 4.0);
        assert!(coarse.positions.len() < rod.positions.len());
        let radius = |p: &Vec3| p.truncate().length();
        assert!(
            coarse.positions.iter().all(|p| radius(p) > 0.8),
            "{:?}",
            coarse.positions.iter().map(radius).reduce(f32::min)
        );
    }
}
