//! Colours without the blur of sampling windows and lens, by one step of Van Cittert's deconvolution.
//!
//! A blur of variance σ² along each axis takes 2 σ² / d² of its difference from the mean of its neighbours from a point of a regular mesh
//! of edge d, to first order: f + ½ σ² ∇²f, with ∇²f = 4 / d² (mean − f). As much is put back. Light is found from the colours as they
//! were seen: what is put back would take noise at outlines for shading.

use crate::mesh::graph::{Graph, mean};
use glam::Vec3;
use rayon::prelude::*;

/// What blur takes at the vertices, and is put back: windows have σ² = (0.75 d)² / 6, a lens about a third as much.
pub const BLURRED: f32 = 0.25;
/// A colour keeps this share of itself.
const LEAST_KEPT: f32 = 0.3;

/// Lit colours of weight above 0 without blur, in the units of `lit_color`; all arrays are `[vertex]`.
#[must_use]
pub fn sharp_colors(lit_color: &[Vec3], lit_weight: &[f32], graph: &Graph) -> Vec<Vec3> {
    let sharp = |i: usize| {
        let color = lit_color[i];
        let seen = graph.neighbours(i).iter().map(|k| *k as usize).filter(|k| lit_weight[*k] > 0.0);
        if lit_weight[i] > 0.0 { sharper(color, seen.map(|k| lit_color[k]), BLURRED) } else { color }
    };
    (0..lit_color.len()).into_par_iter().map(sharp).collect()
}

/// A colour that has lost this share of its difference from the mean of its neighbours.
#[must_use]
pub fn sharper(color: Vec3, neighbours: impl Iterator<Item = Vec3>, lost: f32) -> Vec3 {
    mean(neighbours).map_or(color, |mean| (color + lost * (color - mean)).max(LEAST_KEPT * color))
}

#[cfg(test)]
mod tests {
    use super::*;
    use recordings::types::Mesh;

    /// A plane of hexagons of edge 1, and a print on it: a wave of this length.
    fn print(length: f32) -> (Graph, Vec<f32>) {
        let (columns, rows) = (40u32, 40u32);
        let at = |x: u32, y: u32| Vec3::new(x as f32 + 0.5 * (y % 2) as f32, 0.75f32.sqrt() * y as f32, 0.0);
        let positions: Vec<Vec3> = (0..rows).flat_map(|y| (0..columns).map(move |x| at(x, y))).collect();
        let mut triangles = Vec::new();
        for y in 0..rows - 1 {
            for x in 0..columns - 1 {
                let [a, b, c, d] = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)].map(|(x, y)| y * columns + x);
                triangles.extend(if y % 2 == 0 { [[a, b, c], [b, d, c]] } else { [[a, b, d], [a, d, c]] });
            }
        }
        let wave = |p: &Vec3| 0.5 + 0.3 * libm::sinf(std::f32::consts::TAU * p.x / length);
        let colors = positions.iter().map(wave).collect();
        (Graph::of(&Mesh { positions, triangles, ..Mesh::default() }), colors)
    }

    #[test]
    fn a_blurred_print_gets_its_contrast_back() {
        let length = 8.0;
        let (graph, truth) = print(length);
        // σ² = d² / 8 takes a quarter of the difference from the neighbours' mean.
        let per = std::f32::consts::TAU / length;
        let kept = libm::expf(-0.5 * per * per / 8.0);
        let blurred: Vec<Vec3> = truth.iter().map(|t| Vec3::splat(0.5 + kept * (t - 0.5))).collect();
        let sharp = sharp_colors(&blurred, &vec![1.0; truth.len()], &graph);
        let inner = (0..truth.len()).filter(|i| graph.neighbours(*i).len() == 6);
        let off = |of: &[Vec3]| inner.clone().map(|i| (of[i].x - truth[i]).abs()).fold(0.0, f32::max);
        assert!(off(&sharp) < 0.2 * off(&blurred), "{} of {}", off(&sharp), off(&blurred));
    }

    #[test]
    fn what_was_not_seen_neither_changes_nor_counts() {
        let (graph, truth) = print(8.0);
        let mut colors: Vec<Vec3> = truth.iter().map(|_| Vec3::splat(0.5)).collect();
        let mut weight = vec![1.0; colors.len()];
        (colors[500], weight[500]) = (Vec3::ZERO, 0.0);
        assert_eq!(sharp_colors(&colors, &weight, &graph), colors);
    }
}
