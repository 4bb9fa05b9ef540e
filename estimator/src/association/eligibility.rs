//! Which vertices a keyframe may observe (Eqs. 3–4).

use crate::association::context::AssociationContext;
use crate::mesh::raster::{MISS, Raster};
use crate::numerics::rotation::rotate;
use firmware_config::EstimatorConfig;
use glam::{Quat, Vec3};

/// A vertex counts as visible if the visible point is at most so far in front of it, in edges or pixel footprints.
pub const VISIBLE_EDGES: f32 = 0.5;

/// Thresholds of eligibility; relaxed from round to round.
#[derive(Debug, Clone, Copy)]
pub struct EligibilityRules {
    /// c2 of Eq. (3): smallest cosine between the normal and the direction to the camera.
    pub min_cosine: f32,
    /// c3 of Eq. (4), in edges or pixel footprints.
    edge_distance: f32,
    /// c4 of Eq. (4).
    edge_cosine: f32,
    /// Distance in pixels of the neighbours of a vertex's pixel that Eq. (4) tests.
    edge_pixels: i32,
}

impl EligibilityRules {
    /// `relaxed` runs from 0 (first round) to 1 (last).
    #[must_use]
    pub fn new(config: &EstimatorConfig, relaxed: f64) -> Self {
        let cosine = config.view_cosine_first + relaxed * (config.view_cosine_last - config.view_cosine_first);
        let angle = (config.edge_angle_deg * (1.0 + 0.5 * relaxed)).min(180.0).to_radians();
        Self {
            min_cosine: cosine as f32,
            edge_distance: (config.edge_distance * (1.0 + relaxed)) as f32,
            edge_cosine: libm::cos(angle) as f32,
            edge_pixels: if relaxed < 0.5 { 3 } else { 2 },
        }
    }

    /// Rules for vertices without other observations: visible, at any angle that is not grazing, near geometric edges too.
    #[must_use]
    pub fn last_resort(&self) -> Self {
        Self {
            min_cosine: 0.5 * self.min_cosine,
            edge_distance: 2.0 * self.edge_distance,
            edge_cosine: -1.0,
            edge_pixels: 1,
        }
    }
}

/// A vertex projected into a keyframe; vectors are in the camera's frame.
pub struct ProjectedVertex {
    /// Pixel column of its projection.
    pub u: f64,
    /// Pixel row of its projection.
    pub v: f64,
    /// Position.
    pub point: Vec3,
    /// Unit normal.
    pub normal: Vec3,
    /// Width of a pixel at the vertex in the mesh's units.
    pub footprint: f32,
    /// Cosine between the normal and the direction to the camera.
    pub cosine: f32,
    /// Mean edge length at the vertex.
    pub spacing: f32,
}

impl ProjectedVertex {
    /// True if the vertex is visible, not too oblique (Eq. 3), and without a geometric edge in the pixels around it (Eq. 4).
    pub fn is_eligible(
        &self,
        context: &AssociationContext,
        raster: &Raster,
        camera_from_world: &Quat,
        rules: &EligibilityRules,
    ) -> bool {
        if self.cosine.is_nan() || self.cosine <= rules.min_cosine {
            return false;
        }
        let (w, h) = (i64::from(raster.camera.width), i64::from(raster.camera.height));
        let (x, y) = ((self.u + 0.5).floor() as i64, (self.v + 0.5).floor() as i64);
        let reach = i64::from(rules.edge_pixels);
        // What is hidden mostly is so at its own pixel.
        for dy in [0, -reach, reach] {
            for dx in [0, -reach, reach] {
                let (px, py) = (x + dx, y + dy);
                if px < 0 || py < 0 || px >= w || py >= h {
                    return false;
                }
                let triangle = raster.triangle[(py * w + px) as usize];
                if triangle == MISS {
                    return false;
                }
                let Some(visible) = raster.point(px as usize, py as usize) else {
                    return false;
                };
                let offset = visible.as_vec3() - self.point;
                // Along the surface a pixel is longer by 1/cosine.
                let step = self.footprint * (dx.abs().max(dy.abs()) as f32 + 1.0) / self.cosine;
                let limit = rules.edge_distance * self.spacing.max(step * 0.5);
                let normal = rotate(*camera_from_world, context.triangle_normals[triangle as usize]);
                if offset.length() > limit.max(1.5 * step) || normal.dot(self.normal) < rules.edge_cosine {
                    return false;
                }
                // Occluded: the visible point at the vertex's own pixel is in front of it.
                if dx == 0 && dy == 0 && offset.dot(self.normal) > VISIBLE_EDGES * self.spacing.max(self.footprint) {
                    return false;
                }
            }
        }
        true
    }
}
