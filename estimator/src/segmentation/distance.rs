//! The distance between neighbouring vertices (Eqs. 6–7).

use crate::mesh::graph::Graph;
use crate::numerics::robust::{SIGMA_PER_MAD, median};
use firmware_config::EstimatorConfig;
use glam::Vec3;
use rayon::prelude::*;
use recordings::types::Mesh;

/// Distances along the mesh's edges, `[directed edge]` in the order of [`Graph::targets`].
pub struct EdgeDistances {
    /// Eq. (6); infinite where either end was not seen.
    pub distance: Vec<f32>,
    /// Eq. (7), made symmetric, in radians.
    pub concavity: Vec<f32>,
}

impl EdgeDistances {
    /// Weighted sum of the differences of `features`, concavity and shape `diameter`, each over its robust scale. An edge with
    /// an unknown diameter at either end drops that term.
    pub fn new(
        mesh: &Mesh,
        graph: &Graph,
        features: &[Vec3],
        diameter: &[Option<f32>],
        seen: &[bool],
        config: &EstimatorConfig,
    ) -> Self {
        let rows: Vec<Vec<[f32; 3]>> = (0..graph.vertices())
            .into_par_iter()
            .map(|i| {
                let term = |&j: &u32| {
                    let j = j as usize;
                    let thickness = match (diameter[i], diameter[j]) {
                        (Some(a), Some(b)) => (a - b).abs() / (0.5 * (a + b)).max(f32::MIN_POSITIVE),
                        _ => f32::NAN,
                    };
                    [features[i].distance(features[j]), concavity(mesh, i, j).max(concavity(mesh, j, i)), thickness]
                };
                graph.neighbours(i).iter().map(term).collect()
            })
            .collect();
        let terms: Vec<[f32; 3]> = rows.concat();
        let valid: Vec<bool> = (0..graph.vertices())
            .flat_map(|i| graph.neighbours(i).iter().map(move |&j| seen[i] && seen[j as usize]))
            .collect();
        let tuning = &config.tuning.segmentation;
        let weight = |term: usize, weight: f64, min_scale: f64| {
            let values = terms.iter().zip(&valid).filter(|(t, v)| **v && !t[term].is_nan()).map(|(t, _)| t[term]);
            let scale = median(values).map_or(0.0, |m| SIGMA_PER_MAD as f32 * m);
            weight as f32 / scale.max(min_scale as f32)
        };
        let weights = [
            weight(0, config.segment_color, tuning.min_color_scale),
            weight(1, config.segment_concavity, tuning.min_concavity_scale_rad),
            weight(2, config.segment_thickness, tuning.min_diameter_scale),
        ];
        let distance = terms
            .iter()
            .zip(&valid)
            .map(|(t, &valid)| {
                if !valid {
                    return f32::INFINITY;
                }
                // Eq. (6)
                let thickness = if t[2].is_nan() { 0.0 } else { weights[2] * t[2] };
                weights[0] * t[0] + weights[1] * t[1] + thickness
            })
            .collect();
        Self { distance, concavity: terms.iter().map(|t| t[1]).collect() }
    }
}

/// Eq. (7): elevation of b above a's tangent plane in radians; 0 if planar or convex.
///
/// The direction here is from a to b, so that a positive dot product means that b is above the plane:
/// max(0, π/2 − acos(…)) = asin(max(0, …)).
fn concavity(mesh: &Mesh, a: usize, b: usize) -> f32 {
    let d = (mesh.positions[b] - mesh.positions[a]).normalize_or_zero().dot(mesh.normals[a]);
    libm::asinf(d.clamp(0.0, 1.0))
}
