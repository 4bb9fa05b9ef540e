//! Operations on segment labels, `[vertex]`.

use crate::mesh::graph::Graph;
use std::collections::{BTreeMap, VecDeque};

/// Label of a vertex without a segment.
pub const UNLABELLED: u32 = u32::MAX;

/// One more than the highest label.
pub fn label_count(labels: &[u32]) -> u32 {
    labels.iter().filter(|&&l| l != UNLABELLED).max().map_or(0, |&l| l + 1)
}

/// Vertices of every label: `[label]`.
pub fn sizes(labels: &[u32]) -> Vec<u32> {
    let mut sizes = vec![0_u32; label_count(labels) as usize];
    labels.iter().filter(|&&l| l != UNLABELLED).for_each(|&l| sizes[l as usize] += 1);
    sizes
}

/// Clears labels from `first` on that have fewer than `min_size` vertices.
pub fn drop_small_components(labels: &mut [u32], first: u32, min_size: u32) {
    let sizes = sizes(labels);
    for l in labels.iter_mut().filter(|l| **l != UNLABELLED && **l >= first) {
        if sizes[*l as usize] < min_size {
            *l = UNLABELLED;
        }
    }
}

/// Spreads labels to vertices without one; vertices that no label reaches share one new label.
pub fn spread(graph: &Graph, labels: &mut [u32]) {
    let rest = label_count(labels);
    flood(graph, labels);
    labels.iter_mut().filter(|l| **l == UNLABELLED).for_each(|l| *l = rest);
}

/// Spreads labels breadth first to vertices without one, as far as edges lead.
pub fn flood(graph: &Graph, labels: &mut [u32]) {
    let mut queue: VecDeque<u32> = (0..labels.len() as u32).filter(|&i| labels[i as usize] != UNLABELLED).collect();
    while let Some(i) = queue.pop_front() {
        for &j in graph.neighbours(i as usize) {
            if labels[j as usize] == UNLABELLED {
                labels[j as usize] = labels[i as usize];
                queue.push_back(j);
            }
        }
    }
}

/// Numbers labels from 0 in order of their first vertex.
pub fn renumber(labels: &mut [u32]) {
    let mut names = BTreeMap::new();
    for l in labels {
        let next = names.len() as u32;
        *l = *names.entry(*l).or_insert(next);
    }
}
