//! A bounding volume hierarchy with eight boxes per node and four triangles per leaf, laid out for SIMD tests.

use glam::{Vec3A, Vec4};
use obvhs::bvh2::Bvh2;

/// Boxes per node.
pub(super) const WIDTH: usize = 8;
/// A number for each box of a node.
pub(super) type Lanes = [f32; WIDTH];
/// Triangles per leaf.
pub(super) const IN_LEAF: usize = 4;
/// Cost of testing the triangles of a leaf relative to testing the boxes of a node.
const LEAF_COST: f32 = 1.0;

/// Reference to a leaf or a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Child(u32);

impl Child {
    const LEAF: u32 = 1 << 31;

    /// `Ok`: index of a leaf; `Err`: index of a node.
    #[inline(always)]
    pub(super) fn leaf_or_node(self) -> Result<usize, usize> {
        if self.0 & Self::LEAF != 0 { Ok((self.0 & !Self::LEAF) as usize) } else { Err(self.0 as usize) }
    }
}

impl Default for Child {
    fn default() -> Self {
        Self(u32::MAX)
    }
}

/// Eight boxes and their children.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Node {
    /// `[axis][lower, upper]`; an empty slot is an inverted box, which no ray hits.
    pub(super) planes: [[Lanes; 2]; 3],
    pub(super) children: [Child; WIDTH],
}

/// Four triangles.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub(super) struct Leaf {
    /// `[axis][corner][triangle]`; an empty slot is NaN, which no ray hits.
    pub(super) corners: [[Vec4; 3]; 3],
    /// Indices into the mesh's triangles.
    pub(super) triangles: [u32; IN_LEAF],
}

impl Leaf {
    /// A leaf of the first four `triangles`: index and corners.
    pub(super) fn new(triangles: impl Iterator<Item = (u32, [Vec3A; 3])>) -> Self {
        let mut leaf = Self { corners: [[Vec4::NAN; 3]; 3], triangles: [u32::MAX; IN_LEAF] };
        for (slot, (index, corners)) in triangles.take(IN_LEAF).enumerate() {
            leaf.triangles[slot] = index;
            for (c, corner) in corners.into_iter().enumerate() {
                for axis in 0..3 {
                    leaf.corners[axis][c][slot] = corner[axis];
                }
            }
        }
        leaf
    }
}

/// The hierarchy.
#[derive(Debug, Default)]
pub(super) struct Wide {
    pub(super) nodes: Vec<Node>,
    pub(super) leaves: Vec<Leaf>,
    pub(super) root: Child,
}

impl Wide {
    /// Collapses a binary hierarchy with one triangle per leaf; `triangle` returns index and corners of a primitive.
    pub(super) fn new(mut binary: Bvh2, triangle: impl Fn(u32) -> (u32, [Vec3A; 3])) -> Self {
        binary.reorder_in_stack_traversal_order();
        let cuts = cheapest_cuts(&binary);
        let mut wide = Self::default();
        let mut open = vec![(0, None)];
        while let Some((root, slot)) = open.pop() {
            let child = match children(&binary, &cuts, root) {
                None => {
                    wide.leaves.push(Leaf::new(primitives(&binary, root).into_iter().map(&triangle)));
                    Child((wide.leaves.len() - 1) as u32 | Child::LEAF)
                }
                Some(children) => {
                    let node = wide.nodes.len();
                    wide.nodes.push(boxes(&binary, &children));
                    open.extend(children.into_iter().enumerate().rev().map(|(i, c)| (c, Some((node, i)))));
                    Child(node as u32)
                }
            };
            match slot {
                None => wide.root = child,
                Some((node, i)) => wide.nodes[node].children[i] = child,
            }
        }
        wide
    }
}

/// `[binary node][i]`: the best way to represent the subtree of the binary node by at most i + 1 boxes of one wide node, given
/// as the number of boxes for its first child. 0 for i > 0: i boxes are as good; 0 for i = 0: the single box is a leaf. Else
/// for i = 0 the single box is a wide node, whose eight boxes are divided.
type Cuts = Vec<[u8; WIDTH]>;

/// The cuts with the smallest expected number of tests, bottom up: Ylitie, Karras and Laine, "Efficient Incoherent Ray
/// Traversal on GPUs Through Compressed Wide BVHs" (HPG 2017), section 3.1.
fn cheapest_cuts(binary: &Bvh2) -> Cuts {
    let count = binary.nodes.len();
    let mut costs = vec![[0.0f32; WIDTH]; count];
    let mut under = vec![0usize; count];
    let mut cuts = vec![[0u8; WIDTH]; count];
    // Children follow their parents.
    for i in (0..count).rev() {
        let node = &binary.nodes[i];
        let area = node.aabb().half_area();
        if node.is_leaf() {
            (under[i], costs[i]) = (node.prim_count as usize, [area * LEAF_COST; WIDTH]);
            continue;
        }
        let first = node.first_index as usize;
        under[i] = under[first] + under[first + 1];
        let mut cost = [f32::INFINITY; WIDTH];
        for boxes in 1..WIDTH {
            for cut in 1..=boxes {
                let c = costs[first][cut - 1] + costs[first + 1][boxes - cut];
                if c < cost[boxes] {
                    (cost[boxes], cuts[i][boxes]) = (c, cut as u8);
                }
            }
        }
        let node_cost = cost[WIDTH - 1] + area;
        let leaf_cost = if under[i] <= IN_LEAF { area * LEAF_COST } else { f32::INFINITY };
        (cost[0], cuts[i][0]) = if leaf_cost <= node_cost { (leaf_cost, 0) } else { (node_cost, cuts[i][WIDTH - 1]) };
        for boxes in 1..WIDTH {
            if cost[boxes - 1] <= cost[boxes] {
                (cost[boxes], cuts[i][boxes]) = (cost[boxes - 1], 0);
            }
        }
        costs[i] = cost;
    }
    cuts
}

/// The binary nodes whose boxes form the wide node of `root`; `None` if `root` is a leaf.
fn children(binary: &Bvh2, cuts: &Cuts, root: usize) -> Option<Vec<usize>> {
    let cut = usize::from(cuts[root][0]);
    let first = binary.nodes[root].first_index as usize;
    (cut > 0).then(|| {
        let mut found = Vec::with_capacity(WIDTH);
        cut_into(binary, cuts, first, cut, &mut found);
        cut_into(binary, cuts, first + 1, WIDTH - cut, &mut found);
        found
    })
}

/// Appends the at most `boxes` binary nodes that represent the subtree of `root`.
fn cut_into(binary: &Bvh2, cuts: &Cuts, root: usize, boxes: usize, found: &mut Vec<usize>) {
    match (1..boxes).rev().find(|&more| cuts[root][more] > 0) {
        None => found.push(root),
        Some(more) => {
            let (first, cut) = (binary.nodes[root].first_index as usize, usize::from(cuts[root][more]));
            cut_into(binary, cuts, first, cut, found);
            cut_into(binary, cuts, first + 1, more + 1 - cut, found);
        }
    }
}

fn boxes(binary: &Bvh2, children: &[usize]) -> Node {
    let empty = [[f32::MAX; WIDTH], [f32::MIN; WIDTH]];
    let mut node = Node { planes: [empty; 3], children: [Child::default(); WIDTH] };
    for (i, child) in children.iter().enumerate() {
        let aabb = binary.nodes[*child].aabb();
        for axis in 0..3 {
            node.planes[axis][0][i] = aabb.min[axis];
            node.planes[axis][1][i] = aabb.max[axis];
        }
    }
    node
}

fn primitives(binary: &Bvh2, root: usize) -> Vec<u32> {
    let mut found = Vec::with_capacity(IN_LEAF);
    let mut open = vec![root];
    while let Some(i) = open.pop() {
        let (node, first) = (&binary.nodes[i], binary.nodes[i].first_index as usize);
        if node.is_leaf() {
            found.extend(&binary.primitive_indices[first..first + node.prim_count as usize]);
        } else {
            open.extend([first + 1, first]);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use obvhs::aabb::Aabb;
    use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};
    use proptest::prelude::*;

    /// Collects the triangles below a child and checks that each is inside the boxes above it.
    fn below(wide: &Wide, child: Child, found: &mut Vec<u32>) -> Aabb {
        let mut aabb = Aabb::empty();
        match child.leaf_or_node() {
            Ok(leaf) => {
                let leaf = &wide.leaves[leaf];
                for slot in (0..IN_LEAF).filter(|&s| leaf.triangles[s] != u32::MAX) {
                    found.push(leaf.triangles[slot]);
                    for c in 0..3 {
                        aabb.extend(Vec3A::from_array([0, 1, 2].map(|axis| leaf.corners[axis][c][slot])));
                    }
                }
            }
            Err(node) => {
                let node = &wide.nodes[node];
                for (i, child) in node.children.iter().enumerate().filter(|(_, c)| **c != Child::default()) {
                    let inside = below(wide, *child, found);
                    let plane = |side: usize| Vec3A::from_array([0, 1, 2].map(|a| node.planes[a][side][i]));
                    assert!(plane(0).cmple(inside.min).all() && plane(1).cmpge(inside.max).all());
                    aabb = aabb.union(&inside);
                }
            }
        }
        aabb
    }

    proptest! {
        /// Every triangle is in exactly one leaf and inside all boxes above it.
        #[test]
        fn holds_every_triangle_once(seeds in prop::collection::vec(prop::array::uniform9(-1f32..1.0), 1..300)) {
            let triangles: Vec<[Vec3A; 3]> = seeds
                .iter()
                .map(|s| {
                    let middle = Vec3A::new(s[0], s[1], s[2]);
                    [middle, middle + 0.1 * Vec3A::new(s[3], s[4], s[5]), middle + 0.1 * Vec3A::new(s[6], s[7], s[8])]
                })
                .collect();
            let boxes: Vec<Aabb> =
                triangles.iter().map(|[a, b, c]| Aabb::new(a.min(*b).min(*c), a.max(*b).max(*c))).collect();
            let indices = (0..boxes.len() as u32).collect();
            let binary =
                PlocBuilder::new().build(PlocSearchDistance::Medium, &boxes, indices, SortPrecision::U64, 0);
            let wide = Wide::new(binary, |i| (i, triangles[i as usize]));
            let mut found = Vec::new();
            below(&wide, wide.root, &mut found);
            found.sort_unstable();
            prop_assert!(found.iter().copied().eq(0..triangles.len() as u32));
        }
    }
}
