//! Continues values per vertex into a hole as a membrane (Laplace's equation on the mesh).

use crate::mesh::graph::Graph;
use glam::Vec3;

/// Gauss–Seidel sweeps over the unknown vertices.
pub const SWEEPS: usize = 400;

/// Fills `values` `[vertex]` where they are not `known`: first from the nearest known vertices, then relaxed until each is
/// the mean of its neighbours.
pub fn inpaint(values: &mut [Vec3], known: &[bool], graph: &Graph) {
    let mut have = known.to_vec();
    let mut order = Vec::new();
    let mut front: Vec<usize> = (0..have.len()).filter(|&v| have[v]).collect();
    while !front.is_empty() {
        let mut next: Vec<usize> =
            front.iter().flat_map(|&v| graph.neighbours(v)).map(|&v| v as usize).filter(|&v| !have[v]).collect();
        next.sort_unstable();
        next.dedup();
        for &v in &next {
            let around: Vec<Vec3> =
                graph.neighbours(v).iter().filter(|&&n| have[n as usize]).map(|&n| values[n as usize]).collect();
            values[v] = around.iter().sum::<Vec3>() / around.len().max(1) as f32;
        }
        next.iter().for_each(|&v| have[v] = true);
        order.extend(&next);
        front = next;
    }
    let sweeps = if order.len() > 50_000 { SWEEPS / 8 } else { SWEEPS };
    for sweep in 0..sweeps {
        let mut relax = |v: usize| {
            let around = graph.neighbours(v);
            values[v] = around.iter().map(|&n| values[n as usize]).sum::<Vec3>() / around.len().max(1) as f32;
        };
        if sweep & 1 == 0 { order.iter().for_each(|&v| relax(v)) } else { order.iter().rev().for_each(|&v| relax(v)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_membrane_continues_a_gradient() {
        let grid = |i: usize| Vec3::new((i % 17) as f32 / 16.0 - 0.5, (i / 17) as f32 / 16.0 - 0.5, 0.0);
        let positions: Vec<Vec3> = (0..17 * 17).map(grid).collect();
        let cell = |i: u32| [[i, i + 1, i + 18], [i, i + 18, i + 17]];
        let triangles: Vec<[u32; 3]> = (0..16 * 17).filter(|i| i % 17 < 16).flat_map(cell).collect();
        let graph = Graph::new(positions.len(), &triangles);
        let truth: Vec<Vec3> = positions.iter().map(|p| Vec3::splat(1.0 + p.x)).collect();
        let known: Vec<bool> = positions.iter().map(|p| p.x.abs().max(p.y.abs()) > 0.3).collect();
        let mut values: Vec<Vec3> = truth.iter().zip(&known).map(|(t, k)| if *k { *t } else { Vec3::ZERO }).collect();
        inpaint(&mut values, &known, &graph);
        for (v, t) in values.iter().zip(&truth) {
            assert!((*v - *t).abs().max_element() < 0.02, "{v} {t}");
        }
    }
}
