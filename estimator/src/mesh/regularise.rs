//! Mesh regularisation (§3.1): unit normals, no degenerate triangles and, for meshes fused from depth, edges of about one
//! length (isotropic remeshing after Botsch and Kobbelt 2004).

use crate::mesh::cells::{by_cell, groups};
use crate::mesh::surface::Surface;
use crate::numerics::robust::median;
use crate::rays::{Hit, RayScene};
use firmware_config::EstimatorConfig;
use firmware_config::tuning::MeshTuning;
use glam::{IVec3, Vec3};
use rayon::prelude::*;
use recordings::scan::ScanSource;
use recordings::types::Mesh;

/// Smallest cosine between a vertex's normal and the triangle that it is projected to.
const MIN_FACING: f32 = 0.3;

/// The mesh that the estimator works on, in the scan's frame and units.
///
/// A fused mesh is welded, loses its small components and gets edges of `config.regularise` median edges, or longer ones
/// if its area would need more than about `config.max_vertices` vertices. A mesh that is regular already keeps its vertices.
/// An imported mesh keeps its vertices unless `config.regularise` differs from 1: only unusable triangles are dropped and
/// missing normals are computed.
#[must_use]
pub fn regularise(mesh: &Mesh, config: &EstimatorConfig, source: ScanSource) -> Mesh {
    let keep_vertices = match source {
        ScanSource::Photos => config.regularise == 0.0 || config.regularise == 1.0,
        ScanSource::Fusion => config.regularise == 0.0,
    };
    if keep_vertices {
        return repaired(mesh);
    }
    let tuning = &config.tuning.mesh;
    let clean = without_small_components(&welded(&repaired(mesh), tuning.weld_distance as f32), config.speck_share);
    let affordable = edge_for(area(&clean), config.max_vertices);
    let target = (config.regularise as f32 * median(edge_lengths(&clean)).unwrap_or(0.0)).max(affordable);
    let wanted = vertices_for(area(&clean), target);
    let clean = if clean.positions.len() as f64 > tuning.cluster_above * wanted {
        coarsened(&clean, (tuning.cluster_to * wanted) as usize)
    } else {
        clean
    };
    if clean.triangles.is_empty() || !(target > 0.0 && target.is_finite()) {
        return repaired(mesh);
    }
    let outside = |l: &f32| !(0.5 * target..=1.5 * target).contains(l);
    let lengths = edge_lengths(&clean);
    if (lengths.iter().filter(|l| outside(l)).count() as f32) < tuning.irregular_share as f32 * lengths.len() as f32 {
        return clean;
    }
    remesh(&clean, target, tuning)
}

/// A mesh of about `vertices` vertices by clustering: vertices in one cell of a grid that face the same way become one. Much
/// faster than remeshing, but may tear closed surfaces.
#[must_use]
pub fn coarsened(mesh: &Mesh, vertices: usize) -> Mesh {
    let fine = repaired(mesh);
    let cell = edge_for(area(&fine), vertices.min(u32::MAX as usize) as u32);
    if vertices >= fine.positions.len() || fine.triangles.is_empty() || !(cell > 0.0 && cell.is_finite()) {
        return fine;
    }
    let mut cluster = vec![0u32; fine.positions.len()];
    let (mut positions, mut normals) = (Vec::new(), Vec::new());
    for group in groups(&by_cell(&fine, cell, |_| true)) {
        let sum = |of: &[Vec3]| group.iter().map(|k| of[k.vertex]).sum::<Vec3>();
        group.iter().for_each(|k| cluster[k.vertex] = positions.len() as u32);
        positions.push(sum(&fine.positions) / group.len() as f32);
        normals.push(sum(&fine.normals).normalize_or(fine.normals[group[0].vertex]));
    }
    let triangles = fine.triangles.iter().map(|t| t.map(|i| cluster[i as usize])).collect();
    let raw = Mesh { positions, normals, triangles };
    let triangles = usable_triangles(&raw);
    compacted(&raw, triangles)
}

/// Rounds of split, collapse, flip and tangential smoothing towards edges of length `target`.
fn remesh(mesh: &Mesh, target: f32, tuning: &MeshTuning) -> Mesh {
    let (shortest, longest) = (tuning.shortest_edge as f32 * target, tuning.longest_edge as f32 * target);
    let scene = RayScene::new(mesh);
    let limit = tuning.max_growth as usize * mesh.positions.len() + 1000;
    let wanted = vertices_for(area(mesh), target).min(limit as f64);
    let mut surface = Surface::new(mesh.positions.clone(), &mesh.triangles);
    for _ in 0..tuning.remesh_rounds {
        surface.split_long(longest, limit);
        surface.collapse_short(shortest, longest);
        // Edges of any length between the two bounds stay, so their mean depends on the input: correct the count.
        let most = ((1.0 + tuning.count_tolerance) * wanted) as usize;
        surface.collapse_to(most, tuning.longest_edge_to_count as f32 * target);
        surface.split_to(((1.0 - tuning.count_tolerance) * wanted) as usize);
        surface.flip_edges();
        let relaxed = surface.relaxed(0.5);
        let normals = surface.normals();
        surface.positions = relaxed
            .par_iter()
            .zip(&normals)
            .zip(&surface.positions)
            .map(|((p, n), old)| project(mesh, &scene, *p, *n, target).map_or(*old, |hit| hit.0))
            .collect();
    }
    surface.flip_edges();
    let own = surface.normals();
    let normals = surface
        .positions
        .par_iter()
        .zip(&own)
        .map(|(p, n)| {
            let Some((_, hit)) = project(mesh, &scene, *p, *n, target) else { return *n };
            let [a, b, c] = mesh.triangles[hit.triangle as usize].map(|i| mesh.normals[i as usize]);
            let input = a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
            if input.dot(*n) > 0.5 { input.normalize() } else { *n }
        })
        .collect::<Vec<Vec3>>();
    let triangles = surface.triangles();
    let raw = Mesh { positions: surface.positions, normals, triangles };
    let triangles = usable_triangles(&raw);
    compacted(&raw, triangles)
}

/// Edge length at which `vertices` vertices cover an area: an equilateral triangulation has √3/2 edge² per vertex.
fn edge_for(area: f64, vertices: u32) -> f32 {
    (area / (0.75f64.sqrt() * f64::from(vertices))).sqrt() as f32
}

/// Number of vertices that cover an area with edges of a length.
fn vertices_for(area: f64, edge: f32) -> f64 {
    area / (0.75f64.sqrt() * f64::from(edge).powi(2))
}

fn area(mesh: &Mesh) -> f64 {
    let corners = |t: &[u32; 3]| t.map(|i| mesh.positions[i as usize]);
    mesh.triangles.iter().map(corners).map(|[a, b, c]| 0.5 * f64::from((b - a).cross(c - a).length())).sum()
}

/// The point on the input surface along the normal, at most half a target edge away and facing the same way.
fn project(mesh: &Mesh, scene: &RayScene, p: Vec3, normal: Vec3, target: f32) -> Option<(Vec3, Hit)> {
    if normal == Vec3::ZERO {
        return None;
    }
    let reach = 0.5 * target;
    let hit = scene.closest_hit(p + normal * reach, -normal).filter(|h| h.distance <= 2.0 * reach)?;
    let [a, b, c] = mesh.triangles[hit.triangle as usize].map(|i| mesh.positions[i as usize]);
    let same_side = (b - a).cross(c - a).normalize_or_zero().dot(normal) > MIN_FACING;
    same_side.then(|| (p + normal * (reach - hit.distance), hit))
}

/// The same vertices with finite positions and unit normals, and the usable triangles.
fn repaired(mesh: &Mesh) -> Mesh {
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

/// Triangles with three different, finite corners and a positive area, each set of corners once.
fn usable_triangles(mesh: &Mesh) -> Vec<[u32; 3]> {
    let corner = |i: u32| mesh.positions.get(i as usize).copied().filter(|p| p.is_finite());
    let usable = |t: &[u32; 3]| match (corner(t[0]), corner(t[1]), corner(t[2])) {
        (Some(a), Some(b), Some(c)) => (b - a).cross(c - a).length_squared() > 0.0,
        _ => false,
    };
    let mut keyed: Vec<([u32; 3], usize)> = mesh
        .triangles
        .iter()
        .enumerate()
        .filter(|(_, t)| usable(t))
        .map(|(index, t)| {
            let mut key = *t;
            key.sort_unstable();
            (key, index)
        })
        .collect();
    keyed.par_sort_unstable();
    keyed.dedup_by_key(|k| k.0);
    let mut kept: Vec<usize> = keyed.into_iter().map(|k| k.1).collect();
    kept.sort_unstable();
    kept.into_iter().map(|i| mesh.triangles[i]).collect()
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
fn welded(mesh: &Mesh, distance: f32) -> Mesh {
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
fn without_small_components(mesh: &Mesh, share: f64) -> Mesh {
    let mut parent: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    fn root(parent: &mut [u32], mut i: u32) -> u32 {
        while parent[i as usize] != i {
            parent[i as usize] = parent[parent[i as usize] as usize];
            i = parent[i as usize];
        }
        i
    }
    for t in &mesh.triangles {
        for &other in &t[1..] {
            let (a, b) = (root(&mut parent, t[0]), root(&mut parent, other));
            parent[a.max(b) as usize] = a.min(b);
        }
    }
    let roots: Vec<u32> = (0..mesh.positions.len() as u32).map(|i| root(&mut parent, i)).collect();
    let mut sizes = vec![0_u32; mesh.positions.len()];
    roots.iter().for_each(|&r| sizes[r as usize] += 1);
    let least = share * f64::from(sizes.iter().copied().max().unwrap_or(0));
    let big = |t: &&[u32; 3]| f64::from(sizes[roots[t[0] as usize] as usize]) >= least;
    compacted(mesh, mesh.triangles.iter().filter(big).copied().collect())
}

/// The mesh of these triangles, without the vertices that none of them uses.
fn compacted(mesh: &Mesh, mut triangles: Vec<[u32; 3]>) -> Mesh {
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

fn edge_lengths(mesh: &Mesh) -> Vec<f32> {
    let length = |a: u32, b: u32| mesh.positions[a as usize].distance(mesh.positions[b as usize]);
    mesh.triangles.iter().flat_map(|t| [length(t[0], t[1]), length(t[1], t[2]), length(t[2], t[0])]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A unit sphere by latitude and longitude: slivers at the poles, edges of many lengths.
    fn globe(rings: u32, sectors: u32) -> Mesh {
        let mut positions = vec![Vec3::Z, Vec3::NEG_Z];
        for r in 1..rings {
            let (s, c) = libm::sincosf(std::f32::consts::PI * r as f32 / rings as f32);
            for k in 0..sectors {
                let (sa, ca) = libm::sincosf(std::f32::consts::TAU * k as f32 / sectors as f32);
                positions.push(Vec3::new(s * ca, s * sa, c));
            }
        }
        let at = |r: u32, k: u32| 2 + (r - 1) * sectors + k % sectors;
        let mut triangles = Vec::new();
        for k in 0..sectors {
            triangles.push([0, at(1, k), at(1, k + 1)]);
            triangles.push([1, at(rings - 1, k + 1), at(rings - 1, k)]);
            for r in 1..rings - 1 {
                triangles.push([at(r, k), at(r + 1, k), at(r + 1, k + 1)]);
                triangles.push([at(r, k), at(r + 1, k + 1), at(r, k + 1)]);
            }
        }
        Mesh { normals: positions.clone(), positions, triangles }
    }

    /// Vertices − edges + triangles, and the number of edges without exactly two triangles.
    fn topology(mesh: &Mesh) -> (i64, usize) {
        let mut edges = std::collections::BTreeMap::new();
        for t in &mesh.triangles {
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                *edges.entry((a.min(b), a.max(b))).or_insert(0) += 1;
            }
        }
        let euler = mesh.positions.len() as i64 - edges.len() as i64 + mesh.triangles.len() as i64;
        (euler, edges.values().filter(|n| **n != 2).count())
    }

    #[test]
    fn slivers_are_removed_and_the_surface_is_kept() {
        let globe = globe(60, 160);
        let mesh = regularise(&globe, &EstimatorConfig::default(), ScanSource::Fusion);
        assert_eq!(topology(&mesh), (2, 0), "a closed sphere stays closed");
        let target = median(edge_lengths(&globe)).unwrap();
        let mut lengths = edge_lengths(&mesh);
        lengths.sort_by(f32::total_cmp);
        let (low, high) = (lengths[lengths.len() / 50], lengths[lengths.len() - lengths.len() / 50]);
        assert!(low > 0.6 * target && high < 1.5 * target, "{low} … {high} around {target}");
        for (p, n) in mesh.positions.iter().zip(&mesh.normals) {
            assert!((p.length() - 1.0).abs() < 2e-3, "off the sphere by {}", p.length() - 1.0);
            assert!(n.dot(p.normalize()) > 0.99);
        }
        assert_eq!(mesh, regularise(&globe, &EstimatorConfig::default(), ScanSource::Fusion));
    }

    #[test]
    fn vertices_are_limited_by_max_vertices() {
        let config = EstimatorConfig { max_vertices: 2000, ..Default::default() };
        let mesh = regularise(&globe(60, 160), &config, ScanSource::Fusion);
        assert_eq!(topology(&mesh), (2, 0));
        let vertices = mesh.positions.len();
        assert!((1900..=2100).contains(&vertices), "{vertices} vertices for about 2000");
        assert!(mesh.positions.iter().all(|p| (p.length() - 1.0).abs() < 5e-3));
    }

    /// Bounds on edge lengths alone give too many vertices from some inputs and too few from others.
    #[test]
    fn the_requested_number_of_vertices_is_reached() {
        for asked in [2500, 4000, 6000, 10_000, 16_000, 25_000] {
            let config = EstimatorConfig { max_vertices: asked, regularise: 0.1, ..Default::default() };
            let mesh = regularise(&globe(60, 160), &config, ScanSource::Fusion);
            assert_eq!(topology(&mesh), (2, 0));
            let off = mesh.positions.len() as f64 / f64::from(asked) - 1.0;
            assert!(off.abs() < 0.05, "{} vertices for {asked}", mesh.positions.len());
            let target = edge_for(area(&mesh), asked);
            let mut lengths = edge_lengths(&mesh);
            lengths.sort_by(f32::total_cmp);
            let (low, high) = (lengths[lengths.len() / 50], lengths[lengths.len() - lengths.len() / 50]);
            assert!(low > 0.5 * target && high < 1.5 * target, "{low} … {high} around {target}");
        }
    }

    #[test]
    fn clustering_keeps_the_shape() {
        let fine = globe(100, 200);
        let coarse = coarsened(&fine, 2000);
        let n = coarse.positions.len();
        assert!((1000..4000).contains(&n), "{n} vertices");
        assert!(coarse.positions.iter().all(|p| (p.length() / fine.positions[500].length() - 1.0).abs() < 0.02));
        assert!(coarse.positions.iter().zip(&coarse.normals).all(|(p, n)| n.dot(p.normalize()) > 0.9));
    }

    #[test]
    fn imported_and_regular_meshes_keep_their_vertices() {
        let mut imported = globe(20, 40);
        imported.triangles.push([3, 3, 4]);
        let kept = regularise(&imported, &EstimatorConfig::default(), ScanSource::Photos);
        assert_eq!(kept.positions, imported.positions);
        assert_eq!(kept.triangles.len(), imported.triangles.len() - 1);
        let regular = regularise(&globe(60, 160), &EstimatorConfig::default(), ScanSource::Fusion);
        let again = regularise(&regular, &EstimatorConfig::default(), ScanSource::Fusion);
        assert_eq!(again.positions, regular.positions);
    }

    #[test]
    fn small_components_are_dropped_and_seams_welded() {
        let mut mesh = globe(60, 160);
        let n = mesh.positions.len() as u32;
        // A small component, and the sphere's first triangle on vertices of its own.
        mesh.positions.extend([Vec3::splat(3.0), Vec3::splat(3.1), Vec3::new(3.0, 3.1, 3.0)]);
        mesh.normals.extend([Vec3::Z; 3]);
        mesh.triangles.push([n, n + 1, n + 2]);
        let corners = mesh.triangles[0];
        for c in corners {
            mesh.positions.push(mesh.positions[c as usize]);
            mesh.normals.push(mesh.normals[c as usize]);
        }
        mesh.triangles[0] = [n + 3, n + 4, n + 5];
        let out = regularise(&mesh, &EstimatorConfig::default(), ScanSource::Fusion);
        assert_eq!(topology(&out), (2, 0));
        assert!(out.positions.iter().all(|p| p.length() < 1.1));
    }
}
