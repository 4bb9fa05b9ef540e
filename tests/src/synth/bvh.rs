//! A four-wide bounding-volume hierarchy over triangles, built by binned surface-area heuristic.

use glam::Vec3;
use recordings::types::Mesh;

/// Where a ray meets the mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Ray parameter: metres where the direction is a unit vector.
    pub distance: f32,
    /// Index into the mesh's triangles.
    pub triangle: u32,
    /// Barycentric weights of the triangle's three vertices.
    pub weights: [f32; 3],
}

/// Four children; those that are not there have inverted boxes.
#[derive(Debug, Clone, Copy)]
struct Node {
    /// Lower bounds: `low[axis][child]`.
    low: [[f32; 4]; 3],
    high: [[f32; 4]; 3],
    /// Leaf: first triangle in `order`. Inner: index of the node.
    first: [u32; 4],
    /// Triangles of a leaf, 0 for an inner node.
    count: [u32; 4],
}

/// A range of `order` while the hierarchy is built.
#[derive(Debug, Clone, Copy)]
struct Range {
    start: usize,
    end: usize,
    min: Vec3,
    max: Vec3,
}

#[derive(Debug, Clone, Copy)]
struct Corner {
    a: Vec3,
    ab: Vec3,
    ac: Vec3,
}

/// The hierarchy; it holds its own copy of the triangles.
#[derive(Debug, Clone)]
pub struct Bvh {
    nodes: Vec<Node>,
    order: Vec<u32>,
    corners: Vec<Corner>,
}

const BINS: usize = 16;
const LEAF: usize = 4;

impl Bvh {
    /// Builds the hierarchy of a mesh (which may be empty).
    #[must_use]
    pub fn new(mesh: &Mesh) -> Self {
        let corners: Vec<[Vec3; 3]> = mesh.triangles.iter().map(|t| t.map(|i| mesh.positions[i as usize])).collect();
        let mut order: Vec<u32> = (0..corners.len() as u32).collect();
        let mut nodes = vec![Node::EMPTY];
        let mut open = vec![(0usize, bounds(&corners, &order, 0, order.len()))];
        while let Some((index, range)) = open.pop() {
            for (slot, child) in children(&corners, &mut order, range).into_iter().enumerate() {
                let leaf = child.end - child.start <= LEAF;
                let first = if leaf { child.start } else { nodes.len() };
                if !leaf {
                    nodes.push(Node::EMPTY);
                    open.push((first, child));
                }
                let node = &mut nodes[index];
                for axis in 0..3 {
                    node.low[axis][slot] = child.min[axis];
                    node.high[axis][slot] = child.max[axis];
                }
                node.first[slot] = first as u32;
                node.count[slot] = if leaf { (child.end - child.start) as u32 } else { 0 };
            }
        }
        let corners = order
            .iter()
            .map(|&t| {
                let [a, b, c] = corners[t as usize];
                Corner { a, ab: b - a, ac: c - a }
            })
            .collect();
        Self { nodes, order, corners }
    }

    /// The nearest hit with `0 < distance < limit`.
    #[must_use]
    pub fn closest(&self, origin: Vec3, direction: Vec3, limit: f32) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        self.visit(origin, direction, limit, |hit| {
            best = Some(hit);
            Some(hit.distance)
        });
        best
    }

    /// True if anything lies within `0 < distance < limit`.
    #[must_use]
    pub fn occluded(&self, origin: Vec3, direction: Vec3, limit: f32) -> bool {
        let mut any = false;
        self.visit(origin, direction, limit, |_| {
            any = true;
            None
        });
        any
    }

    /// Calls `found` with ever nearer hits; it returns the new limit, or `None` to stop.
    fn visit(&self, origin: Vec3, direction: Vec3, mut limit: f32, mut found: impl FnMut(Hit) -> Option<f32>) {
        let inverse = direction.recip();
        // A node leaves at most three of its children waiting.
        let mut stack = [(0u32, 0u32, 0.0f32); 192];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let (first, count, near) = stack[depth];
            if near >= limit {
                continue;
            }
            if count > 0 {
                for k in first..first + count {
                    if let Some(hit) = self.intersect(k as usize, origin, direction, limit) {
                        match found(hit) {
                            Some(nearer) => limit = nearer,
                            None => return,
                        }
                    }
                }
                continue;
            }
            let node = &self.nodes[first as usize];
            let entries = node.entries(origin, inverse, limit);
            let bottom = depth;
            for (slot, &entry) in entries.iter().enumerate() {
                if entry < f32::INFINITY {
                    // Insertion keeps the nearest on top.
                    let mut at = depth;
                    while at > bottom && stack[at - 1].2 < entry {
                        stack[at] = stack[at - 1];
                        at -= 1;
                    }
                    stack[at] = (node.first[slot], node.count[slot], entry);
                    depth += 1;
                }
            }
        }
    }

    /// Möller–Trumbore, two-sided.
    fn intersect(&self, k: usize, origin: Vec3, direction: Vec3, limit: f32) -> Option<Hit> {
        const SLACK: f32 = 1e-6;
        let Corner { a, ab, ac } = self.corners[k];
        let p = direction.cross(ac);
        let inverse = 1.0 / ab.dot(p);
        let s = origin - a;
        let v = s.dot(p) * inverse;
        let q = s.cross(ab);
        let w = direction.dot(q) * inverse;
        let distance = ac.dot(q) * inverse;
        let inside = v >= -SLACK && w >= -SLACK && v + w <= 1.0 + SLACK && distance > 0.0 && distance < limit;
        inside.then(|| Hit { distance, triangle: self.order[k], weights: [1.0 - v - w, v, w] })
    }
}

impl Node {
    const EMPTY: Self =
        Self { low: [[f32::INFINITY; 4]; 3], high: [[f32::NEG_INFINITY; 4]; 3], first: [0; 4], count: [0; 4] };

    /// Where the ray enters each child; infinity where it passes by.
    fn entries(&self, origin: Vec3, inverse: Vec3, limit: f32) -> [f32; 4] {
        let (mut near, mut far) = ([0.0f32; 4], [limit; 4]);
        for axis in 0..3 {
            let (o, i) = (origin[axis], inverse[axis]);
            // Which bound comes first is the same for all four.
            let (first, last) = if i < 0.0 { (&self.high, &self.low) } else { (&self.low, &self.high) };
            for slot in 0..4 {
                let enter = (first[axis][slot] - o) * i;
                let leave = (last[axis][slot] - o) * i;
                near[slot] = if enter > near[slot] { enter } else { near[slot] };
                far[slot] = if leave < far[slot] { leave } else { far[slot] };
            }
        }
        // A hair of slack: rays along a box's face must not slip through.
        std::array::from_fn(|s| if near[s] <= far[s] * (1.0 + 4.0 * f32::EPSILON) { near[s] } else { f32::INFINITY })
    }
}

fn bounds(corners: &[[Vec3; 3]], order: &[u32], start: usize, end: usize) -> Range {
    let (mut min, mut max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for p in order[start..end].iter().flat_map(|&t| corners[t as usize]) {
        min = min.min(p);
        max = max.max(p);
    }
    Range { start, end, min, max }
}

/// Splits a range into up to four, the largest box first.
fn children(corners: &[[Vec3; 3]], order: &mut [u32], range: Range) -> Vec<Range> {
    let mut parts = vec![range];
    while parts.len() < 4 {
        let wide = |r: &Range| if r.end - r.start > LEAF { area(r.min, r.max) } else { -1.0 };
        let Some(k) = (0..parts.len()).max_by(|&a, &b| wide(&parts[a]).total_cmp(&wide(&parts[b]))) else { break };
        let Range { start, end, .. } = parts[k];
        let Some(middle) = split(corners, &mut order[start..end]) else { break };
        parts[k] = bounds(corners, order, start, start + middle);
        parts.push(bounds(corners, order, start + middle, end));
    }
    parts.retain(|r| r.end > r.start);
    parts
}

fn area(min: Vec3, max: Vec3) -> f32 {
    let d = (max - min).max(Vec3::ZERO);
    d.x * d.y + d.y * d.z + d.z * d.x
}

/// Partitions `order` at the cheapest of the bin borders; the split position, or `None` for a leaf.
fn split(corners: &[[Vec3; 3]], order: &mut [u32]) -> Option<usize> {
    if order.len() <= LEAF {
        return None;
    }
    let centre = |t: u32| {
        let [a, b, c] = corners[t as usize];
        (a.min(b).min(c) + a.max(b).max(c)) * 0.5
    };
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for &t in order.iter() {
        low = low.min(centre(t));
        high = high.max(centre(t));
    }
    let mut best: Option<(f32, usize, f32)> = None;
    for axis in 0..3 {
        let extent = high[axis] - low[axis];
        if extent <= 0.0 {
            continue;
        }
        let mut bins = [(Vec3::INFINITY, Vec3::NEG_INFINITY, 0usize); BINS];
        for &t in order.iter() {
            let bin = &mut bins[bin_of(centre(t)[axis], low[axis], extent)];
            for p in corners[t as usize] {
                bin.0 = bin.0.min(p);
                bin.1 = bin.1.max(p);
            }
            bin.2 += 1;
        }
        let sweep = |bins: &mut dyn Iterator<Item = &(Vec3, Vec3, usize)>| {
            let (mut min, mut max, mut n) = (Vec3::INFINITY, Vec3::NEG_INFINITY, 0);
            let costs: Vec<f32> = bins
                .map(|b| {
                    min = min.min(b.0);
                    max = max.max(b.1);
                    n += b.2;
                    if n == 0 { 0.0 } else { area(min, max) * n as f32 }
                })
                .collect();
            costs
        };
        let left = sweep(&mut bins.iter());
        let right = sweep(&mut bins.iter().rev());
        for border in 1..BINS {
            let cost = left[border - 1] + right[BINS - 1 - border];
            if best.is_none_or(|b| cost < b.0) {
                best = Some((cost, axis, border as f32));
            }
        }
    }
    // All centres in one point: any halves do.
    let Some((_, axis, border)) = best else { return Some(order.len() / 2) };
    let extent = high[axis] - low[axis];
    let mut middle = 0;
    for k in 0..order.len() {
        if (bin_of(centre(order[k])[axis], low[axis], extent) as f32) < border {
            order.swap(k, middle);
            middle += 1;
        }
    }
    if middle == 0 || middle == order.len() { Some(order.len() / 2) } else { Some(middle) }
}

fn bin_of(x: f32, low: f32, extent: f32) -> usize {
    (((x - low) / extent * BINS as f32) as usize).min(BINS - 1)
}
