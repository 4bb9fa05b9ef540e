//! BVH traversal and the watertight ray–triangle test.

use crate::rays::wide_bvh::{Child, IN_LEAF, Lanes, Leaf, Node, WIDTH, Wide};
use glam::{Vec3A, Vec4};
use isa::Hot;

/// Lower bound of the magnitude of a direction's components in box tests, so that no inverse is infinite.
const LEAST_COMPONENT: f32 = 1e-18;
/// Relative enlargement of the exit distance of a box: more than its rounding error.
const ROUNDING: f32 = 4.0 * f32::EPSILON;
/// Entries of the traversal stack before it spills to the heap.
const STACK: usize = 64;

/// A ray with the values that box and triangle tests need. Triangles are tested in the frame of Woop,
/// Benthin and Wald, "Watertight Ray/Triangle Intersection" (JCGT 2013): z is the ray's dominant axis, and a shear aligns the
/// ray with it.
pub(super) struct Ray {
    origin: [f32; 3],
    /// Inverse direction for entry and for exit distances.
    inverse: [[f32; 3]; 2],
    /// `[axis]`: whether the ray enters boxes through their lower (0) or upper (1) plane.
    entry: [usize; 3],
    axes: [usize; 3],
    shear: [Vec4; 2],
    inverse_z: Vec4,
}

impl Ray {
    #[inline(always)]
    pub(super) fn new(origin: Vec3A, direction: Vec3A) -> Self {
        let (d, size) = (direction.to_array(), direction.abs());
        let z = if size.x >= size.y && size.x >= size.z {
            0
        } else if size.y >= size.z {
            1
        } else {
            2
        };
        let axes = [(z + 1) % 3, (z + 2) % 3, z];
        let inverse = d.map(|d| 1.0 / if d.abs() < LEAST_COMPONENT { LEAST_COMPONENT.copysign(d) } else { d });
        Self {
            origin: origin.to_array(),
            inverse: [inverse, inverse.map(|i| i * (1.0 + ROUNDING))],
            entry: inverse.map(|i| usize::from(i < 0.0)),
            axes,
            shear: [Vec4::splat(d[axes[0]] / d[z]), Vec4::splat(d[axes[1]] / d[z])],
            inverse_z: Vec4::splat(1.0 / d[z]),
        }
    }

    /// The planes through which the ray enters and leaves the boxes of a node: `[entry, exit][axis]`.
    #[inline(always)]
    fn entry_and_exit<'a>(&self, node: &'a Node) -> [[&'a Lanes; 3]; 2] {
        let ([x, y, z], [i, j, k]) = (&node.planes, self.entry);
        [[&x[i], &y[j], &z[k]], [&x[i ^ 1], &y[j ^ 1], &z[k ^ 1]]]
    }

    /// One bit for each box that the ray hits between 0 and `within`, and its entry distances, `[box]`.
    #[inline(always)]
    fn boxes(&self, node: &Node, within: f32) -> (u32, Lanes) {
        let (mut entry, mut left): (Lanes, Lanes) = ([0.0; WIDTH], [0.0; WIDTH]);
        let [[ax, ay, az], [bx, by, bz]] = self.entry_and_exit(node);
        let ([ox, oy, oz], [[ix, iy, iz], [jx, jy, jz]]) = (self.origin, self.inverse);
        for i in 0..WIDTH {
            let (a, b, c) = ((ax[i] - ox) * ix, (ay[i] - oy) * iy, (az[i] - oz) * iz);
            entry[i] = larger(larger(larger(a, b), c), 0.0);
            let (a, b, c) = ((bx[i] - ox) * jx, (by[i] - oy) * jy, (bz[i] - oz) * jz);
            left[i] = smaller(smaller(smaller(a, b), c), within);
        }
        let [entry_halves, left_halves]: [[Vec4; 2]; 2] = [bytemuck::cast(entry), bytemuck::cast(left)];
        let hits = |half: usize| entry_halves[half].cmple(left_halves[half]).bitmask() << (4 * half);
        (hits(0) | hits(1), entry)
    }

    /// One bit for each triangle that the ray hits at a distance in (0, `within`]; the distances; the edge functions.
    ///
    /// The sign of an edge function is exact for the sheared corners: rounded products keep their order, and a difference of
    /// zero is recomputed in f64. So triangles that share an edge or a corner agree on which of them a ray passes, without gaps.
    #[inline(always)]
    pub(super) fn triangles(&self, leaf: &Leaf, within: f32) -> (u32, Vec4, [Vec4; 3]) {
        let [kx, ky, kz] = self.axes;
        let o = &self.origin;
        let origin = [Vec4::splat(o[kx]), Vec4::splat(o[ky]), Vec4::splat(o[kz])];
        let [a, b, c] = leaf.corners[kz];
        let z = [a - origin[2], b - origin[2], c - origin[2]];
        let x = sheared(&leaf.corners[kx], origin[0], &z, self.shear[0]);
        let y = sheared(&leaf.corners[ky], origin[1], &z, self.shear[1]);
        let mut edges = [x[2] * y[1] - y[2] * x[1], x[0] * y[2] - y[0] * x[2], x[1] * y[0] - y[1] * x[0]];
        let zero = Vec4::ZERO;
        let doubtful = edges[0].cmpeq(zero) | edges[1].cmpeq(zero) | edges[2].cmpeq(zero);
        if doubtful.any() {
            recompute(doubtful.bitmask(), &x, &y, &mut edges);
        }
        let (least, most) = (edges[0].min(edges[1]).min(edges[2]), edges[0].max(edges[1]).max(edges[2]));
        let inside = !(least.cmplt(zero) & most.cmpgt(zero));
        if !inside.any() {
            return (0, zero, edges);
        }
        let sum = edges[0] + edges[1] + edges[2];
        let t = (edges[0] * z[0] + edges[1] * z[1] + edges[2] * z[2]) * self.inverse_z / sum;
        // Edge-on triangles give NaN and fail this test.
        ((inside & t.cmpgt(zero) & t.cmple(Vec4::splat(within))).bitmask(), t, edges)
    }
}

/// Recomputes the edge functions of the triangles in `mask` in f64.
#[cold]
#[inline(never)]
fn recompute(mask: u32, x: &[Vec4; 3], y: &[Vec4; 3], edges: &mut [Vec4; 3]) {
    for i in (0..IN_LEAF).filter(|i| mask >> i & 1 == 1) {
        let (x, y) = (x.map(|x| f64::from(x[i])), y.map(|y| f64::from(y[i])));
        edges[0][i] = (x[2] * y[1] - y[2] * x[1]) as f32;
        edges[1][i] = (x[0] * y[2] - y[0] * x[2]) as f32;
        edges[2][i] = (x[1] * y[0] - y[1] * x[0]) as f32;
    }
}

/// The nearest hit so far, with a distance in the scaled coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct NearestHit {
    pub(super) distance: f32,
    pub(super) triangle: u32,
    pub(super) u: f32,
    pub(super) v: f32,
}

impl Wide {
    /// True if any triangle is hit at a distance of at most `within`.
    #[inline(always)]
    fn any(&self, ray: &Ray, within: f32) -> bool {
        let mut stack = Stack::<Child>::new();
        let mut next = self.root;
        loop {
            match next.leaf_or_node() {
                Ok(leaf) => {
                    if ray.triangles(&self.leaves[leaf], within).0 != 0 {
                        return true;
                    }
                }
                Err(node) => {
                    let node = &self.nodes[node];
                    let (mut hits, _) = ray.boxes(node, within);
                    if hits != 0 {
                        stack.make_room();
                        next = node.children[take_lowest(&mut hits) % WIDTH];
                        while hits != 0 {
                            stack.push(next);
                            next = node.children[take_lowest(&mut hits) % WIDTH];
                        }
                        continue;
                    }
                }
            }
            match stack.pop() {
                Some(child) => next = child,
                None => return false,
            }
        }
    }

    /// The nearest hit; of equally near triangles the one with the lowest index.
    #[inline(always)]
    fn closest(&self, ray: &Ray) -> Option<NearestHit> {
        let mut best = NearestHit { distance: f32::MAX, triangle: u32::MAX, u: 0.0, v: 0.0 };
        let mut stack = Stack::<Pending>::new();
        let mut next = self.root;
        'descent: loop {
            match next.leaf_or_node() {
                Ok(leaf) => best.update(ray, &self.leaves[leaf]),
                Err(node) => {
                    let node = &self.nodes[node];
                    let (mut hits, entry_distance) = ray.boxes(node, best.distance);
                    if hits != 0 {
                        stack.make_room();
                        let start = stack.len;
                        let mut nearest = Pending::take(node, &mut hits, &entry_distance);
                        while hits != 0 {
                            let mut farther = Pending::take(node, &mut hits, &entry_distance);
                            if farther.entry_distance < nearest.entry_distance {
                                std::mem::swap(&mut farther, &mut nearest);
                            }
                            stack.insert(start, farther);
                        }
                        next = nearest.child;
                        continue;
                    }
                }
            }
            loop {
                match stack.pop() {
                    Some(pending) if pending.entry_distance <= best.distance => {
                        next = pending.child;
                        break;
                    }
                    Some(_) => {}
                    None => break 'descent,
                }
            }
        }
        (best.triangle != u32::MAX).then_some(best)
    }
}

/// One axis of three corners, relative to the origin and with the ray along z.
#[inline(always)]
fn sheared([a, b, c]: &[Vec4; 3], origin: Vec4, z: &[Vec4; 3], shear: Vec4) -> [Vec4; 3] {
    [*a - origin - z[0] * shear, *b - origin - z[1] * shear, *c - origin - z[2] * shear]
}

/// The larger number; the second one where there is none.
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The smaller number; the second one where there is none.
#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// [`Wide::any`] as a hot loop.
pub(super) struct Any<'a> {
    pub(super) wide: &'a Wide,
    pub(super) origin: Vec3A,
    pub(super) direction: Vec3A,
    pub(super) within: f32,
}

impl Hot for Any<'_> {
    type Output = bool;

    #[inline(always)]
    fn run(self) -> bool {
        self.wide.any(&Ray::new(self.origin, self.direction), self.within)
    }
}

/// [`Wide::closest`] as a hot loop.
pub(super) struct Closest<'a> {
    pub(super) wide: &'a Wide,
    pub(super) origin: Vec3A,
    pub(super) direction: Vec3A,
}

impl Hot for Closest<'_> {
    type Output = Option<NearestHit>;

    #[inline(always)]
    fn run(self) -> Option<NearestHit> {
        self.wide.closest(&Ray::new(self.origin, self.direction))
    }
}

#[inline(always)]
fn take_lowest(bits: &mut u32) -> usize {
    let lowest = bits.trailing_zeros() as usize;
    *bits &= *bits - 1;
    lowest
}

impl NearestHit {
    /// Updates with the nearest triangle of `leaf` if that is nearer.
    #[inline(always)]
    fn update(&mut self, ray: &Ray, leaf: &Leaf) {
        let (mut hits, distances, edges) = ray.triangles(leaf, self.distance);
        while hits != 0 {
            let i = take_lowest(&mut hits) % IN_LEAF;
            let (distance, triangle) = (distances[i], leaf.triangles[i]);
            if distance < self.distance || (distance == self.distance && triangle < self.triangle) {
                let [a, b, c] = edges.map(|e| e[i]);
                let sum = a + b + c;
                *self = Self { distance, triangle, u: b / sum, v: c / sum };
            }
        }
    }
}

/// A box on the stack and the distance at which the ray enters it.
#[derive(Debug, Clone, Copy, Default)]
struct Pending {
    child: Child,
    entry_distance: f32,
}

impl Pending {
    #[inline(always)]
    fn take(node: &Node, hits: &mut u32, entry_distance: &Lanes) -> Self {
        let i = take_lowest(hits) % WIDTH;
        Self { child: node.children[i], entry_distance: entry_distance[i] }
    }
}

/// The traversal stack.
struct Stack<T> {
    entries: [T; STACK],
    len: usize,
    /// The bottom of the stack: only degenerate geometry needs it.
    spilled: Vec<T>,
}

impl<T: Copy + Default> Stack<T> {
    #[inline(always)]
    fn new() -> Self {
        Self { entries: [T::default(); STACK], len: 0, spilled: Vec::new() }
    }

    /// Ensures space for the boxes of one node.
    #[inline(always)]
    fn make_room(&mut self) {
        if self.len > STACK - WIDTH {
            spill(&mut self.spilled, &self.entries[..self.len]);
            self.len = 0;
        }
    }

    #[inline(always)]
    fn push(&mut self, one: T) {
        self.entries[self.len] = one;
        self.len += 1;
    }

    #[inline(always)]
    fn pop(&mut self) -> Option<T> {
        if self.len == 0 {
            return self.spilled.pop();
        }
        self.len -= 1;
        Some(self.entries[self.len])
    }
}

impl Stack<Pending> {
    /// Pushes and keeps the entries from `start` on sorted, the nearest last.
    #[inline(always)]
    fn insert(&mut self, start: usize, one: Pending) {
        let mut slot = self.len;
        while slot > start && self.entries[slot - 1].entry_distance < one.entry_distance {
            self.entries[slot] = self.entries[slot - 1];
            slot -= 1;
        }
        self.entries[slot] = one;
        self.len += 1;
    }
}

/// Moves entries to the heap. A separate function that borrows only slices, so that the rest of the stack can stay in
/// registers.
#[cold]
#[inline(never)]
fn spill<T: Copy>(spilled: &mut Vec<T>, waiting: &[T]) {
    spilled.extend_from_slice(waiting);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spilled_entries_keep_their_order() {
        let mut stack = Stack::<u32>::new();
        let count = 10 * STACK as u32;
        for i in 0..count {
            stack.make_room();
            stack.push(i);
        }
        assert!(stack.spilled.len() > 8 * STACK);
        for i in (0..count).rev() {
            assert_eq!(stack.pop(), Some(i));
        }
        assert_eq!(stack.pop(), None);
    }

    #[test]
    fn the_nearest_box_is_popped_first() {
        let mut stack = Stack::<Pending>::new();
        let below = Pending { entry_distance: 0.5, ..Pending::default() };
        stack.push(below);
        for entry_distance in [3.0, 1.0, 4.0, 1.0, 5.0, 2.0] {
            stack.insert(1, Pending { entry_distance, ..Pending::default() });
        }
        let order: Vec<f32> = std::iter::from_fn(|| stack.pop()).map(|w| w.entry_distance).collect();
        assert_eq!(order, [1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 0.5]);
    }
}
