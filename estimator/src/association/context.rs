//! The inputs of association that are constant over its rounds.

use crate::mesh::graph::{Graph, vertex_spacing};
use crate::mesh::raster::triangle_normals;
use crate::rays::RayScene;
use firmware_config::EstimatorConfig;
use glam::Vec3;
use recordings::types::{Mesh, Response};

/// Near plane of the cameras in median edges.
const NEAR_EDGES: f64 = 0.1;

/// Mesh, camera response and settings.
pub struct AssociationContext<'a> {
    /// The mesh.
    pub mesh: &'a Mesh,
    /// The same for rays.
    pub scene: &'a RayScene,
    /// Its adjacency.
    pub graph: Graph,
    /// Median edge length in the mesh's units.
    pub median_edge: f32,
    /// Mean edge length at every vertex, `[vertex]`.
    pub spacing: Vec<f32>,
    /// Smooth unit normal, `[triangle]`.
    pub triangle_normals: Vec<Vec3>,
    /// Near plane of the cameras in the mesh's units.
    pub near: f64,
    /// How the camera turns light into its 8-bit values.
    pub response: Response,
    /// Linear light of 8-bit values.
    pub table: [f32; 256],
    /// 8-bit values from here on are clipped.
    pub clipped: u8,
    /// The given poses are those of the tracking that the mesh was fused with; false until set.
    pub poses_are_tracked: bool,
    /// Settings.
    pub config: &'a EstimatorConfig,
}

impl<'a> AssociationContext<'a> {
    /// Precomputes the derived values.
    #[must_use]
    pub fn new(mesh: &'a Mesh, scene: &'a RayScene, response: &Response, config: &'a EstimatorConfig) -> Self {
        let median_edge = scene.median_edge();
        let graph = Graph::of(mesh);
        Self {
            mesh,
            scene,
            median_edge,
            spacing: vertex_spacing(mesh, &graph, median_edge),
            graph,
            triangle_normals: triangle_normals(mesh),
            near: f64::from(median_edge) * NEAR_EDGES,
            response: *response,
            table: response.linear_table(),
            clipped: config.clipped_from.min(255) as u8,
            poses_are_tracked: false,
            config,
        }
    }

    /// Decodes pictures by another response from now on.
    pub(super) fn decode_by(&mut self, response: Response) {
        (self.response, self.table) = (response, response.linear_table());
    }
}
