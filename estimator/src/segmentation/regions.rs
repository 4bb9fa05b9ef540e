//! What comes after clustering: every seen vertex gets a region, and regions without a border of colour are joined.

use crate::mesh::graph::Graph;
use crate::segmentation::NONE;
use glam::Vec3;
use recordings::types::Mesh;
use std::cmp::{Ordering, Reverse};
use std::collections::{BTreeMap, BinaryHeap, VecDeque};

/// Steps of one-sided smoothing of the features before borders are measured: pictures blur a border over a few
/// vertices, so both sides are read off at some distance, at two distances so that gradients can be told from steps.
const NEAR_STEPS: usize = 3;
const FAR_STEPS: usize = 9;
/// Steps in which the merging threshold rises.
const MERGE_STEPS: usize = 5;
/// Lightness (weighed as in the features) that shading alone may change across a crease.
const CREASE_LIGHTNESS: f32 = 4.0;
/// Cosine between normals below which a border stands on a crease, where shading may jump.
const CREASE: f32 = 0.9;
/// A fully concave border counts as this much more of a border.
const CONCAVE_GAIN: f32 = 0.6;
/// Concavity (radians) of a border that counts as fully concave.
const CONCAVE: f32 = 0.3;

/// Takes the label from clusters of fewer than `least` vertices among those numbered from `first` on.
pub fn drop_crumbs(labels: &mut [u32], first: u32, least: u32) {
    let mut sizes = vec![0_u32; labels.iter().filter(|&&l| l != NONE).max().map_or(0, |&l| l as usize + 1)];
    labels.iter().filter(|&&l| l != NONE).for_each(|&l| sizes[l as usize] += 1);
    for l in labels.iter_mut().filter(|l| **l != NONE && **l >= first) {
        if sizes[*l as usize] < least {
            *l = NONE;
        }
    }
}

/// Borders of fewer edges do not join regions easily: where two all but touch in a point, pictures mix their colours.
const SHORT: f32 = 6.0;

/// A distance that orders.
#[derive(PartialEq)]
struct Cost(f32);
impl Eq for Cost {}
impl PartialOrd for Cost {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Cost {
    fn cmp(&self, other: &Self) -> Ordering {
        self.0.total_cmp(&other.0)
    }
}

/// Gives every seen vertex the label that reaches it over the smallest steps; seen vertices that no label reaches make
/// regions of their own.
pub fn grow(graph: &Graph, distance: &[f32], seen: &[bool], labels: &mut [u32]) {
    let mut next = labels.iter().filter(|&&l| l != NONE).max().map_or(0, |&l| l + 1);
    let mut heap = BinaryHeap::new();
    let reach = |i: usize, worst: f32, labels: &[u32], heap: &mut BinaryHeap<_>| {
        for (e, j) in graph.edges(i) {
            if seen[j] && labels[j] == NONE {
                heap.push(Reverse((Cost(worst.max(distance[e])), j as u32, labels[i])));
            }
        }
    };
    for i in 0..labels.len() {
        if labels[i] != NONE {
            reach(i, 0.0, labels, &mut heap);
        }
    }
    let mut start = 0;
    loop {
        while let Some(Reverse((Cost(worst), i, label))) = heap.pop() {
            if labels[i as usize] == NONE {
                labels[i as usize] = label;
                reach(i as usize, worst, labels, &mut heap);
            }
        }
        let Some(orphan) = (start..labels.len()).find(|&i| seen[i] && labels[i] == NONE) else { return };
        labels[orphan] = next;
        next += 1;
        reach(orphan, 0.0, labels, &mut heap);
        start = orphan + 1;
    }
}

/// Sums over the edges between two regions; differences point from the lower to the higher label.
#[derive(Clone, Copy, Default)]
struct Border {
    edges: f32,
    /// Difference of the features (lightness, a, b) near the border, over flat edges and over creases.
    near: [Vec3; 2],
    /// The same farther away.
    far: [Vec3; 2],
    creases: f32,
    concavity: f32,
}

impl Border {
    /// Difference across the border in CIELAB units, weighed by its shape.
    fn strength(&self) -> f32 {
        let flat = self.edges - self.creases;
        let chroma = step(self.near[0] + self.near[1], self.far[0] + self.far[1]) / self.edges;
        let smooth = if flat > 0.0 { (step(self.near[0], self.far[0]) / flat).x.abs() } else { 0.0 };
        let crease = if self.creases > 0.0 { (self.near[1] / self.creases).x.abs() - CREASE_LIGHTNESS } else { 0.0 };
        let lightness = (flat * smooth + self.creases * crease.max(0.0)) / self.edges;
        let concave = (self.concavity / self.edges / CONCAVE).min(1.0);
        chroma.y.hypot(chroma.z).hypot(lightness)
            * (1.0 + CONCAVE_GAIN * concave)
            * (1.0 + (SHORT / self.edges).powi(2))
    }
    fn add(&mut self, other: &Self, sign: f32) {
        self.edges += other.edges;
        for k in 0..2 {
            self.near[k] += sign * other.near[k];
            self.far[k] += sign * other.far[k];
        }
        self.creases += other.creases;
        self.concavity += other.concavity;
    }
}

/// What is left of a difference when the gradients on both sides are continued up to the border.
fn step(near: Vec3, far: Vec3) -> Vec3 {
    let extrapolated = 2.0 * near - far;
    // A gradient explains a step or part of it, it does not make or turn one.
    let bounded = |e: f32, n: f32| if n >= 0.0 { e.clamp(0.0, n) } else { e.clamp(n, 0.0) };
    Vec3::from_array(std::array::from_fn(|c| bounded(extrapolated[c], near[c])))
}

/// Joins neighbouring regions, weakest border first, until every border is stronger than `threshold` (CIELAB) and no
/// region with a neighbour has fewer than `least` vertices. The threshold rises in steps between which borders are
/// measured anew: strips along a blurred border join one side before the two sides are compared.
pub fn merge(
    mesh: &Mesh,
    graph: &Graph,
    features: &[Vec3],
    concavity: &[f32],
    threshold: f32,
    least: u32,
    labels: &mut [u32],
) {
    for step in 1..=MERGE_STEPS {
        let share = step as f32 / MERGE_STEPS as f32;
        merge_below(mesh, graph, features, concavity, threshold * share, least, labels);
    }
}

fn merge_below(
    mesh: &Mesh,
    graph: &Graph,
    features: &[Vec3],
    concavity: &[f32],
    threshold: f32,
    least: u32,
    labels: &mut [u32],
) {
    let count = labels.iter().filter(|&&l| l != NONE).max().map_or(0, |&l| l as usize + 1);
    let near = one_sided(graph, features, labels, NEAR_STEPS);
    let far = one_sided(graph, &near, labels, FAR_STEPS);
    let mut sizes = vec![0_u32; count];
    labels.iter().filter(|&&l| l != NONE).for_each(|&l| sizes[l as usize] += 1);
    // borders[a][b], a < b: signed sums of b − a.
    let mut borders: BTreeMap<(u32, u32), Border> = BTreeMap::new();
    for i in 0..graph.vertices() {
        for (e, j) in graph.edges(i) {
            let (a, b) = (labels[i], labels[j]);
            if a == NONE || b == NONE || a >= b {
                continue;
            }
            let crease = usize::from(mesh.normals[i].dot(mesh.normals[j]) <= CREASE);
            let mut edge = Border { edges: 1.0, creases: crease as f32, concavity: concavity[e], ..Border::default() };
            edge.near[crease] = near[j] - near[i];
            edge.far[crease] = far[j] - far[i];
            borders.entry((a, b)).or_default().add(&edge, 1.0);
        }
    }
    let mut parent: Vec<u32> = (0..count as u32).collect();
    loop {
        let weakest = borders
            .iter()
            .map(|(&pair, border)| {
                let small = sizes[pair.0 as usize].min(sizes[pair.1 as usize]) < least;
                (if small { border.strength() * 1e-3 } else { border.strength() }, pair)
            })
            .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let Some((strength, (a, b))) = weakest else { break };
        if strength >= threshold {
            break;
        }
        parent[b as usize] = a;
        sizes[a as usize] += sizes[b as usize];
        borders.remove(&(a, b));
        let moved: Vec<((u32, u32), Border)> =
            borders.iter().filter(|(p, _)| p.0 == b || p.1 == b).map(|(p, s)| (*p, *s)).collect();
        for (pair, sums) in moved {
            borders.remove(&pair);
            let other = if pair.0 == b { pair.1 } else { pair.0 };
            let (key, sign) = if a < other { ((a, other), 1.0) } else { ((other, a), -1.0) };
            // Sums point from the lower to the higher index; turned where the order changes.
            let was = if pair.0 == b { 1.0 } else { -1.0 };
            borders.entry(key).or_default().add(&sums, sign * was);
        }
    }
    for l in labels.iter_mut().filter(|l| **l != NONE) {
        while parent[*l as usize] != *l {
            *l = parent[*l as usize];
        }
    }
}

/// Features averaged over neighbours of the same region.
fn one_sided(graph: &Graph, features: &[Vec3], labels: &[u32], steps: usize) -> Vec<Vec3> {
    let mut smooth = features.to_vec();
    for _ in 0..steps {
        smooth = (0..graph.vertices())
            .map(|i| {
                let (mut sum, mut count) = (smooth[i], 1.0);
                for &j in graph.neighbours(i) {
                    if labels[j as usize] == labels[i] {
                        sum += smooth[j as usize];
                        count += 1.0;
                    }
                }
                sum / count
            })
            .collect();
    }
    smooth
}

/// Spreads labels over the mesh to vertices that have none; what no label reaches makes one region.
pub fn spread(graph: &Graph, labels: &mut [u32]) {
    let rest = labels.iter().filter(|&&l| l != NONE).max().map_or(0, |&l| l + 1);
    let mut queue: VecDeque<u32> = (0..labels.len() as u32).filter(|&i| labels[i as usize] != NONE).collect();
    while let Some(i) = queue.pop_front() {
        for &j in graph.neighbours(i as usize) {
            if labels[j as usize] == NONE {
                labels[j as usize] = labels[i as usize];
                queue.push_back(j);
            }
        }
    }
    labels.iter_mut().filter(|l| **l == NONE).for_each(|l| *l = rest);
}

/// Numbers labels from 0 in order of their first vertex.
pub fn renumber(labels: &mut [u32]) {
    let mut names = BTreeMap::new();
    for l in labels {
        let next = names.len() as u32;
        *l = *names.entry(*l).or_insert(next);
    }
}
