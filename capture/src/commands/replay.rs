//! `lumiscan replay`: a recording to a published scan.

use super::{load, print, use_threads};
use crate::child::{self, Ended};
use crate::cli;
use crate::device::{self, Staging};
use crate::failure::Failure;
use crate::manifest::{CaptureEntry, EstimatorEntry, Manifest};
use crate::pipeline::{self, Captured};
use crate::report::Reporter;
use crate::source::Pairs;
use crate::stop::Stop;
use crate::{memory, trajectory};
use recordings::result::Estimate;
use std::path::Path;
use std::time::{Duration, Instant, SystemTime};

/// Runs the command.
pub fn run(args: &cli::Replay, json: bool, reporter: &Reporter) -> Result<(), Failure> {
    let config = load(&args.settings)?;
    use_threads(args.effort.threads)?;
    let pairs = Pairs::open(&args.source, args.loops, &config.capture)?;
    let name = name_of(&args.source);
    let stop = Stop::on_signals()?;
    let staging = Staging::create(&args.device, &name)?;
    let scan_path = staging.folder().join("scan.lscan");

    let captured = pipeline::run(pairs, &name, &args.source, &scan_path, &config, &stop, reporter)?;
    device::write_file(&staging.folder().join("trajectory.txt"), trajectory::to_tum(&captured.trajectory).as_bytes())?;
    told(&captured);

    let (estimator, failure) = if args.no_estimate {
        (EstimatorEntry { outcome: "skipped", ..EstimatorEntry::default() }, None)
    } else {
        estimate(staging.folder(), &args.effort, &stop, reporter)?
    };
    stop.check()?;
    let published = device::utc(SystemTime::now());
    let manifest = Manifest::new(staging.folder(), name, published, capture_entry(&args.source, captured), estimator)?;
    device::write_file(&staging.folder().join("manifest.json"), manifest.to_json()?.as_bytes())?;
    let folder = staging.publish()?;
    reporter.clear();
    if json {
        super::print_json(&serde_json::json!({ "folder": folder, "manifest": manifest }))?;
    } else {
        print(&folder.display().to_string())?;
    }
    failure.map_or(Ok(()), Err)
}

/// Runs the estimator. The scan is worth publishing whatever becomes of it: the manifest says what did.
fn estimate(
    folder: &Path,
    effort: &cli::Effort,
    stop: &Stop,
    reporter: &Reporter,
) -> Result<(EstimatorEntry, Option<Failure>), Failure> {
    if effort.rounds.is_none() {
        reporter.set_deadline(Instant::now() + Duration::from_secs_f64(effort.budget));
    }
    let Ended { summary, mut failure } = child::estimate(folder, effort, stop, reporter)?;
    let mut entry = EstimatorEntry { outcome: "failed", ..EstimatorEntry::default() };
    if let Some(summary) = summary {
        entry.seconds = summary.stages;
        entry.seconds.push(("total".into(), summary.seconds));
        entry.memory_peak_bytes = summary.memory_peak_bytes;
    }
    let result = folder.join("result.lres");
    if result.exists() {
        match Estimate::read(&result) {
            Ok(estimate) => {
                entry.outcome = if failure.is_none() { "done" } else { "partial" };
                entry.vertices = estimate.mesh.positions.len();
                entry.decisions = estimate.decisions;
                entry.cuts = estimate.cuts;
                entry.warnings = estimate.warnings;
            }
            Err(e) => failure = failure.or(Some(Failure::Internal(e.to_string()))),
        }
    }
    entry.problem = failure.as_ref().map(ToString::to_string);
    Ok((entry, failure))
}

fn capture_entry(source: &Path, captured: Captured) -> CaptureEntry {
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

/// One line a person can judge a capture by.
fn told(c: &Captured) {
    let per_frame = c.fusion.as_secs_f64() * 1e3 / (c.stats.pairs.max(1) as f64);
    tracing::info!(
        "{} of {} pairs tracked, {per_frame:.1} ms a frame · {} vertices, {} triangles, {} keyframes",
        c.trajectory.len(),
        c.stats.pairs,
        c.vertices,
        c.triangles,
        c.keyframes
    );
}

/// The folder's name, or the recording's without its extension.
fn name_of(source: &Path) -> String {
    let full = source.canonicalize().unwrap_or_else(|_| source.to_path_buf());
    let name = if full.is_dir() { full.file_name() } else { full.file_stem() };
    name.map_or("scan".into(), |n| n.to_string_lossy().into_owned())
}
