//! Thresholds of the visibility of the fused surface.

use crate::settings::section;

section! {
    /// Which vertices of the fused surface a keyframe candidate sees.
    SurfaceCoverageTuning = "surface_coverage" {
        /// Smallest cosine between a vertex normal and the direction to the camera; slightly below what `fusion.max_slope` accepts. Source: c2 of Eq. (3), relaxed.
        min_cos: f64 = 0.17, [0.0..=1.0], "", "";
        /// A vertex may lie behind the nearest surface by this share of its depth. Source: tuned by hand on rendered scenes.
        depth_slack_share: f64 = 0.005, [0.0..=1.0], "", "";
        /// Connected triangles that no candidate sees are removed from this number on; fewer are noise in the normals. Source: tuned by hand on rendered scenes.
        min_unseen_triangles: u32 = 64, [1..=1000000], "triangles", "";
    }
}
