//! Thresholds of single stages: one section a stage, one file a section.
//!
//! A scan stores only those that differ from their default, so that it is estimated again with the defaults of the program
//! that does it.

mod association;
mod budget;
mod compositing;
mod depth_noise;
mod distance_check;
mod exposure;
mod factorisation;
mod gravity;
mod inpainting;
mod keyframes;
mod mesh;
mod model_selection;
mod pose;
mod preprocessing;
mod registration;
mod relocalisation;
mod removal;
mod response;
mod rotation_search;
mod segmentation;
mod session;
mod specular;
mod supervision;
mod surface_coverage;
mod surroundings;
mod texture;
mod timing;
mod tracking;
mod tracking_effort;
mod validation;
mod volume;

use crate::settings::tuning;

pub use association::AssociationTuning;
pub use budget::BudgetTuning;
pub use compositing::CompositingTuning;
pub use depth_noise::{DepthNoise, DepthNoiseTuning};
pub use distance_check::DistanceCheckTuning;
pub use exposure::ExposureTuning;
pub use factorisation::FactorisationTuning;
pub use gravity::GravityTuning;
pub use inpainting::InpaintingTuning;
pub use keyframes::KeyframesTuning;
pub use mesh::MeshTuning;
pub use model_selection::ModelSelectionTuning;
pub use pose::PoseTuning;
pub use preprocessing::PreprocessingTuning;
pub use registration::RegistrationTuning;
pub use relocalisation::RelocalisationTuning;
pub use removal::RemovalTuning;
pub use response::ResponseTuning;
pub use rotation_search::RotationSearchTuning;
pub use segmentation::SegmentationTuning;
pub use session::SessionTuning;
pub use specular::SpecularTuning;
pub use supervision::SupervisionTuning;
pub use surface_coverage::SurfaceCoverageTuning;
pub use surroundings::SurroundingsTuning;
pub use texture::TextureTuning;
pub use timing::TimingTuning;
pub use tracking::TrackingTuning;
pub use tracking_effort::TrackingEffortTuning;
pub use validation::ValidationTuning;
pub use volume::VolumeTuning;

tuning! {
    /// Thresholds of the estimator's stages.
    EstimatorTuning {
        /// Planner of the time budget.
        budget: BudgetTuning;
        /// Selection of transfer, bands and rays.
        model_selection: ModelSelectionTuning;
        /// Factorisation into light and albedo.
        factorisation: FactorisationTuning;
        /// Specular weights.
        specular: SpecularTuning;
        /// Prediction of validation frames.
        validation: ValidationTuning;
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
        /// Texture.
        texture: TextureTuning;
        /// Registration of the pictures to the texture.
        registration: RegistrationTuning;
    }
}

tuning! {
    /// Thresholds of fusion's stages.
    FusionTuning {
        /// Frame-to-model tracking.
        tracking: TrackingTuning;
        /// Relocalisation against stored anchor frames.
        relocalisation: RelocalisationTuning;
        /// Rotation from image to image, for fast turns.
        rotation_search: RotationSearchTuning;
        /// Delay of depth and rolling shutter.
        timing: TimingTuning;
        /// Cost model of the CPU budget.
        tracking_effort: TrackingEffortTuning;
        /// Depth preprocessing.
        preprocessing: PreprocessingTuning;
        /// Noise model of the depth sensor.
        depth_noise: DepthNoiseTuning;
        /// TSDF volume.
        volume: VolumeTuning;
        /// Visibility of the fused surface.
        surface_coverage: SurfaceCoverageTuning;
        /// Greedy choice of keyframes, Eq. (1).
        keyframes: KeyframesTuning;
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

tuning! {
    /// Thresholds of mixed-reality rendering.
    RealityTuning {
        /// Which vertices go with a removed object.
        removal: RemovalTuning;
        /// Holes and their texture.
        inpainting: InpaintingTuning;
        /// Light beyond the scan.
        surroundings: SurroundingsTuning;
        /// Light on the changed scene and its picture.
        compositing: CompositingTuning;
    }
}
