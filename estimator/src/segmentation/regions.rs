//! Regions after clustering: every seen vertex gets one, and regions without a border of colour between them are merged.

use crate::mesh::graph::Graph;
use crate::segmentation::labels::{UNLABELLED, label_count, sizes};
use firmware_config::tuning::SegmentationTuning;
use glam::{DVec2, Vec3};
use recordings::types::Mesh;
use std::cmp::{Ordering, Reverse};
use std::collections::{BTreeMap, BinaryHeap};

/// Factor on the strength of borders of regions that are too small, so that they merge first.
const SMALL_REGION_FACTOR: f32 = 1e-3;

/// A distance with a total order.
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

/// Gives every seen vertex the label that reaches it along the path with the smallest greatest `distance`,
/// `[directed edge]`. Seen vertices that no label reaches form regions of their own.
pub fn grow(graph: &Graph, distance: &[f32], seen: &[bool], labels: &mut [u32]) {
    let mut next = label_count(labels);
    let mut heap = BinaryHeap::new();
    let reach = |i: usize, worst: f32, labels: &[u32], heap: &mut BinaryHeap<_>| {
        for (e, j) in graph.edges(i) {
            if seen[j] && labels[j] == UNLABELLED {
                heap.push(Reverse((Cost(worst.max(distance[e])), j as u32, labels[i])));
            }
        }
    };
    for i in 0..labels.len() {
        if labels[i] != UNLABELLED {
            reach(i, 0.0, labels, &mut heap);
        }
    }
    let mut start = 0;
    loop {
        while let Some(Reverse((Cost(worst), i, label))) = heap.pop() {
            if labels[i as usize] == UNLABELLED {
                labels[i as usize] = label;
                reach(i as usize, worst, labels, &mut heap);
            }
        }
        let Some(orphan) = (start..labels.len()).find(|&i| seen[i] && labels[i] == UNLABELLED) else { return };
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
    /// `[flat, crease]`: difference of the features (lightness, a, b) near the border.
    near: [Vec3; 2],
    /// The same farther from the border.
    far: [Vec3; 2],
    creases: f32,
    concavity: f32,
}

impl Border {
    /// Difference across the border in CIELAB units, weighted by its shape.
    fn strength(&self, tuning: &SegmentationTuning) -> f32 {
        let flat = self.edges - self.creases;
        let chroma = step(self.near[0] + self.near[1], self.far[0] + self.far[1]) / self.edges;
        let smooth = if flat > 0.0 { (step(self.near[0], self.far[0]) / flat).x.abs() } else { 0.0 };
        let crease = if self.creases > 0.0 {
            (self.near[1] / self.creases).x.abs() - tuning.crease_lightness as f32
        } else {
            0.0
        };
        let lightness = (flat * smooth + self.creases * crease.max(0.0)) / self.edges;
        let concave = (self.concavity / self.edges / tuning.concave_border_rad as f32).min(1.0);
        // Rounded once: the same bits on every machine.
        let length = |a: f32, b: f32| DVec2::new(a.into(), b.into()).length() as f32;
        length(length(chroma.y, chroma.z), lightness)
            * (1.0 + tuning.concave_border_gain as f32 * concave)
            * (1.0 + (tuning.short_border_edges as f32 / self.edges).powi(2))
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

/// The part of a difference that remains when the gradients on both sides are extrapolated to the border.
fn step(near: Vec3, far: Vec3) -> Vec3 {
    let extrapolated = 2.0 * near - far;
    // A gradient may explain a step or part of it, but neither create nor reverse one.
    let bounded = |e: f32, n: f32| if n >= 0.0 { e.clamp(0.0, n) } else { e.clamp(n, 0.0) };
    Vec3::from_array(std::array::from_fn(|c| bounded(extrapolated[c], near[c])))
}

/// The surface on which regions are merged.
pub struct Surface<'a> {
    /// Positions and normals.
    pub mesh: &'a Mesh,
    /// Its adjacency.
    pub graph: &'a Graph,
    /// Colour features, `[vertex]`.
    pub features: &'a [Vec3],
    /// Eq. (7) in radians, `[directed edge]`.
    pub concavity: &'a [f32],
}

/// Merges neighbouring regions, weakest border first, until every border is stronger than `threshold` (CIELAB) and no
/// region with a neighbour has fewer than `min_size` vertices.
///
/// The threshold rises in steps, and borders are measured again at each: strips along a blurred border join one side before
/// the two sides are compared.
pub fn merge(surface: &Surface, threshold: f32, min_size: u32, tuning: &SegmentationTuning, labels: &mut [u32]) {
    for step in 1..=tuning.merge_steps {
        let share = step as f32 / tuning.merge_steps as f32;
        merge_below(surface, threshold * share, min_size, tuning, labels);
    }
}

/// The borders between labels `(a, b)` with a < b.
type Borders = BTreeMap<(u32, u32), Border>;

fn borders(surface: &Surface, tuning: &SegmentationTuning, labels: &[u32]) -> Borders {
    let Surface { mesh, graph, .. } = surface;
    let near = one_sided(graph, surface.features, labels, tuning.border_near_steps);
    let far = one_sided(graph, &near, labels, tuning.border_far_steps);
    let mut borders = Borders::new();
    for i in 0..graph.vertices() {
        for (e, j) in graph.edges(i) {
            let (a, b) = (labels[i], labels[j]);
            if a == UNLABELLED || b == UNLABELLED || a >= b {
                continue;
            }
            let crease = usize::from(mesh.normals[i].dot(mesh.normals[j]) <= tuning.crease_cosine as f32);
            let concavity = surface.concavity[e];
            let mut edge = Border { edges: 1.0, creases: crease as f32, concavity, ..Border::default() };
            edge.near[crease] = near[j] - near[i];
            edge.far[crease] = far[j] - far[i];
            borders.entry((a, b)).or_default().add(&edge, 1.0);
        }
    }
    borders
}

fn merge_below(surface: &Surface, threshold: f32, min_size: u32, tuning: &SegmentationTuning, labels: &mut [u32]) {
    let mut sizes = sizes(labels);
    let mut borders = borders(surface, tuning, labels);
    let mut parent: Vec<u32> = (0..sizes.len() as u32).collect();
    loop {
        let weakest = borders
            .iter()
            .map(|(&pair, border)| {
                let small = sizes[pair.0 as usize].min(sizes[pair.1 as usize]) < min_size;
                let strength = border.strength(tuning);
                (if small { strength * SMALL_REGION_FACTOR } else { strength }, pair)
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
            // Sums point from the lower to the higher label: their sign changes where the order does.
            let was = if pair.0 == b { 1.0 } else { -1.0 };
            borders.entry(key).or_default().add(&sums, sign * was);
        }
    }
    for l in labels.iter_mut().filter(|l| **l != UNLABELLED) {
        while parent[*l as usize] != *l {
            *l = parent[*l as usize];
        }
    }
}

/// Features after `steps` averages over neighbours of the same region.
fn one_sided(graph: &Graph, features: &[Vec3], labels: &[u32], steps: u32) -> Vec<Vec3> {
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
