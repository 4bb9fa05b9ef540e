//! The segmentation pipeline.

use crate::mesh::graph::Graph;
use crate::rays::RayScene;
use crate::segmentation::dbscan::dbscan;
use crate::segmentation::distance::EdgeDistances;
use crate::segmentation::features::{features, median_filtered, sharpened};
use crate::segmentation::labels::{renumber, spread};
use crate::segmentation::regions;
use crate::segmentation::shape_diameter::shape_diameter;
use firmware_config::EstimatorConfig;
use glam::Vec3;
use recordings::types::Mesh;

/// Segment of every vertex, `[vertex]`, numbered from 0 in order of their first vertex.
///
/// `lit_color` is a linear RGB colour per vertex. A vertex of weight 0 takes the segment of the nearest vertex of its
/// connected component that has one.
#[must_use]
pub fn segment(
    mesh: &Mesh,
    graph: &Graph,
    scene: &RayScene,
    lit_color: &[Vec3],
    lit_weight: &[f32],
    config: &EstimatorConfig,
) -> Vec<u32> {
    let tuning = &config.tuning.segmentation;
    let seen: Vec<bool> = lit_weight.iter().zip(lit_color).map(|(&w, c)| w > 0.0 && c.is_finite()).collect();
    let features = features(lit_color, &seen, tuning.lightness_share as f32);
    let features = median_filtered(graph, &features, &seen);
    let mut sharp = features.clone();
    for _ in 0..tuning.sharpening_passes {
        sharp = sharpened(graph, &sharp, &seen);
    }
    let diameter = if config.segment_thickness > 0.0 {
        shape_diameter(mesh, graph, scene, tuning.shape_diameter_rays as usize, config.seed)
    } else {
        vec![None; mesh.positions.len()]
    };
    let edges = EdgeDistances::new(mesh, graph, &sharp, &diameter, &seen, config);
    let min_size = least_size(mesh.positions.len(), config);
    let mut labels = dbscan(graph, &edges.distance, &seen, config.segment_min_points as usize, min_size);
    regions::grow(graph, &edges.distance, &seen, &mut labels);
    let surface = regions::Surface { mesh, graph, features: &features, concavity: &edges.concavity };
    regions::merge(&surface, config.segment_merge as f32, min_size, tuning, &mut labels);
    spread(graph, &mut labels);
    renumber(&mut labels);
    labels
}

/// Vertices that a segment must have where it has neighbours, on a mesh of so many.
#[must_use]
pub fn least_size(vertices: usize, config: &EstimatorConfig) -> u32 {
    (config.segment_min_share * vertices as f64).ceil().max(8.0) as u32
}
