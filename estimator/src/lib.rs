//! From a scan to light and materials (§3.1 second half – §3.4).

pub mod albedo;
pub mod association;
pub mod export;
pub mod exposure;
mod graph;
pub mod inverse;
mod picture;
pub mod plan;
pub mod pose;
pub mod preview;
mod raster;
mod regions;
pub mod remesh;
mod robust;
pub mod scene;
pub mod segmentation;
pub mod sh;
pub mod specular;
mod surface;
mod template;
pub mod thickness;
pub mod transfer;
pub mod witness;

use firmware_config::EstimatorConfig;
use recordings::result::Estimate;
use recordings::scan::Scan;
use std::time::Duration;

/// Why there is no result.
#[derive(Debug, thiserror::Error)]
pub enum EstimateError {
    /// The scan holds nothing that could be estimated from.
    #[error("{0}")]
    Unusable(String),
}

/// What a run may spend.
#[derive(Debug, Clone)]
pub struct Options {
    /// Wall time from start to result.
    pub budget: Duration,
    /// Fixed number of ray rounds: replaces the clock, and the result is byte-identical.
    pub rounds: Option<u32>,
}

/// Told about every stage as it goes.
pub trait Progress: Sync {
    /// `fraction` of stage `name` is done (0 at its start, 1 at its end).
    fn stage(&self, name: &'static str, fraction: f64);
}

/// Estimates light and materials.
///
/// # Errors
/// The scan is unusable: no vertices, or no usable keyframe.
pub fn estimate(
    _scan: &Scan,
    _config: &EstimatorConfig,
    _options: &Options,
    _progress: &dyn Progress,
) -> Result<Estimate, EstimateError> {
    unimplemented!()
}
