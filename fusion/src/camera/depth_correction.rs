//! Correction of a sensor's systematic depth error.

use crate::camera::pinhole::Pinhole;
use firmware_config::FusionConfig;
use glam::Vec2;

/// Correction of depth, from the radial polynomial of the settings `fusion.depth_linear` … `depth_square_radial`.
#[derive(Debug, Clone)]
pub enum DepthCorrection {
    /// All coefficients are 0.
    None,
    /// `[pixel]` of the undistorted depth camera, (a, b): z ← a z + b z².
    Map(Vec<Vec2>),
}

impl DepthCorrection {
    /// The correction for the pixels of `camera`.
    pub fn new(camera: &Pinhole, config: &FusionConfig) -> Self {
        let (linear, square) = (
            [config.depth_linear as f32, config.depth_linear_radial as f32],
            [config.depth_square as f32, config.depth_square_radial as f32],
        );
        if [linear, square] == [[0.0; 2]; 2] {
            return Self::None;
        }
        let pixel = |i: usize| {
            let ray = camera.ray((i % camera.width) as f32, (i / camera.width) as f32);
            let r2 = ray.x * ray.x + ray.y * ray.y;
            Vec2::new(1.0 + linear[0] + linear[1] * r2, square[0] + square[1] * r2)
        };
        Self::Map((0..camera.width * camera.height).map(pixel).collect())
    }
}
