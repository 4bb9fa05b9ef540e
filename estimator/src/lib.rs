//! Estimates light and materials from a scan (§3.1 second half – §3.4 of the paper).
//!
//! A mesh, keyframes with poses and a camera response go in; a regular mesh with segments, albedo per vertex, specular weights
//! per segment and distant light as spherical harmonics come out. [`estimate`] reads like the paper's section list.
//!
//! ```
//! use estimator::{Options, estimate};
//! use firmware_config::EstimatorConfig;
//! use recordings::scan::Scan;
//! use std::time::Duration;
//!
//! let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../recordings/data/tiny.lscan");
//! let scan = Scan::read(path.as_ref())?;
//! // A fixed number of ray rounds instead of the clock: the result is the same on every run.
//! let options = Options { budget: Duration::from_secs(120), rounds: Some(1), reference: None, memory_mb: None };
//! let result = estimate(&scan, &EstimatorConfig::default(), &options, &())?;
//! assert_eq!(result.albedo.len(), result.mesh.positions.len());
//! assert_eq!(result.light.coefficients.len() as u32, result.light.bands().pow(2));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod api;
pub mod association;
pub mod budget;
pub mod export;
pub mod factorisation;
pub mod light_model;
pub mod mesh;
pub mod model_selection;
pub mod numerics;
pub mod plots;
pub mod preview;
pub mod rays;
pub mod render;
pub mod segmentation;
pub mod specular;
pub mod stages;
pub mod sweep;
pub mod texture;
pub mod transfer;
pub mod validation;

use crate::budget::{Machine, WallClock};
use crate::stages::Run;
use firmware_config::EstimatorConfig;
use recordings::decision::Milestone;
use recordings::result::Estimate;
use recordings::scan::Scan;

pub use api::{EstimateError, Options, Progress, Reference};

/// Estimates light and materials on this machine.
///
/// # Errors
/// The scan is unusable: no triangle, or no keyframe that shows any of it.
pub fn estimate(
    scan: &Scan,
    config: &EstimatorConfig,
    options: &Options,
    progress: &dyn Progress,
) -> Result<Estimate, EstimateError> {
    estimate_on(&WallClock::start(), scan, config, options, progress)
}

/// Estimates light and materials with `machine` as the clock.
///
/// # Errors
/// The scan is unusable: no triangle, or no keyframe that shows any of it.
pub fn estimate_on(
    machine: &dyn Machine,
    scan: &Scan,
    config: &EstimatorConfig,
    options: &Options,
    progress: &dyn Progress,
) -> Result<Estimate, EstimateError> {
    let config = &budget::at_quality(config);
    let first = stages::First::new(machine, scan, config, options, progress);
    let mut run = Run::new(machine, scan, config, options, progress, first.done());

    // §3.1: regular mesh, lit colours, exposures, poses (Eqs. 2–5). §3.2: segments (Eqs. 6–7).
    let mut prepared = stages::prepare(scan, || first.made_late(), &mut run)?;

    // §3.3: transfer (Eq. 8), light and albedo (Eqs. 9–12).
    let mut solved = stages::light_and_albedo(&mut prepared, &mut run);
    let (early, near) = (&mut solved.answer, &solved.local_light);
    stages::hand_over(scan, &mut prepared, early, near, None, Milestone::Albedo, &mut run);

    // §3.2 again: materials. §3.4: specular weights (Eq. 13), and the factorisation without gloss.
    let (mut answer, local_light, mut lit_with_gloss) = stages::materials_and_gloss(&mut prepared, solved, &mut run);
    stages::name_materials(&mut prepared, &mut answer, config);
    let light = stages::light(&prepared, &mut answer, local_light.model, config);
    stages::sharpen(&mut prepared, &mut answer.found, &mut lit_with_gloss);
    stages::hand_over(scan, &mut prepared, &mut answer, &local_light, Some(&light), Milestone::Gloss, &mut run);
    let texture = stages::texture(&mut prepared, scan, &answer, &lit_with_gloss, &mut run);

    // Frames that no step used.
    let witnesses = stages::witnesses(&mut prepared, scan, &answer, &lit_with_gloss, texture.as_ref(), &mut run);
    run.plan.writing();
    progress.stage("done", 1.0);
    let (estimate, _) = stages::result(scan, &mut prepared, answer, local_light, light, &run);
    Ok(Estimate { witnesses, texture, ..estimate })
}
