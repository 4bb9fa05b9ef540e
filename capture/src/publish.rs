//! From a captured scan to a published one, in two steps: the folder becomes visible with the result and a manifest that lists both; preview and
//! viewer follow, and count from the moment that the manifest lists them, too.

use crate::cli::Effort;
use crate::device_folder::files::write_file;
use crate::device_folder::manifest::{self, CaptureEntry, EstimatorEntry, MANIFEST, Manifest};
use crate::device_folder::staging::Staging;
use crate::estimator_process::{self, Files};
use crate::failure::Failure;
use crate::memory;
use crate::pages;
use crate::pipeline::Captured;
use crate::report::Reporter;
use crate::stop::Stop;
use estimator::Progress;
use std::path::{Path, PathBuf};

/// A published scan.
pub struct Published {
    /// Its folder.
    pub folder: PathBuf,
    /// Its manifest.
    pub manifest: Manifest,
    /// Why the estimator or what follows it failed, if it did; the scan is published anyway.
    pub failure: Option<Failure>,
}

/// Estimates the scan in `staging` (unless there is no `effort` for it) and publishes the folder.
///
/// # Errors
/// The disk is full or gone, or a signal came: nothing is published then, or the result is and [`complete`] can do the rest.
pub fn publish(
    mut staging: Staging,
    name: String,
    mut capture: CaptureEntry,
    effort: Option<&Effort>,
    stop: &Stop,
    reporter: &Reporter,
) -> Result<Published, Failure> {
    let (estimator, failure) = match effort {
        None => (EstimatorEntry::default(), None),
        Some(effort) => {
            let ended = estimator_process::estimate(&Files::of(staging.folder()), effort, None, stop, reporter)?;
            (ended.entry, ended.failure)
        }
    };
    stop.check()?;
    // The peak includes the result, which was read back.
    capture.memory_peak_bytes = memory::peak_bytes();
    let dates = staging.dates();
    let mut manifest = Manifest::new(staging.folder(), name, dates, capture, estimator)?;
    write_file(&staging.folder().join(MANIFEST), manifest.to_json()?.as_bytes())?;
    let folder = staging.publish()?;
    if !manifest.estimator.has_result() {
        return Ok(Published { folder, manifest, failure });
    }
    reporter.stage("preview", 0.0);
    let pages = pages::write(&folder, effort.and_then(|e| e.threads), stop, reporter);
    stop.check()?;
    if !folder.exists() {
        tracing::info!("{} was removed or renamed before its preview was there", folder.display());
        return Ok(Published { folder, manifest, failure });
    }
    let (seconds, problem) = pages.map_or_else(|e| (Vec::new(), Some(e)), |seconds| (seconds, None));
    manifest.complete(&folder, seconds)?;
    write_file(&folder.join(MANIFEST), manifest.to_json()?.as_bytes())?;
    Ok(Published { folder, manifest, failure: failure.or(problem) })
}

/// Makes what follows the result of a published scan, where an earlier run ended before that.
///
/// # Errors
/// The disk is full or gone, a signal came, or a page cannot be made.
pub fn complete(folder: &Path, stop: &Stop, reporter: &Reporter) -> Result<(), Failure> {
    let pages = pages::write(folder, None, stop, reporter);
    stop.check()?;
    manifest::complete_later(folder)?;
    pages.map(drop)
}

/// Estimates a published scan again.
///
/// # Errors
/// The disk is full or gone, a signal came, or the estimator failed; what was published stays then.
pub fn again(folder: &Path, effort: &Effort, stop: &Stop, reporter: &Reporter) -> Result<(), Failure> {
    let ended = estimator_process::estimate(&Files::of(folder), effort, None, stop, reporter)?;
    match ended.failure {
        None | Some(Failure::Abandoned(_)) => {
            let pages = pages::write(folder, effort.threads, stop, reporter);
            let text = manifest::updated(folder, folder, &ended.entry)?;
            write_file(&folder.join(MANIFEST), text.as_bytes())?;
            pages.map(drop)
        }
        Some(failure) => Err(failure),
    }
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
        last_frame: Some(captured.last_frame),
        stats: captured.stats,
    }
}
