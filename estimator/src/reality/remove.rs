//! Taking things out: which part of the mesh goes, and what is behind it.

use super::object::vertex_normals;
use super::{RealityError, Result};
use crate::scene::Scene;
use glam::Vec3;
use recordings::types::Mesh;
use std::collections::BTreeMap;

/// What is to go.
#[derive(Debug, Clone, PartialEq)]
pub enum Removal {
    /// Every vertex of a segment.
    Segment(u32),
    /// Every vertex in a box: lowest and highest corner.
    Box(Vec3, Vec3),
    /// What a ray hits: its whole connected piece if that is a small part of the scan, otherwise its segment's patch.
    Ray {
        /// Start.
        origin: Vec3,
        /// Unit direction.
        direction: Vec3,
    },
}

/// A connected piece with more of the vertices than this is the scene, not a thing in it.
const LARGEST_THING: f64 = 0.3;
/// Sweeps of the membrane over what is unknown.
const SWEEPS: usize = 400;

/// Vertices that share a triangle: `neighbours[offsets[v]..offsets[v + 1]]`, ascending.
#[derive(Debug)]
pub struct Adjacency {
    offsets: Vec<u32>,
    neighbours: Vec<u32>,
}

impl Adjacency {
    /// Of a mesh's triangles.
    #[must_use]
    pub fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        let mut pairs: Vec<(u32, u32)> =
            triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, a), (b, c), (c, b), (c, a), (a, c)]).collect();
        pairs.sort_unstable();
        pairs.dedup();
        let mut offsets = vec![0u32; vertices + 1];
        pairs.iter().for_each(|(a, _)| offsets[*a as usize + 1] += 1);
        for v in 0..vertices {
            offsets[v + 1] += offsets[v];
        }
        Self { offsets, neighbours: pairs.into_iter().map(|(_, b)| b).collect() }
    }

    /// Neighbours of a vertex.
    #[must_use]
    pub fn of(&self, vertex: usize) -> &[u32] {
        &self.neighbours[self.offsets[vertex] as usize..self.offsets[vertex + 1] as usize]
    }

    /// What is not yet `done` and connected to `start`; all of it is done then.
    pub fn patch(&self, start: usize, done: &mut [bool]) -> Vec<usize> {
        let mut list = vec![start];
        done[start] = true;
        let mut next = 0;
        while next < list.len() {
            for &n in self.of(list[next]) {
                if !done[n as usize] {
                    done[n as usize] = true;
                    list.push(n as usize);
                }
            }
            next += 1;
        }
        list
    }

    /// Everything connected to `start` through vertices that `may` be passed.
    fn flood(&self, start: usize, may: impl Fn(usize) -> bool) -> Vec<bool> {
        let mut inside = vec![false; self.offsets.len() - 1];
        let mut open = vec![start];
        inside[start] = true;
        while let Some(v) = open.pop() {
            for &n in self.of(v) {
                if !inside[n as usize] && may(n as usize) {
                    inside[n as usize] = true;
                    open.push(n as usize);
                }
            }
        }
        inside
    }
}

/// Vertices that a list of removals takes away.
///
/// # Errors
/// A segment that does not exist, a ray or a box that meets nothing, or nothing left.
pub fn select(mesh: &Mesh, segment: &[u32], scene: &Scene, removals: &[Removal]) -> Result<Vec<bool>> {
    let n = mesh.positions.len();
    let adjacency = Adjacency::new(n, &mesh.triangles);
    let mut gone = vec![false; n];
    for removal in removals {
        let chosen: Vec<bool> = match removal {
            Removal::Segment(id) => segment.iter().map(|s| s == id).collect(),
            Removal::Box(low, high) => {
                mesh.positions.iter().map(|p| p.cmpge(*low).all() && p.cmple(*high).all()).collect()
            }
            Removal::Ray { origin, direction } => {
                let hit = scene.closest_hit(*origin, *direction).ok_or_else(|| {
                    RealityError::Request("nothing of the scan is under the point that is to be removed".into())
                })?;
                let start = mesh.triangles[hit.triangle as usize][0] as usize;
                let piece = adjacency.flood(start, |_| true);
                if piece.iter().filter(|x| **x).count() as f64 <= LARGEST_THING * n as f64 {
                    piece
                } else {
                    adjacency.flood(start, |v| segment[v] == segment[start])
                }
            }
        };
        if !chosen.iter().any(|c| *c) {
            return Err(RealityError::Request(match removal {
                Removal::Segment(id) => {
                    let most = segment.iter().max().copied().unwrap_or(0);
                    format!("there is no segment {id} in this result (they go from 0 to {most})")
                }
                _ => "the box holds no part of the scan".into(),
            }));
        }
        gone.iter_mut().zip(chosen).for_each(|(g, c)| *g |= c);
    }
    if gone.iter().all(|g| *g) {
        return Err(RealityError::Request("the removal would take everything: nothing would be left to show".into()));
    }
    Ok(gone)
}

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
}

/// Cuts the vertices `gone` away and closes the holes that this leaves, so that what stood on a surface does not take a
/// piece of it along.
#[must_use]
pub fn cut(mesh: &Mesh, gone: &[bool]) -> Cut {
    let goes = |t: &[u32; 3]| t.iter().any(|&i| gone[i as usize]);
    let (away, stay): (Vec<[u32; 3]>, Vec<[u32; 3]>) = mesh.triangles.iter().partition(|t| goes(t));
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
    for ring in rings(&away, gone) {
        close(&mut kept, &ring);
    }
    Cut { kept, first_patch, removed, removed_from }
}

/// Closed chains of edges between triangles that go and triangles that stay, in the direction of those that went.
fn rings(away: &[[u32; 3]], gone: &[bool]) -> Vec<Vec<u32>> {
    let mut edges = BTreeMap::new();
    for &[a, b, c] in away {
        for (x, y) in [(a, b), (b, c), (c, a)] {
            if !gone[x as usize] && !gone[y as usize] {
                edges.insert((x, y), ());
            }
        }
    }
    // An edge between two triangles that both went is no border.
    let border: BTreeMap<u32, u32> =
        edges.keys().filter(|(x, y)| !edges.contains_key(&(*y, *x))).map(|&(x, y)| (x, y)).collect();
    let mut used = std::collections::BTreeSet::new();
    let mut rings = Vec::new();
    for &start in border.keys() {
        let mut ring = Vec::new();
        let mut at = start;
        while used.insert(at) {
            ring.push(at);
            match border.get(&at) {
                Some(&next) => at = next,
                None => break,
            }
        }
        if ring.len() >= 3 && at == start {
            rings.push(ring);
        }
    }
    rings
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
    let adjacency = Adjacency::new(mesh.positions.len(), &mesh.triangles[added..]);
    for _ in 0..SWEEPS {
        for v in first..mesh.positions.len() {
            let around = adjacency.of(v);
            if !around.is_empty() {
                mesh.positions[v] =
                    around.iter().map(|&i| mesh.positions[i as usize]).sum::<Vec3>() / around.len() as f32;
            }
        }
    }
    let normals = vertex_normals(&mesh.positions, &mesh.triangles[added..]);
    mesh.normals[first..].copy_from_slice(&normals[first..]);
}

/// Carries values over the vertices that are not `known`: first from the nearest known ones, then relaxed to a membrane
/// (each the mean of its neighbours).
pub fn inpaint(values: &mut [Vec3], known: &[bool], adjacency: &Adjacency) {
    let mut have = known.to_vec();
    let mut order = Vec::new();
    let mut front: Vec<usize> = (0..have.len()).filter(|&v| have[v]).collect();
    while !front.is_empty() {
        let mut next: Vec<usize> =
            front.iter().flat_map(|&v| adjacency.of(v)).map(|&v| v as usize).filter(|&v| !have[v]).collect();
        next.sort_unstable();
        next.dedup();
        for &v in &next {
            let around: Vec<Vec3> =
                adjacency.of(v).iter().filter(|&&n| have[n as usize]).map(|&n| values[n as usize]).collect();
            values[v] = around.iter().sum::<Vec3>() / around.len().max(1) as f32;
        }
        next.iter().for_each(|&v| have[v] = true);
        order.extend(&next);
        front = next;
    }
    let sweeps = if order.len() > 50_000 { SWEEPS / 8 } else { SWEEPS };
    for sweep in 0..sweeps {
        let mut relax = |v: usize| {
            let around = adjacency.of(v);
            values[v] = around.iter().map(|&n| values[n as usize]).sum::<Vec3>() / around.len().max(1) as f32;
        };
        if sweep & 1 == 0 { order.iter().for_each(|&v| relax(v)) } else { order.iter().rev().for_each(|&v| relax(v)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A plane of n × n quads with a bump of segment 1 in its middle, one surface.
    fn bumpy(n: u32) -> (Mesh, Vec<u32>) {
        let mut positions = Vec::new();
        let mut segment = Vec::new();
        for y in 0..=n {
            for x in 0..=n {
                let (u, v) = (x as f32 / n as f32 - 0.5, y as f32 / n as f32 - 0.5);
                let bump = u.abs() < 0.2 && v.abs() < 0.2;
                positions.push(Vec3::new(u, v, if bump { 0.2 } else { 0.0 }));
                segment.push(u32::from(bump));
            }
        }
        let mut triangles = Vec::new();
        for y in 0..n {
            for x in 0..n {
                let a = y * (n + 1) + x;
                triangles.extend([[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]);
            }
        }
        let normals = vertex_normals(&positions, &triangles);
        (Mesh { positions, normals, triangles }, segment)
    }

    #[test]
    fn the_support_is_closed_flat_where_a_thing_stood_on_it() {
        let (mesh, segment) = bumpy(20);
        let scene = Scene::new(&mesh);
        let gone = select(&mesh, &segment, &scene, &[Removal::Segment(1)]).unwrap();
        let cut = cut(&mesh, &gone);
        let closed = Scene::new(&cut.kept);
        for (x, y) in [(0.0, 0.0), (0.13, -0.1), (-0.19, 0.19), (0.3, 0.01)] {
            let hit = closed.closest_hit(Vec3::new(x, y, 1.0), Vec3::NEG_Z).expect("closed");
            assert!((hit.distance - 1.0).abs() < 1e-3, "{x} {y}: {}", hit.distance);
        }
        assert!(cut.kept.normals[cut.first_patch..].iter().all(|n| n.z > 0.99));
    }

    #[test]
    fn removals_that_make_no_sense_are_refused() {
        let (mesh, segment) = bumpy(8);
        let scene = Scene::new(&mesh);
        let say = |r: Removal| select(&mesh, &segment, &scene, &[r]).unwrap_err().to_string();
        assert!(say(Removal::Segment(9)).contains("no segment 9"));
        assert!(say(Removal::Box(Vec3::splat(5.0), Vec3::splat(6.0))).contains("no part"));
        assert!(say(Removal::Box(Vec3::splat(-5.0), Vec3::splat(6.0))).contains("everything"));
        let up = Removal::Ray { origin: Vec3::new(0.0, 0.0, 2.0), direction: Vec3::Z };
        assert!(say(up).contains("nothing of the scan"));
    }

    #[test]
    fn a_membrane_continues_a_gradient() {
        let (mesh, _) = bumpy(16);
        let adjacency = Adjacency::new(mesh.positions.len(), &mesh.triangles);
        let truth: Vec<Vec3> = mesh.positions.iter().map(|p| Vec3::splat(1.0 + p.x)).collect();
        let known: Vec<bool> = mesh.positions.iter().map(|p| p.x.abs().max(p.y.abs()) > 0.3).collect();
        let mut values: Vec<Vec3> = truth.iter().zip(&known).map(|(t, k)| if *k { *t } else { Vec3::ZERO }).collect();
        inpaint(&mut values, &known, &adjacency);
        for (v, t) in values.iter().zip(&truth) {
            assert!((*v - *t).abs().max_element() < 0.02, "{v} {t}");
        }
    }
}
