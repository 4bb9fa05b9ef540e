//! What all stages of one run share.

use crate::api::{Options, Progress};
use crate::budget::cost_model::Size;
use crate::budget::{Done, Machine, Plan};
use firmware_config::EstimatorConfig;
use recordings::scan::{Scan, ScanSource};
use recordings::types::Keyframe;

/// Settings, options and plan of one run.
pub struct Run<'a> {
    /// Settings.
    pub config: &'a EstimatorConfig,
    /// Budget or rounds.
    pub options: &'a Options,
    /// Gets every stage.
    pub progress: &'a dyn Progress,
    /// Clock and budget.
    pub plan: Plan<'a>,
}

impl<'a> Run<'a> {
    /// Plans the run for a scan, with what was done `before`.
    #[must_use]
    pub fn new(
        machine: &'a dyn Machine,
        scan: &Scan,
        config: &'a EstimatorConfig,
        options: &'a Options,
        progress: &'a dyn Progress,
        before: Done,
    ) -> Self {
        Self { config, options, progress, plan: Plan::new(machine, options, config, Self::size(scan, config), before) }
    }

    /// Size of a scan under these settings.
    #[must_use]
    pub fn size(scan: &Scan, config: &EstimatorConfig) -> Size {
        let pixels = |k: &Keyframe| f64::from(k.camera.intrinsics.width) * f64::from(k.camera.intrinsics.height);
        let scanned = scan.mesh.positions.len() as f64;
        let remeshed = scan.source == ScanSource::Fusion && config.regularise > 0.0;
        Size {
            scanned,
            remeshed,
            vertices: if remeshed { scanned.min(f64::from(config.max_vertices)) } else { scanned },
            keyframes: scan.keyframes.len() as f64,
            pixels: scan.keyframes.first().map_or(0.0, pixels),
            witnesses: scan.witnesses.len() as f64,
        }
    }

    /// True if the number of rays is set by the user, not by evidence.
    pub(super) fn rays_are_set(&self) -> bool {
        self.config.rays > 0 || self.options.rounds.is_some()
    }
}
