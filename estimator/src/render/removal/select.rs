//! Selects the vertices that a removal takes away.

use crate::mesh::graph::Graph;
use crate::rays::RayScene;
use crate::render::error::{RenderError, Result};
use crate::render::removal::object_extraction::{grown, object_on_support};
use firmware_config::tuning::RemovalTuning;
use glam::Vec3;
use recordings::types::Mesh;

/// What to remove.
#[derive(Debug, Clone, PartialEq)]
pub enum Removal {
    /// Every vertex of a segment; the whole object where the segment is most of it, and small components left unsupported.
    Segment(u32),
    /// Every vertex in a box: lowest and highest corner.
    Box(Vec3, Vec3),
    /// What a ray hits: the object on its support there, or a connected component that is a small part of the scan;
    /// otherwise the patch of its segment.
    Ray {
        /// Start.
        origin: Vec3,
        /// Unit direction.
        direction: Vec3,
    },
}

/// Vertices that a list of removals takes away.
///
/// # Errors
/// A segment that does not exist, a ray or a box that meets nothing, or nothing left.
pub fn select(
    mesh: &Mesh,
    segment: &[u32],
    scene: &RayScene,
    removals: &[Removal],
    tuning: &RemovalTuning,
) -> Result<Vec<bool>> {
    let n = mesh.positions.len();
    let graph = Graph::of(mesh);
    let mut gone = vec![false; n];
    let edge = scene.median_edge();
    let count = |set: &[bool]| set.iter().filter(|x| **x).count();
    for removal in removals {
        let chosen: Vec<bool> = match removal {
            Removal::Segment(id) => {
                let mut members: Vec<bool> = segment.iter().map(|s| s == id).collect();
                if let Some(whole) =
                    middle(mesh, &members).and_then(|seed| object_on_support(mesh, &graph, edge, seed, tuning))
                {
                    let shared = (0..n).filter(|&v| whole[v] && members[v]).count();
                    if shared as f64 >= tuning.whole_object * count(&whole) as f64 {
                        members.iter_mut().zip(grown(&whole, &graph)).for_each(|(m, w)| *m |= w);
                    }
                }
                with_small_components(members, &graph, tuning.small_component)
            }
            Removal::Box(low, high) => {
                mesh.positions.iter().map(|p| p.cmpge(*low).all() && p.cmple(*high).all()).collect()
            }
            Removal::Ray { origin, direction } => {
                let hit = scene.closest_hit(*origin, *direction).ok_or_else(|| {
                    RenderError::Request("nothing of the scan is under the point that is to be removed".into())
                })?;
                let start = mesh.triangles[hit.triangle as usize][0] as usize;
                let piece = graph.flood(start, |_| true);
                if count(&piece) as f64 <= tuning.largest_component * n as f64 {
                    piece
                } else {
                    let patch = || {
                        with_small_components(
                            graph.flood(start, |v| segment[v] == segment[start]),
                            &graph,
                            tuning.small_component,
                        )
                    };
                    object_on_support(mesh, &graph, edge, start, tuning)
                        .map_or_else(patch, |whole| grown(&whole, &graph))
                }
            }
        };
        if !chosen.iter().any(|c| *c) {
            return Err(RenderError::Request(match removal {
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
        return Err(RenderError::Request("the removal would take everything: nothing would be left to show".into()));
    }
    Ok(gone)
}

/// The member nearest to the middle of all members.
fn middle(mesh: &Mesh, members: &[bool]) -> Option<usize> {
    let of = || (0..members.len()).filter(|&v| members[v]);
    let middle = of().map(|v| mesh.positions[v]).sum::<Vec3>() / of().count().max(1) as f32;
    of().min_by(|&a, &b| mesh.positions[a].distance(middle).total_cmp(&mesh.positions[b].distance(middle)))
}

/// The members with the small components that only they connected.
fn with_small_components(mut members: Vec<bool>, graph: &Graph, share: f64) -> Vec<bool> {
    let size = members.iter().filter(|m| **m).count();
    let mut done = members.clone();
    let rim: Vec<usize> =
        (0..members.len()).filter(|&v| members[v]).flat_map(|v| graph.neighbours(v)).map(|&v| v as usize).collect();
    for v in rim {
        if !done[v] {
            let piece = graph.component(v, &mut done);
            if piece.len() as f64 <= share * size as f64 {
                piece.into_iter().for_each(|p| members[p] = true);
            }
        }
    }
    members
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::inpainting::geometry::cut;
    use firmware_config::tuning::InpaintingTuning;
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
    fn the_support_is_closed_flat_where_an_object_stood_on_it() {
        let (mesh, segment) = bumpy(20);
        let scene = RayScene::new(&mesh);
        let gone = select(&mesh, &segment, &scene, &[Removal::Segment(1)], &RemovalTuning::default()).unwrap();
        let cut = cut(&mesh, &gone, &InpaintingTuning::default());
        let closed = RayScene::new(&cut.kept);
        for (x, y) in [(0.0, 0.0), (0.13, -0.1), (-0.19, 0.19), (0.3, 0.01)] {
            let hit = closed.closest_hit(Vec3::new(x, y, 1.0), Vec3::NEG_Z).expect("closed");
            assert!((hit.distance - 1.0).abs() < 1e-3, "{x} {y}: {}", hit.distance);
        }
        assert!(cut.kept.normals[cut.first_patch..].iter().all(|n| n.z > 0.99));
    }

    #[test]
    fn an_object_of_several_segments_goes_whole_and_its_support_stays() {
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
        check(&select(&mesh, &segment, &scene, &[down], &RemovalTuning::default()).unwrap());
        // One of two parts is not all of it; one that is most of it is.
        let half = select(&mesh, &segment, &scene, &[Removal::Segment(1)], &RemovalTuning::default()).unwrap();
        assert!(half.iter().zip(&segment).all(|(g, s)| *g == (*s == 1)));
        part(0.12, &mut segment);
        check(&select(&mesh, &segment, &scene, &[Removal::Segment(1)], &RemovalTuning::default()).unwrap());
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
        let closed = RayScene::new(&cut(&mesh, &gone, &InpaintingTuning::default()).kept);
        for (x, y) in [(0.0, 0.0), (-0.18, 0.1), (0.17, -0.17)] {
            let hit = closed.closest_hit(Vec3::new(x, y, 1.0), Vec3::NEG_Z).expect("closed");
            assert!((hit.distance - 1.0).abs() < 1e-3, "{x} {y}: {}", hit.distance);
        }
    }

    #[test]
    fn removals_that_make_no_sense_are_refused() {
        let (mesh, segment) = bumpy(8);
        let scene = RayScene::new(&mesh);
        let say =
            |r: Removal| select(&mesh, &segment, &scene, &[r], &RemovalTuning::default()).unwrap_err().to_string();
        assert!(say(Removal::Segment(9)).contains("no segment 9"));
        assert!(say(Removal::Box(Vec3::splat(5.0), Vec3::splat(6.0))).contains("no part"));
        assert!(say(Removal::Box(Vec3::splat(-5.0), Vec3::splat(6.0))).contains("everything"));
        let up = Removal::Ray { origin: Vec3::new(0.0, 0.0, 2.0), direction: Vec3::Z };
        assert!(say(up).contains("nothing of the scan"));
    }
}
