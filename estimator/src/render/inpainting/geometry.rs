//! Cuts a part of a surface away and closes what that leaves open.

use crate::mesh::graph::Graph;
use crate::render::inpainting::membrane::SWEEPS;
use firmware_config::tuning::InpaintingTuning;
use glam::Vec3;
use recordings::types::{Mesh, vertex_normals};
use std::collections::BTreeMap;

/// A mesh cut in two. Vertices of `kept` are those of the whole, in order, then the patches'; `removed` has its own.
#[derive(Debug)]
pub struct Cut {
    /// What stays, holes closed.
    pub kept: Mesh,
    /// Vertices of `kept` from here on are patches over holes.
    pub first_patch: usize,
    /// What goes.
    pub removed: Mesh,
    /// Index in the whole mesh of each vertex of `removed`.
    pub removed_from: Vec<u32>,
    /// Index in the whole mesh of each triangle of `kept` but the patches, which stand behind.
    pub kept_triangles: Vec<u32>,
    /// Index in the whole mesh of each triangle of `removed`.
    pub removed_triangles: Vec<u32>,
}

/// Cuts the vertices `gone` away and closes the holes that this leaves.
#[must_use]
pub fn cut(mesh: &Mesh, gone: &[bool], tuning: &InpaintingTuning) -> Cut {
    let goes = |t: &[u32; 3]| t.iter().any(|&i| gone[i as usize]);
    let all = 0..mesh.triangles.len() as u32;
    let (removed_triangles, kept_triangles): (Vec<u32>, Vec<u32>) =
        all.partition(|t| goes(&mesh.triangles[*t as usize]));
    let of = |list: &[u32]| -> Vec<[u32; 3]> { list.iter().map(|t| mesh.triangles[*t as usize]).collect() };
    let (away, stay) = (of(&removed_triangles), of(&kept_triangles));
    let mut index = vec![u32::MAX; mesh.positions.len()];
    let mut removed_from = Vec::new();
    for &i in away.iter().flatten() {
        if index[i as usize] == u32::MAX {
            index[i as usize] = removed_from.len() as u32;
            removed_from.push(i);
        }
    }
    let removed = Mesh {
        positions: removed_from.iter().map(|&i| mesh.positions[i as usize]).collect(),
        normals: removed_from.iter().map(|&i| mesh.normals[i as usize]).collect(),
        triangles: away.iter().map(|t| t.map(|i| index[i as usize])).collect(),
    };
    let mut kept = Mesh { positions: mesh.positions.clone(), normals: mesh.normals.clone(), triangles: stay };
    let first_patch = kept.positions.len();
    let mut edges: Vec<f32> = removed
        .triangles
        .iter()
        .map(|t| removed.positions[t[0] as usize].distance(removed.positions[t[1] as usize]))
        .collect();
    edges.sort_by(f32::total_cmp);
    if let Some(edge) = edges.get(edges.len() / 2) {
        for ring in rings(&kept, &removed, &index, *edge, tuning) {
            close(&mut kept, &ring);
        }
    }
    Cut { kept, first_patch, removed, removed_from, kept_triangles, removed_triangles }
}

/// Open borders of the kept mesh that the removed part left or hid: an object's contact with its support is seldom
/// observed, so a hole was there before. Against the direction of the triangles that stay. `index` is not `u32::MAX` at vertices of what was removed.
fn rings(kept: &Mesh, removed: &Mesh, index: &[u32], edge: f32, tuning: &InpaintingTuning) -> Vec<Vec<u32>> {
    let (hidden_edges, touching_edges) = (tuning.hidden_edges as f32, tuning.touching_edges as f32);
    let graph = Graph::of(removed);
    let mut done = vec![false; removed.positions.len()];
    let mut boxes: Vec<(Vec3, Vec3)> = Vec::new();
    for start in 0..done.len() {
        if !done[start] {
            let of = graph.component(start, &mut done).into_iter().map(|v| removed.positions[v]);
            let (low, high) = of.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
            boxes.push((low, high));
        }
    }
    let about = |v: u32, edges: f32| {
        let (p, margin) = (kept.positions[v as usize], edges * edge);
        boxes.iter().any(|(low, high)| p.cmpge(*low - margin).all() && p.cmple(*high + margin).all())
    };
    let mut rings: Vec<Vec<u32>> = Vec::new();
    for border in borders(&kept.triangles) {
        let touches = border.iter().any(|&v| index[v as usize] != u32::MAX);
        let hidden = || border.iter().filter(|v| about(**v, hidden_edges)).count() * 2 >= border.len();
        if hidden() {
            rings.push(border);
        } else if touches {
            rings.push(border.into_iter().filter(|v| about(*v, touching_edges)).collect());
        }
    }
    rings.retain(|ring| ring.len() >= 3);
    rings
}

/// Closed chains of the edges of one triangle only, against that triangle's direction.
fn borders(triangles: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let mut edges: Vec<(u32, u32)> = triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]).collect();
    edges.sort_unstable();
    let mut next: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for &(a, b) in edges.iter().filter(|(a, b)| edges.binary_search(&(*b, *a)).is_err()) {
        next.entry(b).or_default().push(a);
    }
    let mut chains = Vec::new();
    while let Some((&start, _)) = next.first_key_value() {
        let mut chain = vec![start];
        let mut at = start;
        while let Some(list) = next.get_mut(&at) {
            let Some(to) = list.pop() else { break };
            if list.is_empty() {
                next.remove(&at);
            }
            if to == start {
                break;
            }
            chain.push(to);
            at = to;
        }
        chains.push(chain);
    }
    chains
}

/// Closes a ring with concentric rings that shrink to its middle, relaxed to a membrane.
fn close(mesh: &mut Mesh, ring: &[u32]) {
    let n = ring.len();
    let points: Vec<Vec3> = ring.iter().map(|&i| mesh.positions[i as usize]).collect();
    let middle = points.iter().sum::<Vec3>() / n as f32;
    let edge = (0..n).map(|i| points[i].distance(points[(i + 1) % n])).sum::<f32>() / n as f32;
    let radius = points.iter().map(|p| p.distance(middle)).sum::<f32>() / n as f32;
    let levels = ((radius / edge.max(f32::MIN_POSITIVE)) as usize).clamp(1, 64);
    let first = mesh.positions.len();
    let mut outer: Vec<u32> = ring.to_vec();
    for level in 1..levels {
        let f = level as f32 / levels as f32;
        let inner: Vec<u32> = (0..n).map(|i| (mesh.positions.len() + i) as u32).collect();
        mesh.positions.extend(points.iter().map(|p| p.lerp(middle, f)));
        for i in 0..n {
            let j = (i + 1) % n;
            mesh.triangles.extend([[outer[i], outer[j], inner[i]], [outer[j], inner[j], inner[i]]]);
        }
        outer = inner;
    }
    let tip = mesh.positions.len() as u32;
    mesh.positions.push(middle);
    mesh.triangles.extend((0..n).map(|i| [outer[i], outer[(i + 1) % n], tip]));
    mesh.normals.resize(mesh.positions.len(), Vec3::Z);
    let added = mesh.triangles.len() - (2 * n * (levels - 1) + n);
    let graph = Graph::new(mesh.positions.len(), &mesh.triangles[added..]);
    for _ in 0..SWEEPS {
        for v in first..mesh.positions.len() {
            let around = graph.neighbours(v);
            if !around.is_empty() {
                mesh.positions[v] =
                    around.iter().map(|&i| mesh.positions[i as usize]).sum::<Vec3>() / around.len() as f32;
            }
        }
    }
    let normals = vertex_normals(&mesh.positions, &mesh.triangles[added..]);
    mesh.normals[first..].copy_from_slice(&normals[first..]);
}
