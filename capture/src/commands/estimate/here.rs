//! The estimator in this process. Within a budget it works in a thread of its own, and the main thread keeps the time.

use crate::child_process::end_with_parent;
use crate::cli;
use crate::commands::estimate::answers::{Answers, Summary};
use crate::commands::estimate::inputs::Inputs;
use crate::commands::estimate::watchdog::{Due, Watchdog};
use crate::commands::settings::use_threads;
use crate::device_folder::files::write_file;
use crate::device_folder::manifest::{EstimatorEntry, EstimatorOutcome};
use crate::estimator_process::{Ended, Files};
use crate::failure::Failure;
use crate::memory;
use crate::report::Reporter;
use crate::stop::Stop;
use estimator::{Options, Progress};
use recordings::decision::Cut;
use recordings::result::Estimate;
use recordings::scan::Scan;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Time between two looks at the clock.
const TICK: Duration = Duration::from_millis(20);
/// Stack of the estimator's thread: that of a main thread.
const STACK_BYTES: usize = 8 << 20;
/// A result may be late by this.
const TOLERATED: Duration = Duration::from_secs(1);

/// Estimates, and writes the result and what else was asked for.
pub fn run(args: &cli::Estimate, files: &Files, reporter: &Reporter) -> Result<Ended, Failure> {
    let started = Instant::now();
    end_with_parent(args.parent)?;
    memory::limit(args.effort.memory)?;
    use_threads(args.effort.threads)?;
    let inputs = Inputs::read(&files.scan, &args.effort, args.reference)?;
    let origin = Some(inputs.origin.clone());
    let options = Options {
        budget: Duration::from_secs_f64(args.effort.budget),
        rounds: args.effort.rounds,
        reference: args.reference,
        memory_mb: args.effort.memory,
    };
    let Made { summary, after } = match options.rounds {
        Some(_) => in_rounds(files, inputs, &options, started, reporter)?,
        None => within_budget(files, inputs, &options, started, reporter)?,
    };
    write_pages(files, reporter)?;
    reporter.clear();

    let Summary { entry, cuts, warnings } = summary;
    for warning in &warnings {
        tracing::warn!("{warning}");
    }
    for cut in &cuts {
        tracing::warn!("cut for the budget: {cut}");
    }
    let late = if options.rounds.is_none() { late(after, options.budget) } else { None };
    let failure = abandoned(&cuts).or(late);
    let entry = EstimatorEntry {
        outcome: if failure.is_none() { EstimatorOutcome::Done } else { EstimatorOutcome::Partial },
        problem: failure.as_ref().map(ToString::to_string),
        origin,
        seconds: [reporter.stages(), vec![("total".into(), after.as_secs_f64())]].concat(),
        cpu_seconds: Some(memory::cpu_seconds()),
        memory_peak_bytes: memory::peak_bytes(),
        ..entry
    };
    Ok(Ended { entry, failure })
}

/// A result on the disk.
struct Made {
    summary: Summary,
    /// Time from the start until it was there.
    after: Duration,
}

/// A fixed effort, without a clock.
fn in_rounds(
    files: &Files,
    inputs: Inputs,
    options: &Options,
    started: Instant,
    reporter: &Reporter,
) -> Result<Made, Failure> {
    let scan = Scan::read(&files.scan)?;
    let result = estimate(&scan, files, &inputs, options, reporter)?;
    result.write_from(&files.result, Some(&inputs.origin)).map_err(|e| Failure::Internal(e.to_string()))?;
    Ok(Made { summary: Summary::of(&result), after: started.elapsed() })
}

/// The best answer that stands when the time is over.
fn within_budget(
    files: &Files,
    inputs: Inputs,
    options: &Options,
    started: Instant,
    reporter: &Reporter,
) -> Result<Made, Failure> {
    let stop = Stop::on_signals()?;
    reporter.set_deadline(started + options.budget);
    let answers = Arc::new(Answers::new(&files.result, inputs.origin.clone(), reporter, started, options.budget));
    let work = {
        let (answers, files, options) = (Arc::clone(&answers), files.clone(), options.clone());
        move || {
            let scan = Scan::read(&files.scan)?;
            let options = Options { budget: options.budget.saturating_sub(started.elapsed()), ..options };
            answers.stand(&estimate(&scan, &files, &inputs, &options, answers.as_ref())?)
        }
    };
    let cannot = |e: std::io::Error| Failure::Internal(format!("the estimator's thread could not be started: {e}"));
    let worker = std::thread::Builder::new().stack_size(STACK_BYTES).spawn(work).map_err(cannot)?;
    let mut watchdog = Watchdog::new(options.budget.as_secs_f64());
    let ended = loop {
        std::thread::sleep(TICK);
        if let Err(stopped) = stop.check() {
            break Err(stopped);
        }
        let due = watchdog.look(started.elapsed().as_secs_f64());
        // At the end only what is in place counts; without an answer the first one is waited for.
        if due != Due::Nothing && answers.put_in_place()? && due == Due::End {
            break Ok(());
        }
        if worker.is_finished() {
            let worked = worker.join().unwrap_or_else(|panic| Err(Failure::panic(panic.as_ref())));
            break worked.and_then(|()| answers.put_in_place().map(drop));
        }
    };
    let made = answers.end();
    ended?;
    let (summary, after) = made.ok_or_else(|| Failure::Internal("the estimator ended without an answer".into()))?;
    Ok(Made { summary, after })
}

fn estimate(
    scan: &Scan,
    files: &Files,
    inputs: &Inputs,
    options: &Options,
    progress: &dyn Progress,
) -> Result<Estimate, Failure> {
    estimator::estimate(scan, &inputs.config, options, progress)
        .map_err(|e| Failure::estimating(files.scan.display(), e))
}

/// Preview and viewer, where they are asked for.
fn write_pages(files: &Files, reporter: &Reporter) -> Result<(), Failure> {
    if files.preview.is_none() && files.viewer.is_none() {
        return Ok(());
    }
    let (scan, result) = (Scan::read(&files.scan)?, Estimate::read(&files.result)?);
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
    Ok(())
}

/// A planned cut is a decision; a stage that had to be given up half-way is a failure.
fn abandoned(cuts: &[Cut]) -> Option<Failure> {
    let stages: Vec<String> = cuts.iter().filter(|c| c.is_abandoned()).map(ToString::to_string).collect();
    (!stages.is_empty()).then(|| Failure::Abandoned(format!("{}; raise --budget", stages.join(", "))))
}

/// A result that was late is a failure, too.
fn late(after: Duration, budget: Duration) -> Option<Failure> {
    let [after_s, budget_s] = [after, budget].map(|d| d.as_secs_f64());
    (after > budget + TOLERATED).then(|| {
        Failure::Abandoned(format!(
            "the result was there after {after_s:.1} s, more than the budget of {budget_s:.1} s; raise --budget"
        ))
    })
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

    #[test]
    fn a_second_is_tolerated() {
        let seconds = Duration::from_secs_f64;
        assert!(late(seconds(30.9), seconds(30.0)).is_none());
        assert_eq!(late(seconds(31.1), seconds(30.0)).map(|f| f.code()), Some(5));
    }
}
