//! Colour features of vertices: CIELAB, insensitive to shading, filtered over the mesh.

use crate::mesh::graph::Graph;
use crate::numerics::cielab::{lab, lightness, luminance};
use crate::numerics::robust::median;
use glam::Vec3;
use rayon::prelude::*;

/// Relative luminance at which chromaticity is measured.
const CHROMATICITY_LUMINANCE: f32 = 0.4;

/// Features of every vertex, `[vertex]`: CIELAB lightness times `lightness_share`, and a and b taken at one luminance, so
/// that shading moves only the first. Colours are relative to the median luminance of the `seen` vertices.
pub fn features(color: &[Vec3], seen: &[bool], lightness_share: f32) -> Vec<Vec3> {
    let luminances = color.iter().zip(seen).filter(|(_, s)| **s).map(|(c, _)| luminance(*c)).filter(|&y| y > 0.0);
    let Some(typical) = median(luminances) else { return vec![Vec3::ZERO; color.len()] };
    color
        .iter()
        .map(|&c| {
            let c = c.max(Vec3::ZERO) / typical;
            // The chromaticity of very dark colours is noise: they are moved towards grey.
            let y = luminance(c);
            let level = CHROMATICITY_LUMINANCE / (y + 0.02);
            let grey = Vec3::splat((CHROMATICITY_LUMINANCE - y * level).max(0.0));
            let lab = lab(c * level + grey);
            Vec3::new(lightness_share * lightness(0.2 * y), lab.y, lab.z)
        })
        .collect()
}

/// Median over each vertex and its neighbours, component by component: removes noise, keeps borders.
pub fn median_filtered(graph: &Graph, features: &[Vec3], seen: &[bool]) -> Vec<Vec3> {
    (0..graph.vertices())
        .into_par_iter()
        .map(|i| {
            if !seen[i] {
                return features[i];
            }
            let ring = graph.neighbours(i).iter().map(|&j| j as usize).filter(|&j| seen[j]);
            let row: Vec<Vec3> = std::iter::once(i).chain(ring).map(|j| features[j]).collect();
            let middle = |c: usize| median(row.iter().map(|f| f[c])).unwrap_or(features[i][c]);
            Vec3::new(middle(0), middle(1), middle(2))
        })
        .collect()
}

/// Kuwahara's filter: every vertex takes the mean of the most uniform one-ring that it belongs to. Removes noise and turns
/// blurred borders into steps.
pub fn sharpened(graph: &Graph, features: &[Vec3], seen: &[bool]) -> Vec<Vec3> {
    // Mean and variance of every one-ring.
    let rings: Vec<(Vec3, f32)> = (0..graph.vertices())
        .into_par_iter()
        .map(|i| {
            let (mut sum, mut squares, mut count) = (features[i], features[i].length_squared(), 1.0);
            for &j in graph.neighbours(i).iter().filter(|&&j| seen[j as usize]) {
                sum += features[j as usize];
                squares += features[j as usize].length_squared();
                count += 1.0;
            }
            let mean = sum / count;
            (mean, if count > 2.0 { squares / count - mean.length_squared() } else { f32::INFINITY })
        })
        .collect();
    (0..graph.vertices())
        .into_par_iter()
        .map(|i| {
            let own = if seen[i] { rings[i] } else { (features[i], f32::NEG_INFINITY) };
            let others = graph.neighbours(i).iter().filter(|&&j| seen[j as usize]).map(|&j| rings[j as usize]);
            others.fold(own, |best, ring| if ring.1 < best.1 { ring } else { best }).0
        })
        .collect()
}
