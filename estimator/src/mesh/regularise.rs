//! Mesh regularisation (§3.1): unit normals, no degenerate triangles and, for meshes fused from depth, edges of about one
//! length (isotropic remeshing after Botsch and Kobbelt 2004).

use crate::mesh::clustering::clustered;
use crate::mesh::repair::{area, edge_for, edge_lengths, repaired, usable, welded, without_small_components};
use crate::mesh::surface::Surface;
use crate::numerics::robust::median;
use crate::rays::{Hit, RayScene};
use firmware_config::EstimatorConfig;
use firmware_config::tuning::MeshTuning;
use glam::Vec3;
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
    let (area, lengths) = (area(&clean), edge_lengths(&clean));
    let affordable = edge_for(area, config.max_vertices);
    let target = (config.regularise as f32 * median(lengths.iter().copied()).unwrap_or(0.0)).max(affordable);
    if clean.triangles.is_empty() || !(target > 0.0 && target.is_finite()) {
        return repaired(mesh);
    }
    let outside = |l: &&f32| !(0.5 * target..=1.5 * target).contains(*l);
    if (lengths.iter().filter(outside).count() as f32) < tuning.irregular_share as f32 * lengths.len() as f32 {
        return clean;
    }
    drop(lengths);
    let wanted = vertices_for(area, target);
    if clean.positions.len() as f64 <= tuning.cluster_above * wanted {
        return remesh(&clean, target, wanted, tuning);
    }
    // Patches may leave specks where they meet in a point.
    let coarse = without_small_components(
        &clustered(&clean, edge_for(area, (tuning.cluster_to * wanted) as u32)),
        config.speck_share,
    );
    drop(clean);
    remesh(&coarse, target, wanted, tuning)
}

/// Rounds of split, collapse, flip and tangential smoothing towards `wanted` vertices with edges of length `target`.
fn remesh(mesh: &Mesh, target: f32, wanted: f64, tuning: &MeshTuning) -> Mesh {
    let (shortest, longest) = (tuning.shortest_edge as f32 * target, tuning.longest_edge as f32 * target);
    let limit = tuning.max_growth as usize * mesh.positions.len() + 1000;
    let wanted = wanted.min(limit as f64);
    let reshape = |surface: &mut Surface| {
        surface.split_long(longest, limit);
        surface.collapse_short(shortest, longest);
        // Edges of any length between the two bounds stay, so their mean depends on the input: correct the count.
        let most = ((1.0 + tuning.count_tolerance) * wanted) as usize;
        surface.collapse_to(most, tuning.longest_edge_to_count as f32 * target);
        surface.split_to(((1.0 - tuning.count_tolerance) * wanted) as usize);
        surface.flip_edges();
    };
    let first = || {
        let mut surface = Surface::new(mesh.positions.clone(), &mesh.triangles);
        (0..tuning.remesh_rounds.min(1)).for_each(|_| reshape(&mut surface));
        surface
    };
    let (scene, mut surface) = rayon::join(|| RayScene::new(mesh), first);
    for round in 0..tuning.remesh_rounds {
        if round > 0 {
            reshape(&mut surface);
        }
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
    usable(&Mesh { positions: surface.positions, normals, triangles })
}

/// Number of vertices that cover an area with edges of a length.
fn vertices_for(area: f64, edge: f32) -> f64 {
    area / (0.75f64.sqrt() * f64::from(edge).powi(2))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::clustering::coarsened;

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
    fn threads_do_not_change_the_mesh() {
        let (globe, config) = (globe(100, 200), EstimatorConfig { max_vertices: 4000, ..Default::default() });
        let of = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| regularise(&globe, &config, ScanSource::Fusion))
        };
        let one = of(1);
        assert!(globe.positions.len() > 4 * one.positions.len(), "the globe is clustered");
        assert_eq!(one, of(3));
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
