//! The mesh as something rays hit: a compressed wide BVH over watertight triangles.

use glam::{UVec2, Vec3, Vec3A, Vec3Swizzles};
use obvhs::aabb::Aabb;
use obvhs::bvh2::reinsertion::ReinsertionOptimizer;
use obvhs::cwbvh::bvh2_to_cwbvh::bvh2_to_cwbvh;
use obvhs::cwbvh::{CwBvh, Traversal};
use obvhs::faststack::FastStack;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};
use obvhs::ray::Ray;
use recordings::types::Mesh;

/// Boxes grow by this much (median edges): the traversal clamps inverse directions, so that flat boxes that an
/// axis-parallel ray runs along would be missed.
const BOX_PADDING: f32 = 1e-3;
/// Rays start this far off the surface (median edges): far above rounding, far below any feature.
const ORIGIN_OFFSET: f32 = 4e-2;
/// Coordinates beyond this many median edges are no part of a scene: their products leave the range of f32.
const LARGEST_COORDINATE: f32 = 1e8;

/// Levels that the traversal keeps without allocating; only hostile geometry makes a deeper hierarchy.
const STACK: usize = 32;

/// Where a ray meets the mesh.
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

/// A triangle: the x of its three corners, their y, their z.
#[derive(Debug, Clone, Copy)]
struct Corners([Vec3A; 3]);

impl Corners {
    fn new(a: Vec3A, b: Vec3A, c: Vec3A) -> Self {
        Self([Vec3A::new(a.x, b.x, c.x), Vec3A::new(a.y, b.y, c.y), Vec3A::new(a.z, b.z, c.z)])
    }
    fn low(&self) -> Vec3A {
        Vec3A::from_array(self.0.map(Vec3A::min_element))
    }
    fn high(&self) -> Vec3A {
        Vec3A::from_array(self.0.map(Vec3A::max_element))
    }
    fn largest(&self) -> f32 {
        self.low().abs().max(self.high().abs()).max_element()
    }
}

/// A mesh that answers visibility queries. Surfaces are two-sided. Inside, coordinates are scaled by a power of two so
/// that the median edge is about one: thresholds of the traversal then mean the same at any scale of the scene.
#[derive(Debug)]
pub struct Scene {
    bvh: CwBvh,
    depth: usize,
    corners: Vec<Corners>,
    triangles: Vec<u32>,
    center: Vec3,
    scale: f32,
    median_edge: f32,
    largest_coordinate: f32,
}

impl Scene {
    /// Builds the hierarchy, the same on every machine. Triangles that are degenerate, not finite, or name vertices
    /// that do not exist are left out.
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

        let mut corners = Vec::with_capacity(valid.len());
        let mut triangles = Vec::with_capacity(valid.len());
        for (index, [a, b, c]) in &valid {
            let t = Corners::new(inside(*a), inside(*b), inside(*c));
            if t.largest() < LARGEST_COORDINATE {
                corners.push(t);
                triangles.push(*index);
            }
        }
        let bvh = build(&corners);
        let order = &bvh.primitive_indices;
        let corners: Vec<Corners> = order.iter().map(|&i| corners[i as usize]).collect();
        let triangles: Vec<u32> = order.iter().map(|&i| triangles[i as usize]).collect();
        let largest_coordinate = corners.iter().map(Corners::largest).fold(0.0, f32::max);
        let depth = depth(&bvh);
        Self { bvh, depth, corners, triangles, center, scale, median_edge, largest_coordinate }
    }

    /// The nearest surface along the unit `direction`.
    #[must_use]
    pub fn closest_hit(&self, origin: Vec3, direction: Vec3) -> Option<Hit> {
        let mut sheared = self.ray(origin, direction, f32::INFINITY)?;
        let mut best: Option<(u32, f32, f32)> = None;
        let mut node;
        obvhs::fast_stack!(UVec2, (STACK), self.depth, stack, {
            let mut state = State::new(stack, &self.bvh, sheared.ray.direction);
            obvhs::traverse!(self.bvh, node, state, node.intersect_ray(&sheared.ray, state.oct_inv4), {
                if let Some((t, u, v)) = sheared.intersect(&self.corners[state.primitive_id as usize]) {
                    sheared.ray.tmax = t;
                    best = Some((state.primitive_id, u, v));
                }
            });
        });
        best.map(|(i, u, v)| Hit {
            distance: sheared.ray.tmax / self.scale,
            triangle: self.triangles[i as usize],
            u,
            v,
        })
    }

    /// True if anything lies along the unit `direction`.
    #[must_use]
    pub fn occluded(&self, origin: Vec3, direction: Vec3) -> bool {
        self.occluded_within(origin, direction, f32::INFINITY)
    }

    /// True if anything lies along the unit `direction` nearer than `distance`.
    #[must_use]
    pub fn occluded_within(&self, origin: Vec3, direction: Vec3, distance: f32) -> bool {
        let Some(sheared) = self.ray(origin, direction, distance * self.scale) else {
            return false;
        };
        let mut node;
        obvhs::fast_stack!(UVec2, (STACK), self.depth, stack, {
            let mut state = State::new(stack, &self.bvh, sheared.ray.direction);
            obvhs::traverse!(self.bvh, node, state, node.intersect_ray(&sheared.ray, state.oct_inv4), {
                if sheared.intersect(&self.corners[state.primitive_id as usize]).is_some() {
                    return true;
                }
            });
        });
        false
    }

    /// Where a ray leaving the surface at `position` starts: off the surface by a small share of an edge, and by more
    /// than what rounding moves it.
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

    fn ray(&self, origin: Vec3, direction: Vec3, distance: f32) -> Option<Sheared> {
        let origin = Vec3A::from((origin - self.center) * self.scale);
        let usable =
            origin.abs().max_element() < LARGEST_COORDINATE && direction.is_finite() && direction != Vec3::ZERO;
        // Adding 0 turns −0 into 0: the box test would take its sign one way and its inverse the other.
        let direction = Vec3A::from(direction) + Vec3A::ZERO;
        (usable && !self.corners.is_empty()).then(|| Sheared::new(Ray::new(origin, direction, 0.0, distance)))
    }
}

/// What the traversal macro works on: obvhs' own state with a stack of any depth.
struct State<S> {
    stack: S,
    current_group: UVec2,
    primitive_group: UVec2,
    oct_inv4: u32,
    primitive_id: u32,
    hitmask: u32,
}

impl<S: FastStack<UVec2>> State<S> {
    #[inline(always)]
    fn new(stack: S, bvh: &CwBvh, direction: Vec3A) -> Self {
        let Traversal { current_group, primitive_group, oct_inv4, primitive_id, hitmask, .. } =
            bvh.new_traversal(direction);
        Self { stack, current_group, primitive_group, oct_inv4, primitive_id, hitmask }
    }
}

/// A ray in the frame of Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection" (JCGT 2013): the axis it runs
/// along most is z, and a shear makes it that axis.
struct Sheared {
    ray: Ray,
    axes: [usize; 3],
    origin: [f32; 3],
    shear: [f32; 2],
    inverse_z: f32,
}

impl Sheared {
    fn new(ray: Ray) -> Self {
        let (o, d, size) = (ray.origin.to_array(), ray.direction.to_array(), ray.direction.abs());
        let z = if size.x >= size.y && size.x >= size.z {
            0
        } else if size.y >= size.z {
            1
        } else {
            2
        };
        let axes = [(z + 1) % 3, (z + 2) % 3, z];
        Self {
            ray,
            axes,
            origin: axes.map(|k| o[k]),
            shear: [d[axes[0]] / d[z], d[axes[1]] / d[z]],
            inverse_z: 1.0 / d[z],
        }
    }

    /// Distance and barycentric weights. The sign of an edge function is exact for the sheared corners (rounded products
    /// keep their order; a difference of zero is taken again in f64), so triangles that share an edge or a corner agree
    /// on which of them a ray passes: no gap between them.
    #[inline(always)]
    fn intersect(&self, corners: &Corners) -> Option<(f32, f32, f32)> {
        let [kx, ky, kz] = self.axes;
        let z = corners.0[kz] - self.origin[2];
        let x = corners.0[kx] - self.origin[0] - z * self.shear[0];
        let y = corners.0[ky] - self.origin[1] - z * self.shear[1];
        let mut edges = x.zxy() * y.yzx() - y.zxy() * x.yzx();
        if edges.cmpeq(Vec3A::ZERO).any() {
            let (x, y) = (x.as_dvec3(), y.as_dvec3());
            edges = (x.zxy() * y.yzx() - y.zxy() * x.yzx()).as_vec3a();
        }
        if edges.min_element() < 0.0 && edges.max_element() > 0.0 {
            return None;
        }
        let sum = edges.element_sum();
        let t = edges.dot(z) * self.inverse_z / sum;
        // Edge-on triangles give NaN, which fails here.
        (t > 0.0 && t < self.ray.tmax).then(|| (t, edges.y / sum, edges.z / sum))
    }
}

fn build(corners: &[Corners]) -> CwBvh {
    if corners.is_empty() {
        return CwBvh::default();
    }
    let boxes: Vec<Aabb> = (0u32..)
        .zip(corners)
        .map(|(index, t)| {
            let (low, high) = (t.low(), t.high());
            // Uneven padding, because many equal boxes would be merged one by one into a tree as deep as they are many.
            let uneven = 1.0 + (index.wrapping_mul(2_654_435_761) >> 8) as f32 / 16_777_216.0;
            let padding = Vec3A::splat(BOX_PADDING * uneven) + low.abs().max(high.abs()) * (4.0 * f32::EPSILON);
            Aabb::new(low - padding, high + padding)
        })
        .collect();
    let indices = (0..boxes.len() as u32).collect();
    let mut bvh2 = PlocBuilder::with_capacity(boxes.len()).build(
        PlocSearchDistance::Medium,
        &boxes,
        indices,
        SortPrecision::U64,
        3,
    );
    ReinsertionOptimizer::default().run(&mut bvh2, 0.05, None);
    bvh2_to_cwbvh(&bvh2, 3, true, false)
}

/// Levels of the hierarchy.
fn depth(bvh: &CwBvh) -> usize {
    let mut deepest = 0;
    let mut open: Vec<(usize, usize)> = if bvh.nodes.is_empty() { vec![] } else { vec![(0, 1)] };
    while let Some((index, level)) = open.pop() {
        deepest = deepest.max(level);
        let node = &bvh.nodes[index];
        open.extend((0..node.imask.count_ones()).map(|k| ((node.child_base_idx + k) as usize, level + 1)));
    }
    deepest
}

fn median_edge(triangles: &[(u32, [Vec3; 3])]) -> f32 {
    let mut edges: Vec<f32> = triangles
        .iter()
        .flat_map(|(_, [a, b, c])| [a.distance(*b), b.distance(*c), c.distance(*a)])
        .filter(|e| e.is_finite() && *e > 0.0)
        .collect();
    if edges.is_empty() {
        return 0.0;
    }
    let middle = edges.len() / 2;
    *edges.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// The middle corner along each axis: a few far-off triangles do not move it.
fn center(triangles: &[(u32, [Vec3; 3])]) -> Vec3 {
    let median = |axis: usize| {
        let mut x: Vec<f32> = triangles.iter().map(|(_, t)| t[0][axis]).collect();
        let middle = x.len() / 2;
        if x.is_empty() { 0.0 } else { *x.select_nth_unstable_by(middle, f32::total_cmp).1 }
    };
    Vec3::new(median(0), median(1), median(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn mesh(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Mesh {
        Mesh { normals: vec![Vec3::Z; positions.len()], positions, triangles }
    }

    /// A closed box of `n` × `n` quads a side, as a height of regular squares.
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
            let scene = Scene::new(&cube);
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

        /// A hit's barycentric weights give back the point that was aimed at.
        #[test]
        fn barycentric_weights(u in 0.01f32..0.98, v in 0.01f32..0.98, x in -1f32..1.0, y in -1f32..1.0, z in 0.1f32..2.0) {
            prop_assume!(u + v < 0.99);
            let corners = [Vec3::ZERO, Vec3::new(1.0, 0.1, 0.0), Vec3::new(0.2, 1.0, 0.3)];
            let scene = Scene::new(&mesh(corners.to_vec(), vec![[0, 1, 2]]));
            let target = corners[0] * (1.0 - u - v) + corners[1] * u + corners[2] * v;
            let origin = target + Vec3::new(x, y, z + 0.5);
            let hit = scene.closest_hit(origin, (target - origin).normalize()).expect("a hit");
            prop_assert!((hit.u - u).abs() < 1e-4 && (hit.v - v).abs() < 1e-4, "{hit:?}");
        }
    }

    #[test]
    fn agrees_with_brute_force() {
        let cube = closed_box(3, 1.0, Vec3::ZERO);
        let scene = Scene::new(&cube);
        for i in 0..500 {
            let f = |k: i32| ((i * 7919 + k * 104_729) % 1000) as f32 / 500.0 - 1.0;
            let Some(d) = direction(f(1), f(2), f(3)) else { continue };
            let origin = Vec3::new(f(4), f(5), f(6)) * 2.0;
            let ray = Sheared::new(Ray::new(origin.into(), d.into(), 0.0, f32::INFINITY));
            let brute = cube
                .triangles
                .iter()
                .filter_map(|t| {
                    let [a, b, c] = t.map(|i| Vec3A::from(cube.positions[i as usize]));
                    ray.intersect(&Corners::new(a, b, c)).map(|(t, ..)| t)
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
    fn hostile_geometry_is_dropped() {
        let p = vec![
            Vec3::ZERO,
            Vec3::X,
            Vec3::Y,
            Vec3::new(f32::NAN, 0.0, 0.0),
            Vec3::new(f32::INFINITY, 0.0, 0.0),
            Vec3::new(1e38, 0.0, 1e38),
        ];
        let t = vec![[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 1, 5], [0, 0, 1], [0, 1, 99], [0, 1, 2]];
        let scene = Scene::new(&mesh(p, t));
        let hit = scene.closest_hit(Vec3::new(0.2, 0.2, 1.0), Vec3::NEG_Z).expect("a hit");
        assert!(hit.triangle == 0 || hit.triangle == 6);
        assert!(!scene.occluded(Vec3::new(0.2, 0.2, 1.0), Vec3::Z));
        assert!(!scene.occluded(Vec3::splat(f32::NAN), Vec3::Z));
        assert!(!scene.occluded(Vec3::ZERO, Vec3::splat(f32::NAN)));
        let empty = Scene::new(&Mesh::default());
        assert!(!empty.occluded(Vec3::ZERO, Vec3::Z) && empty.median_edge() == 0.0);
    }

    /// Triangles that make a hierarchy deep: nested scales, thousands of duplicates.
    #[test]
    fn deep_hierarchies_are_traversed() {
        let corner = |s: f32| [Vec3::ZERO, Vec3::X * s, Vec3::Y * s];
        let mut nested: Vec<Vec3> = (-60..60).flat_map(|e| corner(libm::exp2f(e as f32 * 0.5))).collect();
        let same: Vec<Vec3> = (0..20_000).flat_map(|_| corner(1.0)).collect();
        nested.extend(same);
        let triangles = (0..nested.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let scene = Scene::new(&mesh(nested, triangles));
        assert!(scene.depth > STACK, "the test means to go deep: {}", scene.depth);
        assert!(scene.closest_hit(Vec3::new(0.1, 0.1, 1.0), Vec3::NEG_Z).is_some());
        assert!(scene.occluded(Vec3::new(0.1, 0.1, -1.0), Vec3::Z));
    }

    #[test]
    fn rays_from_an_offset_origin_do_not_hit_their_own_surface() {
        for size in [1e-3, 1.0, 1e3] {
            let cube = closed_box(16, size, Vec3::splat(5.0 * size));
            let scene = Scene::new(&cube);
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
