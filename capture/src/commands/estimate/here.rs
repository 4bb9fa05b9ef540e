//! The estimator in this process.

use crate::child_process::end_with_parent;
use crate::cli;
use crate::commands::estimate::inputs::Inputs;
use crate::commands::settings::use_threads;
use crate::device_folder::files::write_file;
use crate::device_folder::manifest::{EstimatorEntry, EstimatorOutcome};
use crate::estimator_process::{Ended, Files};
use crate::failure::Failure;
use crate::memory;
use crate::report::Reporter;
use estimator::Options;
use estimator::Progress;
use recordings::decision::Cut;
use recordings::scan::Scan;
use std::time::{Duration, Instant};

/// Estimates, and writes the result and what else was asked for.
pub fn run(args: &cli::Estimate, files: &Files, reporter: &Reporter) -> Result<Ended, Failure> {
    let started = Instant::now();
    let budget = Duration::from_secs_f64(args.effort.budget);
    end_with_parent(args.parent)?;
    memory::limit(args.effort.memory)?;
    use_threads(args.effort.threads)?;
    if args.effort.rounds.is_none() {
        reporter.set_deadline(started + budget);
    }

    let scan = Scan::read(&files.scan)?;
    let Inputs { config, origin } = Inputs::read(&files.scan, &args.effort, args.reference)?;
    let options = Options {
        budget: budget.saturating_sub(started.elapsed()),
        rounds: args.effort.rounds,
        reference: args.reference,
    };
    let result = estimator::estimate(&scan, &config, &options, reporter)
        .map_err(|e| Failure::estimating(files.scan.display(), e))?;
    result.write_from(&files.result, Some(&origin)).map_err(|e| Failure::Internal(e.to_string()))?;
    let seconds = started.elapsed().as_secs_f64();
    if let Some(path) = &files.preview {
        reporter.stage("preview", 0.0);
        let png = estimator::preview::sheet::sheet(&scan, &result).map_err(|e| Failure::writing(path, e))?;
        write_file(path, &png)?;
    }
    if let Some(path) = &files.viewer {
        reporter.stage("viewer", 0.0);
        estimator::export::html::write(&result, Some(&scan), &reporter.stages(), path)
            .map_err(|e| Failure::writing(path, e))?;
    }
    reporter.clear();

    for warning in &result.warnings {
        tracing::warn!("{warning}");
    }
    for cut in &result.cuts {
        tracing::warn!("cut for the budget: {cut}");
    }
    if args.effort.rounds.is_none() && seconds > args.effort.budget {
        tracing::warn!("took {seconds:.0} s, more than the budget of {:.0} s", args.effort.budget);
    }
    let failure = abandoned(&result.cuts);
    let mut entry = EstimatorEntry {
        outcome: if failure.is_none() { EstimatorOutcome::Done } else { EstimatorOutcome::Partial },
        problem: failure.as_ref().map(ToString::to_string),
        origin: Some(origin),
        seconds: [reporter.stages(), vec![("total".into(), seconds)]].concat(),
        cpu_seconds: Some(memory::cpu_seconds()),
        memory_peak_bytes: memory::peak_bytes(),
        ..EstimatorEntry::default()
    };
    entry.describe(&result);
    Ok(Ended { entry, failure })
}

/// A planned cut is a decision; a stage that had to be given up half-way is a failure.
fn abandoned(cuts: &[Cut]) -> Option<Failure> {
    let stages: Vec<String> = cuts.iter().filter(|c| c.is_abandoned()).map(ToString::to_string).collect();
    (!stages.is_empty()).then(|| Failure::Abandoned(format!("{}; raise --budget", stages.join(", "))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_abandoned_stages_are_a_failure() {
        let fewer = Cut::FewerRays { rays: 32, instead_of: 128 };
        assert!(abandoned(std::slice::from_ref(&fewer)).is_none());
        let failure = abandoned(&[fewer, Cut::AbandonedTransfer { rays: 64 }]).unwrap();
        assert_eq!(failure.code(), 5);
        assert!(failure.to_string().contains("transfer with 64 rays"));
    }
}
