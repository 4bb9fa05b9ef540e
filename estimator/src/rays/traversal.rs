//! A ray's way through the hierarchy.

use crate::rays::wide_bvh::{Child, IN_LEAF, Leaf, Node, WIDTH, Wide};
use glam::{Vec3A, Vec4};

/// Components of a direction are taken for this at least where a box is met, so that no inverse is infinite.
const LEAST_COMPONENT: f32 = 1e-18;
/// Boxes end this share later than computed: more than the rounding of a distance.
const ROUNDING: f32 = 4.0 * f32::EPSILON;
/// Boxes that wait without memory of their own.
const WAITING: usize = 64;

/// A ray as boxes and triangles meet it, every value four times. For triangles that is the frame of Woop, Benthin and
/// Wald, "Watertight Ray/Triangle Intersection" (JCGT 2013): the axis it runs along most is z, and a shear makes it that
/// axis.
pub(super) struct Ray {
    origin: [Vec4; 3],
    /// Inverse direction to where a box begins and to where it ends.
    inverse: [[Vec4; 3]; 2],
    /// Whether a box begins at its lower (0) or its upper (1) plane.
    begin: [usize; 3],
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
            origin: origin.to_array().map(Vec4::splat),
            inverse: [inverse.map(Vec4::splat), inverse.map(|i| Vec4::splat(i * (1.0 + ROUNDING)))],
            begin: inverse.map(|i| usize::from(i < 0.0)),
            axes,
            shear: [Vec4::splat(d[axes[0]] / d[z]), Vec4::splat(d[axes[1]] / d[z])],
            inverse_z: Vec4::splat(1.0 / d[z]),
        }
    }

    /// A bit for each box that the ray meets between 0 and `within`, and where it enters it.
    #[inline(always)]
    fn boxes(&self, node: &Node, within: f32) -> (u32, [f32; WIDTH]) {
        let mut met = 0;
        let mut entered = [Vec4::ZERO; 2];
        for (half, entered) in entered.iter_mut().enumerate() {
            let distances = |end: usize| {
                let at = |axis: usize| {
                    let plane = node.planes[axis][self.begin[axis] ^ end][half];
                    (plane - self.origin[axis]) * self.inverse[end][axis]
                };
                [at(0), at(1), at(2)]
            };
            let ([ax, ay, az], [bx, by, bz]) = (distances(0), distances(1));
            *entered = ax.max(ay).max(az).max(Vec4::ZERO);
            let left = bx.min(by).min(bz).min(Vec4::splat(within));
            met |= entered.cmple(left).bitmask() << (4 * half);
        }
        (met, bytemuck::cast(entered))
    }

    /// A bit for each triangle that the ray meets between 0 and `within`, both left out, the other included; their
    /// distances; the edge functions.
    ///
    /// The sign of an edge function is exact for the sheared corners (rounded products keep their order; a difference of
    /// zero is taken again in f64), so triangles that share an edge or a corner agree on which of them a ray passes: no
    /// gap between them.
    #[inline(always)]
    pub(super) fn triangles(&self, leaf: &Leaf, within: f32) -> (u32, Vec4, [Vec4; 3]) {
        let [kx, ky, kz] = self.axes;
        let z = leaf.corners[kz].map(|c| c - self.origin[kz]);
        let sheared = |axis: usize, shear: Vec4| -> [Vec4; 3] {
            std::array::from_fn(|i| leaf.corners[axis][i] - self.origin[axis] - z[i] * shear)
        };
        let (x, y) = (sheared(kx, self.shear[0]), sheared(ky, self.shear[1]));
        let mut edges = [x[2] * y[1] - y[2] * x[1], x[0] * y[2] - y[0] * x[2], x[1] * y[0] - y[1] * x[0]];
        let zero = Vec4::ZERO;
        let doubtful = edges[0].cmpeq(zero) | edges[1].cmpeq(zero) | edges[2].cmpeq(zero);
        if doubtful.any() {
            take_again(doubtful.bitmask(), &x, &y, &mut edges);
        }
        let (least, most) = (edges[0].min(edges[1]).min(edges[2]), edges[0].max(edges[1]).max(edges[2]));
        let inside = !(least.cmplt(zero) & most.cmpgt(zero));
        if !inside.any() {
            return (0, zero, edges);
        }
        let sum = edges[0] + edges[1] + edges[2];
        let t = (edges[0] * z[0] + edges[1] * z[1] + edges[2] * z[2]) * self.inverse_z / sum;
        // Edge-on triangles give NaN, which fails here.
        ((inside & t.cmpgt(zero) & t.cmple(Vec4::splat(within))).bitmask(), t, edges)
    }
}

/// The edge functions of the triangles of `mask` in f64.
#[cold]
#[inline(never)]
fn take_again(mask: u32, x: &[Vec4; 3], y: &[Vec4; 3], edges: &mut [Vec4; 3]) {
    for i in (0..IN_LEAF).filter(|i| mask >> i & 1 == 1) {
        let (x, y) = (x.map(|x| f64::from(x[i])), y.map(|y| f64::from(y[i])));
        edges[0][i] = (x[2] * y[1] - y[2] * x[1]) as f32;
        edges[1][i] = (x[0] * y[2] - y[0] * x[2]) as f32;
        edges[2][i] = (x[1] * y[0] - y[1] * x[0]) as f32;
    }
}

/// A triangle that a ray meets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Met {
    pub(super) distance: f32,
    pub(super) triangle: u32,
    pub(super) u: f32,
    pub(super) v: f32,
}

impl Wide {
    /// Whether any triangle lies nearer than `within`, or there.
    #[inline(always)]
    pub(super) fn any(&self, ray: &Ray, within: f32) -> bool {
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
                    let (mut met, _) = ray.boxes(node, within);
                    if met != 0 {
                        stack.make_room();
                        next = node.children[take_lowest(&mut met) % WIDTH];
                        while met != 0 {
                            stack.push(next);
                            next = node.children[take_lowest(&mut met) % WIDTH];
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

    /// The nearest triangle; of equally near ones the first of the mesh.
    #[inline(always)]
    pub(super) fn closest(&self, ray: &Ray) -> Option<Met> {
        let mut best = Met { distance: f32::MAX, triangle: u32::MAX, u: 0.0, v: 0.0 };
        let mut stack = Stack::<Waiting>::new();
        let mut next = self.root;
        'descent: loop {
            match next.leaf_or_node() {
                Ok(leaf) => best.take(ray, &self.leaves[leaf]),
                Err(node) => {
                    let node = &self.nodes[node];
                    let (mut met, entered) = ray.boxes(node, best.distance);
                    if met != 0 {
                        stack.make_room();
                        let start = stack.len;
                        let mut nearest = Waiting::take(node, &mut met, &entered);
                        while met != 0 {
                            let mut farther = Waiting::take(node, &mut met, &entered);
                            if farther.entered < nearest.entered {
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
                    Some(waiting) if waiting.entered <= best.distance => {
                        next = waiting.child;
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

#[inline(always)]
fn take_lowest(bits: &mut u32) -> usize {
    let lowest = bits.trailing_zeros() as usize;
    *bits &= *bits - 1;
    lowest
}

impl Met {
    /// Takes the nearest triangle of `leaf` if it is nearer.
    #[inline(always)]
    fn take(&mut self, ray: &Ray, leaf: &Leaf) {
        let (mut met, distances, edges) = ray.triangles(leaf, self.distance);
        while met != 0 {
            let i = take_lowest(&mut met) % IN_LEAF;
            let (distance, triangle) = (distances[i], leaf.triangles[i]);
            if distance < self.distance || (distance == self.distance && triangle < self.triangle) {
                let [a, b, c] = edges.map(|e| e[i]);
                let sum = a + b + c;
                *self = Self { distance, triangle, u: b / sum, v: c / sum };
            }
        }
    }
}

/// A box that waits, and where the ray enters it.
#[derive(Debug, Clone, Copy, Default)]
struct Waiting {
    child: Child,
    entered: f32,
}

impl Waiting {
    #[inline(always)]
    fn take(node: &Node, met: &mut u32, entered: &[f32; WIDTH]) -> Self {
        let i = take_lowest(met) % WIDTH;
        Self { child: node.children[i], entered: entered[i] }
    }
}

/// What waits, the next one last.
struct Stack<T> {
    waiting: [T; WAITING],
    len: usize,
    /// Those below: only hostile geometry makes so many.
    spilled: Vec<T>,
}

impl<T: Copy + Default> Stack<T> {
    #[inline(always)]
    fn new() -> Self {
        Self { waiting: [T::default(); WAITING], len: 0, spilled: Vec::new() }
    }

    /// Makes room for the boxes of a node.
    #[inline(always)]
    fn make_room(&mut self) {
        if self.len > WAITING - WIDTH {
            spill(&mut self.spilled, &self.waiting[..self.len]);
            self.len = 0;
        }
    }

    #[inline(always)]
    fn push(&mut self, one: T) {
        self.waiting[self.len] = one;
        self.len += 1;
    }

    #[inline(always)]
    fn pop(&mut self) -> Option<T> {
        if self.len == 0 {
            return self.spilled.pop();
        }
        self.len -= 1;
        Some(self.waiting[self.len])
    }
}

impl Stack<Waiting> {
    /// Keeps what waits from `start` on in order, the nearest last.
    #[inline(always)]
    fn insert(&mut self, start: usize, one: Waiting) {
        let mut slot = self.len;
        while slot > start && self.waiting[slot - 1].entered < one.entered {
            self.waiting[slot] = self.waiting[slot - 1];
            slot -= 1;
        }
        self.waiting[slot] = one;
        self.len += 1;
    }
}

/// What waits on the heap waits below. A function of its own, to which only slices are lent, so that the rest of the
/// stack can live in registers.
#[cold]
#[inline(never)]
fn spill<T: Copy>(spilled: &mut Vec<T>, waiting: &[T]) {
    spilled.extend_from_slice(waiting);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_than_fits_waits_in_order() {
        let mut stack = Stack::<u32>::new();
        let count = 10 * WAITING as u32;
        for i in 0..count {
            stack.make_room();
            stack.push(i);
        }
        assert!(stack.spilled.len() > 8 * WAITING);
        for i in (0..count).rev() {
            assert_eq!(stack.pop(), Some(i));
        }
        assert_eq!(stack.pop(), None);
    }

    #[test]
    fn the_nearest_box_is_next() {
        let mut stack = Stack::<Waiting>::new();
        let below = Waiting { entered: 0.5, ..Waiting::default() };
        stack.push(below);
        for entered in [3.0, 1.0, 4.0, 1.0, 5.0, 2.0] {
            stack.insert(1, Waiting { entered, ..Waiting::default() });
        }
        let order: Vec<f32> = std::iter::from_fn(|| stack.pop()).map(|w| w.entered).collect();
        assert_eq!(order, [1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 0.5]);
    }
}
