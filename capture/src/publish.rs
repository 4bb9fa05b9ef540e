//! From a captured scan to a published one: runs the estimator, writes the manifest, makes the folder visible.

use crate::cli::Effort;
use crate::device_folder::files::write_file;
use crate::device_folder::manifest::{CaptureEntry, EstimatorEntry, EstimatorOutcome, Manifest};
use crate::device_folder::naming::utc;
use crate::device_folder::staging::Staging;
use crate::estimator_process::{self, Outcome};
use crate::failure::Failure;
use crate::memory;
use crate::pipeline::Captured;
use crate::report::Reporter;
use crate::stop::Stop;
use recordings::decision_text::Findings;
use recordings::result::Estimate;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

/// A published scan.
pub struct Published {
    /// Its folder.
    pub folder: PathBuf,
    /// Its manifest.
    pub manifest: Manifest,
    /// Why the estimator failed, if it did; the scan is published anyway.
    pub failure: Option<Failure>,
}

/// Estimates the scan in `staging` (unless there is no `effort` for it) and publishes the folder.
///
/// # Errors
/// The disk is full or gone, or a signal came; nothing is published then.
pub fn publish(
    staging: Staging,
    name: String,
    mut capture: CaptureEntry,
    effort: Option<&Effort>,
    stop: &Stop,
    reporter: &Reporter,
) -> Result<Published, Failure> {
    let (estimator, failure) = match effort {
        None => (EstimatorEntry::default(), None),
        Some(effort) => estimate(staging.folder(), effort, stop, reporter)?,
    };
    stop.check()?;
    let published = utc(SystemTime::now());
    // The peak includes the result, which was read back.
    capture.memory_peak_bytes = memory::peak_bytes();
    let manifest = Manifest::new(staging.folder(), name, published, capture, estimator)?;
    write_file(&staging.folder().join("manifest.json"), manifest.to_json()?.as_bytes())?;
    let folder = staging.publish()?;
    Ok(Published { folder, manifest, failure })
}

/// Runs the estimator. Its failure goes into the manifest and does not prevent publishing.
fn estimate(
    folder: &Path,
    effort: &Effort,
    stop: &Stop,
    reporter: &Reporter,
) -> Result<(EstimatorEntry, Option<Failure>), Failure> {
    if effort.rounds.is_none() {
        reporter.set_deadline(Instant::now() + Duration::from_secs_f64(effort.budget));
    }
    let Outcome { summary, mut failure } = estimator_process::estimate(folder, effort, stop, reporter)?;
    let mut entry = EstimatorEntry { outcome: EstimatorOutcome::Failed, ..EstimatorEntry::default() };
    if let Some(summary) = summary {
        entry.seconds = summary.stages;
        entry.seconds.push(("total".into(), summary.seconds));
        entry.memory_peak_bytes = summary.memory_peak_bytes;
    }
    let result = folder.join("result.lres");
    if result.exists() {
        match Estimate::read(&result) {
            Ok(estimate) => {
                entry.outcome = if failure.is_none() { EstimatorOutcome::Done } else { EstimatorOutcome::Partial };
                entry.vertices = estimate.mesh.positions.len();
                entry.findings = Findings::new(&estimate.decisions, &estimate.cuts, &estimate.warnings);
            }
            Err(e) => failure = failure.or(Some(Failure::Internal(e.to_string()))),
        }
    }
    entry.problem = failure.as_ref().map(ToString::to_string);
    Ok((entry, failure))
}

/// The capture's part of the manifest.
#[must_use]
pub fn capture_entry(source: &Path, captured: Captured) -> CaptureEntry {
    let seconds = [("fusion", captured.fusion), ("extraction", captured.extraction), ("writing", captured.writing)];
    CaptureEntry {
        source: source.file_name().unwrap_or(source.as_os_str()).to_string_lossy().into_owned(),
        vertices: captured.vertices,
        keyframes: captured.keyframes,
        seconds: seconds.iter().map(|(name, d)| ((*name).to_owned(), d.as_secs_f64())).collect(),
        memory_peak_bytes: memory::peak_bytes(),
        stats: captured.stats,
    }
}
