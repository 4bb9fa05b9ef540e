//! Thresholds of single stages: one section a stage, one file a section.
//!
//! A scan stores only those that differ from their default, so that it is estimated again with the defaults of the program
//! that does it.

mod distance_check;
mod mesh;
mod segmentation;
mod tracking;

use crate::settings::tuning;

pub use distance_check::DistanceCheckTuning;
pub use mesh::MeshTuning;
pub use segmentation::SegmentationTuning;
pub use tracking::TrackingTuning;

tuning! {
    /// Thresholds of the estimator's stages.
    EstimatorTuning {
        /// Check of the distant-light assumption.
        distance_check: DistanceCheckTuning;
        /// Mesh regularisation.
        mesh: MeshTuning;
        /// Segmentation into materials.
        segmentation: SegmentationTuning;
    }
}

tuning! {
    /// Thresholds of fusion's stages.
    FusionTuning {
        /// Frame-to-model tracking and relocalisation.
        tracking: TrackingTuning;
    }
}
