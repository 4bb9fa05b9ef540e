//! DBSCAN (Ester et al. 1996) over the neighbourhoods of a mesh.

use crate::mesh::graph::Graph;
use crate::numerics::robust::median;
use crate::segmentation::labels::{UNLABELLED, drop_small_components};
use rayon::prelude::*;

/// Successive ε in median k-distances, in steps of about √2: a glossy apple is that much noisier than the table that sets
/// the median.
const EPSILONS: [f32; 9] = [2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0];

/// Cluster of every vertex, `[vertex]`, from the `distance` of every directed edge. ε rises from quiet to noisy surfaces; each
/// ε clusters the vertices that smaller ones left. [`UNLABELLED`] for noise and for clusters of fewer than `min_size`
/// vertices.
pub fn dbscan(graph: &Graph, distance: &[f32], seen: &[bool], min_points: usize, min_size: u32) -> Vec<u32> {
    let k_distance: Vec<f32> = (0..graph.vertices())
        .into_par_iter()
        .map(|i| {
            let mut d = distance[graph.offsets[i] as usize..graph.offsets[i + 1] as usize].to_vec();
            d.sort_unstable_by(f32::total_cmp);
            d.get(min_points.min(d.len()).saturating_sub(1)).copied().unwrap_or(f32::INFINITY)
        })
        .collect();
    let finite = k_distance.iter().copied().filter(|d| d.is_finite());
    let typical = median(finite).map_or(0.0, |m| m.max(f32::MIN_POSITIVE));
    let mut labels = vec![UNLABELLED; graph.vertices()];
    let mut next = 0;
    let mut stack = Vec::new();
    for factor in EPSILONS {
        let epsilon = factor * typical;
        let core = |i: usize| seen[i] && k_distance[i] <= epsilon;
        let first = next;
        for start in 0..graph.vertices() {
            if labels[start] != UNLABELLED || !core(start) {
                continue;
            }
            labels[start] = next;
            stack.push(start);
            while let Some(i) = stack.pop() {
                for (e, j) in graph.edges(i) {
                    if distance[e] <= epsilon && labels[j] == UNLABELLED {
                        labels[j] = next;
                        if core(j) {
                            stack.push(j);
                        }
                    }
                }
            }
            next += 1;
        }
        drop_small_components(&mut labels, first, min_size);
    }
    labels
}
