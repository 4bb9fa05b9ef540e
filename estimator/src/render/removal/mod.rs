//! Taking things out: which part of the mesh goes, and what its neighbourhood continues into its place.

pub mod object_extraction;

use crate::mesh::graph::Graph;
use crate::rays::RayScene;
use crate::render::RealityError;
use crate::render::Result;
use crate::render::removal::object_extraction::{grown, thing};
use glam::Vec3;
use recordings::types::Mesh;

/// What is to go.
#[derive(Debug, Clone, PartialEq)]
pub enum Removal {
    /// Every vertex of a segment; the whole thing where that is most of it, and what would be left hanging in the air.
    Segment(u32),
    /// Every vertex in a box: lowest and highest corner.
    Box(Vec3, Vec3),
    /// What a ray hits: the thing that rises from its support there, or a connected piece that is a small part of the
    /// scan; where neither is to be told, its segment's patch.
    Ray {
        /// Start.
        origin: Vec3,
        /// Unit direction.
        direction: Vec3,
    },
}

/// A connected piece with more of the vertices than this is the scene, not a thing in it.
const LARGEST_PIECE: f64 = 0.3;
/// Share of a thing from which on a segment stands for all of it.
const MOST_OF_IT: f64 = 0.5;
/// Pieces that lose their hold with a segment go with it up to this share of its size.
const CRUMBS: f64 = 0.1;
/// Sweeps of the membrane over what is unknown.
pub const SWEEPS: usize = 400;

/// Vertices that a list of removals takes away.
///
/// # Errors
/// A segment that does not exist, a ray or a box that meets nothing, or nothing left.
pub fn select(mesh: &Mesh, segment: &[u32], scene: &RayScene, removals: &[Removal]) -> Result<Vec<bool>> {
    let n = mesh.positions.len();
    let graph = Graph::of(mesh);
    let mut gone = vec![false; n];
    let edge = scene.median_edge();
    let count = |set: &[bool]| set.iter().filter(|x| **x).count();
    for removal in removals {
        let chosen: Vec<bool> = match removal {
            Removal::Segment(id) => {
                let mut members: Vec<bool> = segment.iter().map(|s| s == id).collect();
                if let Some(whole) = middle(mesh, &members).and_then(|seed| thing(mesh, &graph, edge, seed)) {
                    let shared = (0..n).filter(|&v| whole[v] && members[v]).count();
                    if shared as f64 >= MOST_OF_IT * count(&whole) as f64 {
                        members.iter_mut().zip(grown(&whole, &graph)).for_each(|(m, w)| *m |= w);
                    }
                }
                with_crumbs(members, &graph)
            }
            Removal::Box(low, high) => {
                mesh.positions.iter().map(|p| p.cmpge(*low).all() && p.cmple(*high).all()).collect()
            }
            Removal::Ray { origin, direction } => {
                let hit = scene.closest_hit(*origin, *direction).ok_or_else(|| {
                    RealityError::Request("nothing of the scan is under the point that is to be removed".into())
                })?;
                let start = mesh.triangles[hit.triangle as usize][0] as usize;
                let piece = graph.flood(start, |_| true);
                if count(&piece) as f64 <= LARGEST_PIECE * n as f64 {
                    piece
                } else {
                    let patch = || with_crumbs(graph.flood(start, |v| segment[v] == segment[start]), &graph);
                    thing(mesh, &graph, edge, start).map_or_else(patch, |whole| grown(&whole, &graph))
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

/// The member nearest to the middle of all members.
fn middle(mesh: &Mesh, members: &[bool]) -> Option<usize> {
    let of = || (0..members.len()).filter(|&v| members[v]);
    let middle = of().map(|v| mesh.positions[v]).sum::<Vec3>() / of().count().max(1) as f32;
    of().min_by(|&a, &b| mesh.positions[a].distance(middle).total_cmp(&mesh.positions[b].distance(middle)))
}

/// With the small pieces that only the members held.
fn with_crumbs(mut members: Vec<bool>, graph: &Graph) -> Vec<bool> {
    let size = members.iter().filter(|m| **m).count();
    let mut done = members.clone();
    let rim: Vec<usize> =
        (0..members.len()).filter(|&v| members[v]).flat_map(|v| graph.neighbours(v)).map(|&v| v as usize).collect();
    for v in rim {
        if !done[v] {
            let piece = graph.component(v, &mut done);
            if piece.len() as f64 <= CRUMBS * size as f64 {
                piece.into_iter().for_each(|p| members[p] = true);
            }
        }
    }
    members
}

/// Carries values over the vertices that are not `known`: first from the nearest known ones, then relaxed to a membrane
/// (each the mean of its neighbours).
pub fn inpaint(values: &mut [Vec3], known: &[bool], graph: &Graph) {
    let mut have = known.to_vec();
    let mut order = Vec::new();
    let mut front: Vec<usize> = (0..have.len()).filter(|&v| have[v]).collect();
    while !front.is_empty() {
        let mut next: Vec<usize> =
            front.iter().flat_map(|&v| graph.neighbours(v)).map(|&v| v as usize).filter(|&v| !have[v]).collect();
        next.sort_unstable();
        next.dedup();
        for &v in &next {
            let around: Vec<Vec3> =
                graph.neighbours(v).iter().filter(|&&n| have[n as usize]).map(|&n| values[n as usize]).collect();
            values[v] = around.iter().sum::<Vec3>() / around.len().max(1) as f32;
        }
        next.iter().for_each(|&v| have[v] = true);
        order.extend(&next);
        front = next;
    }
    let sweeps = if order.len() > 50_000 { SWEEPS / 8 } else { SWEEPS };
    for sweep in 0..sweeps {
        let mut relax = |v: usize| {
            let around = graph.neighbours(v);
            values[v] = around.iter().map(|&n| values[n as usize]).sum::<Vec3>() / around.len().max(1) as f32;
        };
        if sweep & 1 == 0 { order.iter().for_each(|&v| relax(v)) } else { order.iter().rev().for_each(|&v| relax(v)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::inpainting::geometry::cut;
    use recordings::types::vertex_normals;

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
        let scene = RayScene::new(&mesh);
        let gone = select(&mesh, &segment, &scene, &[Removal::Segment(1)]).unwrap();
        let cut = cut(&mesh, &gone);
        let closed = RayScene::new(&cut.kept);
        for (x, y) in [(0.0, 0.0), (0.13, -0.1), (-0.19, 0.19), (0.3, 0.01)] {
            let hit = closed.closest_hit(Vec3::new(x, y, 1.0), Vec3::NEG_Z).expect("closed");
            assert!((hit.distance - 1.0).abs() < 1e-3, "{x} {y}: {}", hit.distance);
        }
        assert!(cut.kept.normals[cut.first_patch..].iter().all(|n| n.z > 0.99));
    }

    #[test]
    fn a_thing_of_several_segments_goes_whole_and_its_support_stays() {
        let (mesh, mut segment) = bumpy(40);
        let part = |share: f32, segment: &mut [u32]| {
            for (s, p) in segment.iter_mut().zip(&mesh.positions).filter(|(s, _)| **s > 0) {
                *s = if p.x < share { 1 } else { 2 };
            }
        };
        let scene = RayScene::new(&mesh);
        let check = |gone: &[bool]| {
            for (gone, p) in gone.iter().zip(&mesh.positions) {
                let inside = p.x.abs().max(p.y.abs());
                assert!(if p.z > 0.1 { *gone } else { !*gone || inside < 0.31 }, "{p} {gone}");
            }
        };
        part(0.0, &mut segment);
        let down = Removal::Ray { origin: Vec3::new(0.1, 0.02, 2.0), direction: Vec3::NEG_Z };
        check(&select(&mesh, &segment, &scene, &[down]).unwrap());
        // One of two parts is not all of it; one that is most of it is.
        let half = select(&mesh, &segment, &scene, &[Removal::Segment(1)]).unwrap();
        assert!(half.iter().zip(&segment).all(|(g, s)| *g == (*s == 1)));
        part(0.12, &mut segment);
        check(&select(&mesh, &segment, &scene, &[Removal::Segment(1)]).unwrap());
    }

    #[test]
    fn a_support_that_was_open_at_the_contact_is_closed() {
        let (mut mesh, segment) = bumpy(20);
        // One wall of the bump was never seen.
        mesh.triangles.retain(|t| {
            let wall = t.iter().any(|&i| segment[i as usize] == 1) && t.iter().any(|&i| segment[i as usize] == 0);
            !(wall && t.iter().any(|&i| mesh.positions[i as usize].x < -0.16))
        });
        let gone: Vec<bool> = segment.iter().map(|s| *s == 1).collect();
        let closed = RayScene::new(&cut(&mesh, &gone).kept);
        for (x, y) in [(0.0, 0.0), (-0.18, 0.1), (0.17, -0.17)] {
            let hit = closed.closest_hit(Vec3::new(x, y, 1.0), Vec3::NEG_Z).expect("closed");
            assert!((hit.distance - 1.0).abs() < 1e-3, "{x} {y}: {}", hit.distance);
        }
    }

    #[test]
    fn removals_that_make_no_sense_are_refused() {
        let (mesh, segment) = bumpy(8);
        let scene = RayScene::new(&mesh);
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
        let graph = Graph::of(&mesh);
        let truth: Vec<Vec3> = mesh.positions.iter().map(|p| Vec3::splat(1.0 + p.x)).collect();
        let known: Vec<bool> = mesh.positions.iter().map(|p| p.x.abs().max(p.y.abs()) > 0.3).collect();
        let mut values: Vec<Vec3> = truth.iter().zip(&known).map(|(t, k)| if *k { *t } else { Vec3::ZERO }).collect();
        inpaint(&mut values, &known, &graph);
        for (v, t) in values.iter().zip(&truth) {
            assert!((*v - *t).abs().max_element() < 0.02, "{v} {t}");
        }
    }
}
