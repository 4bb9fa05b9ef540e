//! Ray queries against a mesh: nearest hit and occlusion.

use crate::numerics::robust::median;
use crate::rays::traversal::{Any, Closest};
use crate::rays::wide_bvh::Wide;
use glam::{Vec3, Vec3A};
use isa::{Isa, dispatch};
use obvhs::aabb::Aabb;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};
use recordings::types::Mesh;

/// Padding of the bounding boxes in median edges: the box of an axis-aligned triangle would have no volume.
const BOX_PADDING: f32 = 1e-3;
/// Offset of a ray's origin from its surface in median edges: far above rounding errors, far below any feature.
const ORIGIN_OFFSET: f32 = 4e-2;
/// Largest usable coordinate in median edges: products of larger ones overflow f32.
const LARGEST_COORDINATE: f32 = 1e8;

/// The point where a ray meets the mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Distance along the unit direction, in the mesh's units.
    pub distance: f32,
    /// Index into the mesh's triangles.
    pub triangle: u32,
    /// Barycentric weight of the triangle's second vertex.
    pub u: f32,
    /// Barycentric weight of the triangle's third vertex.
    pub v: f32,
}

/// A mesh prepared for ray queries: an eight-wide BVH over watertight triangles. Surfaces are two-sided. Internally,
/// coordinates are scaled by a power of two so that the median edge is about one; the thresholds of the traversal then hold
/// at any scale of the scene.
#[derive(Debug)]
pub struct RayScene {
    wide: Wide,
    center: Vec3,
    scale: f32,
    median_edge: f32,
    largest_coordinate: f32,
}

impl RayScene {
    /// Builds the hierarchy; the result is the same on every machine. Triangles that are degenerate, not finite, or refer to
    /// vertices that do not exist are dropped.
    #[must_use]
    pub fn new(mesh: &Mesh) -> Self {
        let corner = |i: u32| mesh.positions.get(i as usize).copied().filter(|p| p.is_finite());
        let valid: Vec<(u32, [Vec3; 3])> = (0u32..)
            .zip(&mesh.triangles)
            .filter_map(|(index, t)| Some((index, [corner(t[0])?, corner(t[1])?, corner(t[2])?])))
            .filter(|(_, [a, b, c])| (*b - *a).cross(*c - *a) != Vec3::ZERO)
            .collect();
        let median_edge = median_edge(&valid);
        let scale = if median_edge > 0.0 { libm::exp2f(-libm::roundf(libm::log2f(median_edge))) } else { 1.0 };
        let center = center(&valid);
        let inside = |p: Vec3| Vec3A::from((p - center) * scale);

        let triangles: Vec<(u32, [Vec3A; 3])> = valid
            .iter()
            .map(|(index, corners)| (*index, corners.map(inside)))
            .filter(|(_, corners)| largest(corners) < LARGEST_COORDINATE)
            .collect();
        let largest_coordinate = triangles.iter().map(|(_, corners)| largest(corners)).fold(0.0, f32::max);
        Self { wide: build(&triangles), center, scale, median_edge, largest_coordinate }
    }

    /// The nearest surface along the unit `direction`, `None` if there is none. Origin and direction are in the mesh's frame.
    #[must_use]
    pub fn closest_hit(&self, origin: Vec3, direction: Vec3) -> Option<Hit> {
        let (origin, direction) = self.inside(origin, direction)?;
        let hit = dispatch(Isa::detect(), Closest { wide: &self.wide, origin, direction })?;
        Some(Hit { distance: hit.distance / self.scale, triangle: hit.triangle, u: hit.u, v: hit.v })
    }

    /// True if any surface lies along the unit `direction`.
    #[must_use]
    pub fn occluded(&self, origin: Vec3, direction: Vec3) -> bool {
        self.occluded_within(origin, direction, f32::INFINITY)
    }

    /// True if any surface lies along the unit `direction` nearer than `distance`.
    #[must_use]
    pub fn occluded_within(&self, origin: Vec3, direction: Vec3, distance: f32) -> bool {
        let within = (distance * self.scale).next_down();
        self.inside(origin, direction).is_some_and(|(origin, direction)| {
            dispatch(Isa::detect(), Any { wide: &self.wide, origin, direction, within })
        })
    }

    /// Origin for a ray that leaves the surface at `position` on the side of the unit `normal`: offset by a small fraction of
    /// an edge, and by more than the rounding error.
    #[must_use]
    pub fn offset_origin(&self, position: Vec3, normal: Vec3) -> Vec3 {
        let rounding = 16.0 * f32::EPSILON * self.largest_coordinate.max(position.abs().max_element() * self.scale);
        position + normal * ((ORIGIN_OFFSET + rounding) / self.scale)
    }

    /// Median edge length in the mesh's units; 0 for a mesh without valid triangles.
    #[must_use]
    pub fn median_edge(&self) -> f32 {
        self.median_edge
    }

    /// Origin and direction in the coordinates of the hierarchy; `None` for a ray that meets nothing.
    #[inline(always)]
    fn inside(&self, origin: Vec3, direction: Vec3) -> Option<(Vec3A, Vec3A)> {
        let origin = Vec3A::from((origin - self.center) * self.scale);
        let usable =
            origin.abs().max_element() < LARGEST_COORDINATE && direction.is_finite() && direction != Vec3::ZERO;
        (usable && !self.wide.leaves.is_empty()).then(|| (origin, direction.into()))
    }
}

fn largest(corners: &[Vec3A; 3]) -> f32 {
    corners.iter().map(|c| c.abs().max_element()).fold(0.0, f32::max)
}

fn build(triangles: &[(u32, [Vec3A; 3])]) -> Wide {
    if triangles.is_empty() {
        return Wide::default();
    }
    let boxes: Vec<Aabb> = (0u32..)
        .zip(triangles)
        .map(|(index, (_, [a, b, c]))| {
            let (low, high) = (a.min(*b).min(*c), a.max(*b).max(*c));
            // Uneven padding: the builder would merge many equal boxes one by one into a tree as deep as their number.
            let uneven = 1.0 + (index.wrapping_mul(2_654_435_761) >> 8) as f32 / 16_777_216.0;
            let padding = Vec3A::splat(BOX_PADDING * uneven) + low.abs().max(high.abs()) * (4.0 * f32::EPSILON);
            Aabb::new(low - padding, high + padding)
        })
        .collect();
    let indices = (0..boxes.len() as u32).collect();
    let mut binary = PlocBuilder::with_capacity(boxes.len()).build(
        PlocSearchDistance::Medium,
        &boxes,
        indices,
        SortPrecision::U64,
        3,
    );
    ReinsertionOptimizer::default().run(&mut binary, 0.05, None);
    Wide::new(binary, |primitive| triangles[primitive as usize])
}

fn median_edge(triangles: &[(u32, [Vec3; 3])]) -> f32 {
    let sides = triangles.iter().flat_map(|(_, [a, b, c])| [a.distance(*b), b.distance(*c), c.distance(*a)]);
    median(sides.filter(|e| e.is_finite() && *e > 0.0)).unwrap_or(0.0)
}

/// Median of the triangles' first corners along each axis: a few far outliers do not move it.
fn center(triangles: &[(u32, [Vec3; 3])]) -> Vec3 {
    let middle = |axis: usize| median(triangles.iter().map(|(_, t)| t[0][axis])).unwrap_or(0.0);
    Vec3::new(middle(0), middle(1), middle(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rays::traversal::Ray;
    use crate::rays::wide_bvh::Leaf;
    use proptest::prelude::*;

    fn mesh(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Mesh {
        Mesh { normals: vec![Vec3::Z; positions.len()], positions, triangles }
    }

    /// A closed box with `n` × `n` quads on each side.
    fn closed_box(n: u32, size: f32, center: Vec3) -> Mesh {
        let mut positions: Vec<Vec3> = Vec::new();
        let mut index = std::collections::BTreeMap::new();
        let mut triangles = Vec::new();
        let mut vertex = |p: [u32; 3], positions: &mut Vec<Vec3>| {
            *index.entry(p).or_insert_with(|| {
                let q = Vec3::new(p[0] as f32, p[1] as f32, p[2] as f32) / n as f32 - 0.5;
                positions.push(center + q * size);
                positions.len() as u32 - 1
            })
        };
        for axis in 0..3 {
            for side in [0, n] {
                for i in 0..n {
                    for j in 0..n {
                        let at = |a: u32, b: u32| {
                            let mut p = [0; 3];
                            p[axis] = side;
                            p[(axis + 1) % 3] = a;
                            p[(axis + 2) % 3] = b;
                            p
                        };
                        let q =
                            [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)].map(|p| vertex(p, &mut positions));
                        triangles.extend([[q[0], q[1], q[2]], [q[0], q[2], q[3]]]);
                    }
                }
            }
        }
        mesh(positions, triangles)
    }

    fn direction(x: f32, y: f32, z: f32) -> Option<Vec3> {
        Vec3::new(x, y, z).try_normalize()
    }

    proptest! {
        /// Rays from inside a closed box, many of them aimed exactly at its vertices and edges, never get out.
        #[test]
        fn closed_box_leaks_nothing(x in -0.49f32..0.49, y in -0.49f32..0.49, z in -0.49f32..0.49, exponent in -7i32..8) {
            let size = libm::powf(10.0, exponent as f32);
            let center = Vec3::new(3.0, -2.0, 1.0) * size;
            let cube = closed_box(4, size, center);
            let scene = RayScene::new(&cube);
            let origin = center + Vec3::new(x, y, z) * size;
            let mut targets = cube.positions.clone();
            for t in &cube.triangles {
                let [a, b, c] = t.map(|i| cube.positions[i as usize]);
                targets.extend([(a + b) * 0.5, (b + c) * 0.5, a * 0.3 + b * 0.7, (a + b + c) / 3.0]);
            }
            for target in targets {
                let Some(d) = (target - origin).try_normalize() else { continue };
                prop_assert!(scene.occluded(origin, d));
                let hit = scene.closest_hit(origin, d).expect("a hit");
                prop_assert!((hit.distance - origin.distance(target)).abs() < 1e-3 * size, "{hit:?}");
            }
            for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
                prop_assert!(scene.occluded(origin, axis) && scene.occluded(origin, -axis));
            }
        }

        /// A hit's barycentric weights reproduce the target point.
        #[test]
        fn barycentric_weights(u in 0.01f32..0.98, v in 0.01f32..0.98, x in -1f32..1.0, y in -1f32..1.0, z in 0.1f32..2.0) {
            prop_assume!(u + v < 0.99);
            let corners = [Vec3::ZERO, Vec3::new(1.0, 0.1, 0.0), Vec3::new(0.2, 1.0, 0.3)];
            let scene = RayScene::new(&mesh(corners.to_vec(), vec![[0, 1, 2]]));
            let target = corners[0] * (1.0 - u - v) + corners[1] * u + corners[2] * v;
            let origin = target + Vec3::new(x, y, z + 0.5);
            let hit = scene.closest_hit(origin, (target - origin).normalize()).expect("a hit");
            prop_assert!((hit.u - u).abs() < 1e-4 && (hit.v - v).abs() < 1e-4, "{hit:?}");
        }
    }

    #[test]
    fn agrees_with_brute_force() {
        let cube = closed_box(3, 1.0, Vec3::ZERO);
        let scene = RayScene::new(&cube);
        for i in 0..500 {
            let f = |k: i32| ((i * 7919 + k * 104_729) % 1000) as f32 / 500.0 - 1.0;
            let Some(d) = direction(f(1), f(2), f(3)) else { continue };
            let origin = Vec3::new(f(4), f(5), f(6)) * 2.0;
            let ray = Ray::new(origin.into(), d.into());
            let brute = cube
                .triangles
                .iter()
                .filter_map(|t| {
                    let corners = t.map(|i| Vec3A::from(cube.positions[i as usize]));
                    let (hits, distance, _) = ray.triangles(&Leaf::new(std::iter::once((0, corners))), f32::MAX);
                    (hits == 1).then_some(distance.x)
                })
                .min_by(f32::total_cmp);
            let hit = scene.closest_hit(origin, d).map(|h| h.distance);
            match (brute, hit) {
                (Some(a), Some(b)) => assert!((a - b).abs() < 1e-4, "{a} {b}"),
                (a, b) => assert_eq!(a.is_some(), b.is_some()),
            }
            assert_eq!(scene.occluded(origin, d), hit.is_some());
            if let Some(t) = hit {
                assert!(scene.occluded_within(origin, d, t * 1.001) && !scene.occluded_within(origin, d, t * 0.999));
            }
        }
    }

    #[test]
    fn invalid_triangles_are_dropped() {
        let p = vec![
            Vec3::ZERO,
            Vec3::X,
            Vec3::Y,
            Vec3::new(f32::NAN, 0.0, 0.0),
            Vec3::new(f32::INFINITY, 0.0, 0.0),
            Vec3::new(1e38, 0.0, 1e38),
        ];
        let t = vec![[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 1, 5], [0, 0, 1], [0, 1, 99], [0, 1, 2]];
        let scene = RayScene::new(&mesh(p, t));
        let hit = scene.closest_hit(Vec3::new(0.2, 0.2, 1.0), Vec3::NEG_Z).expect("a hit");
        assert_eq!(hit.triangle, 0, "of two coincident triangles the first");
        assert!(!scene.occluded(Vec3::new(0.2, 0.2, 1.0), Vec3::Z));
        assert!(!scene.occluded(Vec3::splat(f32::NAN), Vec3::Z));
        assert!(!scene.occluded(Vec3::ZERO, Vec3::splat(f32::NAN)));
        let empty = RayScene::new(&Mesh::default());
        assert!(!empty.occluded(Vec3::ZERO, Vec3::Z) && empty.median_edge() == 0.0);
    }

    /// Nested scales and thousands of duplicates make the hierarchy deep.
    #[test]
    fn deep_hierarchies_are_traversed() {
        let corner = |s: f32| [Vec3::ZERO, Vec3::X * s, Vec3::Y * s];
        let mut nested: Vec<Vec3> = (-60..60).flat_map(|e| corner(libm::exp2f(e as f32 * 0.5))).collect();
        let same: Vec<Vec3> = (0..20_000).flat_map(|_| corner(1.0)).collect();
        nested.extend(same);
        let triangles = (0..nested.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let scene = RayScene::new(&mesh(nested, triangles));
        assert!(scene.closest_hit(Vec3::new(0.1, 0.1, 1.0), Vec3::NEG_Z).is_some());
        assert!(scene.occluded(Vec3::new(0.1, 0.1, -1.0), Vec3::Z));
    }

    #[test]
    fn rays_from_an_offset_origin_do_not_hit_their_own_surface() {
        for size in [1e-3, 1.0, 1e3] {
            let cube = closed_box(16, size, Vec3::splat(5.0 * size));
            let scene = RayScene::new(&cube);
            for t in &cube.triangles {
                let [a, b, c] = t.map(|i| cube.positions[i as usize]);
                let middle = (a + b + c) / 3.0;
                let mut n = (b - a).cross(c - a).normalize();
                if n.dot(middle - Vec3::splat(5.0 * size)) < 0.0 {
                    n = -n;
                }
                assert!(!scene.occluded(scene.offset_origin(middle, n), n));
                assert!(scene.occluded(scene.offset_origin(middle, -n), -n));
            }
        }
    }
}
