//! An editable triangle mesh: edge split, collapse and flip. Edges with more than two triangles are left as they are.

use glam::Vec3;
use rayon::prelude::*;
use smallvec::SmallVec;

/// Passes over all short edges; a pass at least halves a fan of needles.
const COLLAPSE_PASSES: usize = 8;
/// Edges that are checked at once before some of them collapse.
const BATCH: usize = 4096;
/// Smallest cosine between two triangles whose common edge may be flipped.
const FLAT_COSINE: f32 = 0.9;
/// Sum of the cosines of opposite angles below which an edge is not Delaunay: exactly 0 is 180° together.
const DELAUNAY_COSINES: f32 = -1e-3;
/// Smallest cosine between a triangle and its vertex's mean normal for the vertex to be smoothed.
const SMOOTH_COSINE: f32 = 0.7;
/// Smallest cosine between a triangle's normals before and after a collapse.
const KEPT_SIDE_COSINE: f32 = 0.7;
/// A collapse may reduce the roundness of a triangle by this factor, counted from at most [`ROUND_ENOUGH`].
const ROUNDNESS_LOSS: f32 = 0.7;
const ROUND_ENOUGH: f32 = 0.2;
/// Largest deviation of a removed border vertex from the new border, in longest edges ...
const BORDER_DEVIATION: f32 = 0.25;
/// ... unless the border turns by less than the angle of this cosine there.
const BORDER_COSINE: f32 = 0.8;

/// The triangles of a vertex: rarely more than ten, which need no memory of their own.
type Ring = SmallVec<[u32; 10]>;
/// The far corners of a vertex's triangles, ascending: an inner neighbour stands twice, one on the border once.
type Corners = SmallVec<[u32; 24]>;

/// Every vertex keeps a list of its triangles, so neither orientation nor manifoldness is assumed.
pub struct Surface {
    /// Vertex positions, `[vertex]`; vertices without triangles are unused.
    pub positions: Vec<Vec3>,
    triangles: Vec<Option<[u32; 3]>>,
    rings: Vec<Ring>,
}

impl Surface {
    /// Takes triangles with valid, distinct corners.
    pub fn new(positions: Vec<Vec3>, triangles: &[[u32; 3]]) -> Self {
        let mut rings = vec![Ring::new(); positions.len()];
        for (t, corners) in triangles.iter().enumerate() {
            for &c in corners {
                rings[c as usize].push(t as u32);
            }
        }
        Self { positions, triangles: triangles.iter().map(|t| Some(*t)).collect(), rings }
    }

    /// The remaining triangles.
    pub fn triangles(&self) -> Vec<[u32; 3]> {
        self.triangles.iter().copied().flatten().collect()
    }

    /// Splits edges longer than `longest` at their middle, longest edge of a triangle first, up to `limit` vertices.
    pub fn split_long(&mut self, longest: f32, limit: usize) {
        let mut t = 0;
        while t < self.triangles.len() && self.positions.len() < limit {
            let Some(c) = self.triangles[t] else {
                t += 1;
                continue;
            };
            let (length, a, b) = [(c[0], c[1]), (c[1], c[2]), (c[2], c[0])]
                .map(|(a, b)| (self.length(a, b), a, b))
                .into_iter()
                .fold((0.0, 0, 0), |best, e| if e.0 > best.0 { e } else { best });
            if length > longest {
                self.split(a, b);
            } else {
                t += 1;
            }
        }
    }

    fn split(&mut self, a: u32, b: u32) {
        let middle = self.positions.len() as u32;
        self.positions.push(0.5 * (self.positions[a as usize] + self.positions[b as usize]));
        self.rings.push(Ring::new());
        for t in self.shared(a, b) {
            let Some(corners) = self.triangles[t as usize] else { continue };
            let new = self.triangles.len() as u32;
            self.triangles.push(Some(corners.map(|c| if c == a { middle } else { c })));
            self.triangles[t as usize] = Some(corners.map(|c| if c == b { middle } else { c }));
            let far = corners.into_iter().find(|&c| c != a && c != b);
            self.rings[b as usize].iter_mut().filter(|r| **r == t).for_each(|r| *r = new);
            self.rings[middle as usize].extend([t, new]);
            if let Some(far) = far {
                self.rings[far as usize].push(new);
            }
        }
    }

    /// Collapses edges shorter than `shortest` if that keeps the topology, flips no triangle and makes no edge longer than
    /// `longest`.
    pub fn collapse_short(&mut self, shortest: f32, longest: f32) {
        let mut changed = vec![0; self.positions.len()];
        for pass in 1..=COLLAPSE_PASSES {
            let mut collapsed = false;
            for t in 0..self.triangles.len() {
                let Some(c) = self.triangles[t] else { continue };
                // What failed before fails again while its surroundings are the same.
                if c.iter().all(|&c| changed[c as usize] + 1 < pass) {
                    continue;
                }
                for (a, b) in [(c[0], c[1]), (c[1], c[2]), (c[2], c[0])] {
                    let anew = changed[a as usize].max(changed[b as usize]) + 1 >= pass;
                    if anew && self.length(a, b) < shortest && self.collapse(a, b, longest) {
                        self.mark(a, pass, &mut changed);
                        collapsed = true;
                        break;
                    }
                }
            }
            if !collapsed {
                break;
            }
        }
    }

    /// Sets the mark of a vertex and its neighbours, whose triangles a collapse has changed.
    fn mark(&self, a: u32, pass: usize, changed: &mut [usize]) {
        let corners = self.rings[a as usize].iter().filter_map(|&t| self.triangles[t as usize]).flatten();
        corners.for_each(|c| changed[c as usize] = pass);
    }

    /// Number of vertices with a triangle.
    fn vertices(&self) -> usize {
        self.rings.iter().filter(|r| !r.is_empty()).count()
    }

    /// Every edge once for which `keep` holds, with its length, shortest first.
    fn edges_by_length(&self, keep: impl Fn(u32, u32) -> bool + Sync) -> Vec<(f32, u32, u32)> {
        let sides = |c: &[u32; 3]| [(c[0], c[1]), (c[1], c[2]), (c[2], c[0])].map(|(a, b)| (a.min(b), a.max(b)));
        let kept = self.triangles.par_iter().flatten_iter().flat_map_iter(sides).filter(|&(a, b)| keep(a, b));
        let mut edges: Vec<_> = kept.map(|(a, b)| (self.length(a, b), a, b)).collect();
        edges.par_sort_unstable_by(|x, y| x.0.total_cmp(&y.0).then((x.1, x.2).cmp(&(y.1, y.2))));
        edges.dedup();
        edges
    }

    /// Collapses the shortest edges until `most` vertices are left, under the conditions of [`Self::collapse_short`].
    pub fn collapse_to(&mut self, most: usize, longest: f32) {
        let mut left = self.vertices();
        let mut before = usize::MAX;
        let mut changed = vec![0; self.positions.len()];
        let mut pass = 1;
        while left > most && left < before {
            before = left;
            let edges = self.edges_by_length(|a, b| changed[a as usize].max(changed[b as usize]) + 1 >= pass);
            // What a batch can collapse is looked up by all threads, and again where an earlier collapse changed the surroundings.
            for batch in edges.chunks(BATCH) {
                // Earlier collapses may have moved or removed an end.
                let kept = |&&(length, a, b): &&(f32, u32, u32)| self.length(a, b) <= length;
                let possible = |&&(_, a, b): &&(f32, u32, u32)| self.collapsed(a, b, longest).is_some();
                let edges: Vec<_> = batch.par_iter().filter(kept).filter(possible).copied().collect();
                for (length, a, b) in edges {
                    if left > most && self.length(a, b) <= length && self.collapse(a, b, longest) {
                        self.mark(a, pass, &mut changed);
                        left -= 1;
                    }
                }
                if left <= most {
                    return;
                }
            }
            pass += 1;
        }
    }

    /// Splits the longest edges until there are `least` vertices, each at most once.
    pub fn split_to(&mut self, least: usize) {
        let missing = least.saturating_sub(self.vertices());
        if missing > 0 {
            for &(_, a, b) in self.edges_by_length(|_, _| true).iter().rev().take(missing) {
                self.split(a, b);
            }
        }
    }

    /// Where the vertex stands that an edge collapses to, and the triangles that vanish; `None` if it may not collapse.
    fn collapsed(&self, a: u32, b: u32, longest: f32) -> Option<(Vec3, SmallVec<[u32; 4]>)> {
        let shared = self.shared(a, b);
        // An edge of three triangles.
        if shared.is_empty() || shared.len() > 2 {
            return None;
        }
        let (mut na, mut nb) = (self.corners(a), self.corners(b));
        let (on_a, on_b) = (is_open(&na), is_open(&nb));
        // Two borders that would be pinched together.
        if on_a && on_b && shared.len() == 2 {
            return None;
        }
        let (pa, pb) = (self.positions[a as usize], self.positions[b as usize]);
        // Border vertices do not move.
        let target = match (on_a, on_b) {
            (true, false) => pa,
            (false, true) => pb,
            _ => 0.5 * (pa + pb),
        };
        na.dedup();
        nb.dedup();
        let far = |n: &[u32]| n.iter().any(|&k| self.positions[k as usize].distance(target) > longest);
        if far(&na) || far(&nb) || in_both(&na, &nb) != shared.len() {
            return None;
        }
        if on_a && on_b && !(self.border_is_straight(a, b, longest) && self.border_is_straight(b, a, longest)) {
            return None;
        }
        for &(v, other) in &[(a, b), (b, a)] {
            for &t in &self.rings[v as usize] {
                let Some(corners) = self.triangles[t as usize] else { continue };
                if corners.contains(&other) {
                    continue;
                }
                let old = corners.map(|c| self.positions[c as usize]);
                let new = corners.map(|c| if c == v { target } else { self.positions[c as usize] });
                if !keeps_side(old, new) {
                    return None;
                }
            }
        }
        Some((target, shared))
    }

    fn collapse(&mut self, a: u32, b: u32, longest: f32) -> bool {
        let Some((target, shared)) = self.collapsed(a, b, longest) else { return false };
        for t in shared {
            self.remove(t);
        }
        let moved = std::mem::take(&mut self.rings[b as usize]);
        for t in moved {
            if let Some(corners) = &mut self.triangles[t as usize] {
                corners.iter_mut().filter(|c| **c == b).for_each(|c| *c = a);
                self.rings[a as usize].push(t);
            }
        }
        self.positions[a as usize] = target;
        true
    }

    fn remove(&mut self, t: u32) {
        if let Some(corners) = self.triangles[t as usize].take() {
            for c in corners {
                self.rings[c as usize].retain(|r| *r != t);
            }
        }
    }

    /// Flips inner edges that are not Delaunay if the surface is flat enough for either diagonal.
    pub fn flip_edges(&mut self) {
        for t in 0..self.triangles.len() {
            let Some(c) = self.triangles[t] else { continue };
            for (a, b) in [(c[0], c[1]), (c[1], c[2]), (c[2], c[0])] {
                if a < b && self.flip(a, b) {
                    break;
                }
            }
        }
    }

    fn flip(&mut self, a: u32, b: u32) -> bool {
        let Some([s, t]) = self.both(a, b) else { return false };
        let (Some(cs), Some(ct)) = (self.triangles[s as usize], self.triangles[t as usize]) else { return false };
        // s runs along a → b, t along b → a.
        let (s, t, cs, ct) = if runs_along(cs, a, b) { (s, t, cs, ct) } else { (t, s, ct, cs) };
        if !runs_along(cs, a, b) || !runs_along(ct, b, a) {
            return false;
        }
        let third = |t: [u32; 3]| t.into_iter().find(|&x| x != a && x != b);
        let (Some(c), Some(d)) = (third(cs), third(ct)) else { return false };
        let [pa, pb, pc, pd] = [a, b, c, d].map(|i| self.positions[i as usize]);
        let cosine = |p: Vec3, q: Vec3, r: Vec3| (q - p).normalize_or_zero().dot((r - p).normalize_or_zero());
        // Not Delaunay: the opposite angles exceed 180° together, so their cosines sum to less than zero.
        if cosine(pc, pa, pb) + cosine(pd, pa, pb) > DELAUNAY_COSINES || c == d || !self.shared(c, d).is_empty() {
            return false;
        }
        let (one, two) = ([pa, pd, pc], [pd, pb, pc]);
        let before = normal([pa, pb, pc]) + normal([pb, pa, pd]);
        let flat = normal([pa, pb, pc]).normalize_or_zero().dot(normal([pb, pa, pd]).normalize_or_zero()) > FLAT_COSINE;
        if !flat || normal(one).dot(before) <= 0.0 || normal(two).dot(before) <= 0.0 {
            return false;
        }
        self.triangles[s as usize] = Some([a, d, c]);
        self.triangles[t as usize] = Some([d, b, c]);
        self.rings[b as usize].retain(|r| *r != s);
        self.rings[a as usize].retain(|r| *r != t);
        self.rings[d as usize].push(s);
        self.rings[c as usize].push(t);
        true
    }

    /// Tangential Laplacian smoothing: positions, `[vertex]`, after a `step` (0 … 1) towards the mean of the neighbours within
    /// the tangent plane. Vertices on borders and creases stay.
    pub fn relaxed(&self, step: f32) -> Vec<Vec3> {
        (0..self.positions.len() as u32)
            .into_par_iter()
            .map(|i| {
                let p = self.positions[i as usize];
                let ring = &self.rings[i as usize];
                if ring.is_empty() || self.on_border(i) {
                    return p;
                }
                let normals = ring.iter().filter_map(|&t| self.triangles[t as usize]);
                let normals: Vec<Vec3> = normals.map(|t| normal(t.map(|c| self.positions[c as usize]))).collect();
                let Some(mean) = normals.iter().sum::<Vec3>().try_normalize() else { return p };
                if normals.iter().any(|n| n.normalize_or_zero().dot(mean) < SMOOTH_COSINE) {
                    return p;
                }
                let neighbours = self.neighbours(i);
                let centre = neighbours.iter().map(|&k| self.positions[k as usize]).sum::<Vec3>();
                let shift = centre / neighbours.len() as f32 - p;
                p + step * (shift - mean * shift.dot(mean))
            })
            .collect()
    }

    /// Unit normal of every vertex, `[vertex]`; zero for unused vertices.
    pub fn normals(&self) -> Vec<Vec3> {
        let mut sums = vec![Vec3::ZERO; self.positions.len()];
        for t in self.triangles.iter().flatten() {
            let n = normal(t.map(|c| self.positions[c as usize]));
            t.iter().for_each(|&c| sums[c as usize] += n);
        }
        sums.into_iter().map(Vec3::normalize_or_zero).collect()
    }

    fn length(&self, a: u32, b: u32) -> f32 {
        self.positions[a as usize].distance(self.positions[b as usize])
    }

    /// Triangles on an edge.
    fn shared(&self, a: u32, b: u32) -> SmallVec<[u32; 4]> {
        let has = |t: &u32| self.triangles[*t as usize].is_some_and(|c| c.contains(&b));
        self.rings[a as usize].iter().copied().filter(has).collect()
    }

    /// The two triangles on an inner edge.
    fn both(&self, a: u32, b: u32) -> Option<[u32; 2]> {
        let has = |t: &u32| self.triangles[*t as usize].is_some_and(|c| c.contains(&b));
        let mut found = self.rings[a as usize].iter().copied().filter(has);
        let pair = [found.next()?, found.next()?];
        found.next().is_none().then_some(pair)
    }

    /// Far corners of a vertex's triangles, ascending.
    fn corners(&self, a: u32) -> Corners {
        let of_triangles = self.rings[a as usize].iter().filter_map(|&t| self.triangles[t as usize]).flatten();
        let mut corners: Corners = of_triangles.filter(|&c| c != a).collect();
        corners.sort_unstable();
        corners
    }

    /// Neighbours of a vertex, ascending.
    fn neighbours(&self, a: u32) -> Corners {
        let mut corners = self.corners(a);
        corners.dedup();
        corners
    }

    /// True if the vertex's triangles do not form a closed fan.
    fn on_border(&self, a: u32) -> bool {
        is_open(&self.corners(a))
    }

    /// True if removing `b` from the border that continues from `a` cuts off no significant corner.
    fn border_is_straight(&self, a: u32, b: u32, longest: f32) -> bool {
        let (pa, pb) = (self.positions[a as usize], self.positions[b as usize]);
        let next = self.neighbours(b).into_iter().find(|&n| n != a && self.shared(b, n).len() == 1);
        next.is_some_and(|n| {
            let pn = self.positions[n as usize];
            let across = (pb - pa).reject_from((pn - pa).try_normalize().unwrap_or(Vec3::X));
            across.length() < BORDER_DEVIATION * longest
                || (pb - pa).normalize_or_zero().dot((pn - pb).normalize_or_zero()) > BORDER_COSINE
        })
    }
}

/// True if not every one of a vertex's ascending far corners stands exactly twice.
fn is_open(corners: &[u32]) -> bool {
    corners.chunk_by(|a, b| a == b).any(|same| same.len() != 2)
}

/// Number of values in both ascending lists.
fn in_both(a: &[u32], b: &[u32]) -> usize {
    a.iter().filter(|n| b.contains(n)).count()
}

fn normal([a, b, c]: [Vec3; 3]) -> Vec3 {
    (b - a).cross(c - a)
}

fn runs_along(t: [u32; 3], a: u32, b: u32) -> bool {
    (t[0] == a && t[1] == b) || (t[1] == a && t[2] == b) || (t[2] == a && t[0] == b)
}

/// True if a moved triangle still faces the same way and is not much closer to a sliver.
fn keeps_side(old: [Vec3; 3], new: [Vec3; 3]) -> bool {
    let (before, after) = (normal(old), normal(new));
    let same_way = before.normalize_or_zero().dot(after.normalize_or_zero()) > KEPT_SIDE_COSINE;
    same_way && roundness(new) > ROUNDNESS_LOSS * roundness(old).min(ROUND_ENOUGH)
}

/// Twice the area over the longest edge squared: √3/2 for an equilateral triangle, 0 for a needle.
fn roundness(t: [Vec3; 3]) -> f32 {
    let longest = t[0].distance_squared(t[1]).max(t[1].distance_squared(t[2])).max(t[2].distance_squared(t[0]));
    normal(t).length() / longest.max(f32::MIN_POSITIVE)
}
