//! Thresholds of single stages: one section a stage, one file a section.
//!
//! A scan stores only those that differ from their default, so that it is estimated again with the defaults of the program
//! that does it.

mod association;
mod distance_check;
mod exposure;
mod gravity;
mod mesh;
mod pose;
mod response;
mod segmentation;
mod session;
mod supervision;
mod tracking;

use crate::settings::tuning;

pub use association::AssociationTuning;
pub use distance_check::DistanceCheckTuning;
pub use exposure::ExposureTuning;
pub use gravity::GravityTuning;
pub use mesh::MeshTuning;
pub use pose::PoseTuning;
pub use response::ResponseTuning;
pub use segmentation::SegmentationTuning;
pub use session::SessionTuning;
pub use supervision::SupervisionTuning;
pub use tracking::TrackingTuning;

tuning! {
    /// Thresholds of the estimator's stages.
    EstimatorTuning {
        /// Check of the distant-light assumption.
        distance_check: DistanceCheckTuning;
        /// Mesh regularisation.
        mesh: MeshTuning;
        /// Data association.
        association: AssociationTuning;
        /// Exposures.
        exposure: ExposureTuning;
        /// Pose refinement.
        pose: PoseTuning;
        /// Test of the camera's response.
        response: ResponseTuning;
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

tuning! {
    /// Thresholds of sources and pairing.
    CaptureTuning {
        /// Accelerometer.
        gravity: GravityTuning;
    }
}

tuning! {
    /// Thresholds of the daemon.
    DaemonTuning {
        /// Reports.
        supervision: SupervisionTuning;
    }
}

tuning! {
    /// Thresholds of the Kinect driver.
    KinectTuning {
        /// Streaming.
        session: SessionTuning;
    }
}
