//! Estimates light and materials from a scan (§3.1 second half – §3.4).
//!
//! ```
//! use estimator::{Options, estimate};
//! use firmware_config::EstimatorConfig;
//! use recordings::scan::Scan;
//! use std::time::Duration;
//!
//! let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../recordings/data/samples/v1.lscan");
//! let scan = Scan::read(path.as_ref())?;
//! // A fixed number of ray rounds instead of the clock: the result is the same on every run.
//! let options = Options { budget: Duration::from_secs(120), rounds: Some(1) };
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
pub mod mesh;
pub mod model_selection;
pub mod numerics;
pub mod preview;
pub mod rays;
pub mod render;
pub mod segmentation;
pub mod specular;
pub mod stages;
pub mod sweep;
pub mod transfer;
pub mod validation;

use crate::budget::{Machine, Plan, WallClock};
use crate::factorisation::factorise;
use crate::specular::Gloss;
use firmware_config::{EstimatorConfig, Switch};
use recordings::decision::Warning;
use recordings::result::Estimate;
use recordings::scan::Scan;
use std::sync::Arc;

pub use api::{EstimateError, Options, Progress};

/// Estimates light and materials on this machine.
///
/// # Errors
/// The scan is unusable: no vertices, or no keyframe that can be read.
pub fn estimate(
    scan: &Scan,
    config: &EstimatorConfig,
    options: &Options,
    progress: &dyn Progress,
) -> Result<Estimate, EstimateError> {
    estimate_on(&WallClock::start(), scan, config, options, progress)
}

/// Estimates light and materials, with `machine` to tell the time. Reads like the paper's section list.
///
/// # Errors
/// The scan is unusable: no vertices, or no keyframe that can be read.
pub fn estimate_on(
    machine: &dyn Machine,
    scan: &Scan,
    config: &EstimatorConfig,
    options: &Options,
    progress: &dyn Progress,
) -> Result<Estimate, EstimateError> {
    let config = &budget::at_quality(config);
    let mut plan = Plan::new(machine, options, config, stages::size(scan, config));

    // §3.1: a regular mesh, and the keyframes' colours on it (Eqs. 2–5). §3.2: segments (Eqs. 6–7).
    let mut ready = stages::prepare(scan, config, &mut plan, progress)?;

    // §3.3: transfer (Eq. 8), then light and albedo (Eqs. 9–12).
    let traced = stages::transfer(&ready, config, options, &mut plan, progress);
    let settled = stages::settle(&mut ready, traced, config, options, &mut plan, progress);
    let (traced, settings) = (settled.traced, settled.settings);
    let mut found = factorise(Arc::clone(&traced), &ready.colors(), &settings, settled.start);
    plan.light_done(traced.mean_blocked(), settings.bands);

    // §3.4: specular weights (Eq. 13); lit colours without gloss are factorised once more.
    let lit_with_gloss = ready.fields.lit_color.clone();
    let mut gloss = vec![Gloss::NONE; ready.segments];
    if config.specular != Switch::Off && plan.specular(settings.bands) {
        progress.stage("specular", 0.0);
        let decisions;
        (found, gloss, decisions) =
            specular::refit::refit(&ready.mesh, &ready.scene, &mut ready.fields, &ready.segment, found, &settings);
        ready.decisions.extend(decisions);
        plan.specular_done(settings.bands);
        if gloss.iter().any(|g| g.significant) {
            found = stages::refine(&mut ready, found, &settings, config, options, &mut plan, progress);
        }
    }

    // The assumption that it all rests on, and frames that no step used.
    let (decision, near) = factorisation::distance_check::check(
        &ready.mesh,
        &ready.fields,
        &ready.segment,
        &found,
        &config.tuning.distance_check,
    );
    ready.decisions.push(decision);
    let mut warnings = std::mem::take(&mut ready.warnings);
    warnings.extend(near);
    progress.stage("witnesses", 0.0);
    let witnesses = stages::witnesses(&mut ready, scan, &found, &gloss, &lit_with_gloss, config, &mut plan);
    ready.decisions.push(stages::transfer_decision(&found));
    if scan.keyframes.len() < 2 {
        warnings.push(Warning::OneKeyframe);
    }
    warnings.extend(stages::unseen_light(&found));
    plan.writing();
    progress.stage("done", 1.0);
    Ok(Estimate {
        name: scan.name.clone(),
        response: scan.sensor.response,
        keyframes: stages::keyframes(scan, &ready),
        segments: stages::segment_table(&ready.segment, &found, &gloss),
        light: stages::light(&ready, &found, &gloss),
        transfer: stages::transfer_level(&found),
        mesh: ready.mesh,
        segment: ready.segment,
        lit_color: ready.fields.lit_color,
        albedo: found.detail.albedo,
        confidence: found.detail.confidence,
        decisions: ready.decisions,
        cuts: plan.cuts(),
        warnings,
        albedo_scale_rule: factorisation::SCALE_RULE.into(),
        witnesses,
    })
}
