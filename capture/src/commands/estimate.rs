//! `lumiscan estimate`: a scan to a result.

use crate::cli;
use crate::commands::output::check_parent;
use crate::commands::output::print;
use crate::commands::output::print_json;
use crate::commands::settings::use_threads;
use crate::device_folder::files::write_file;
use crate::estimator_process::Summary;
use crate::failure::Failure;
use crate::memory;
use crate::report::Reporter;
use estimator::Options;
use estimator::Progress;
use firmware_config::Config;
use recordings::decision::Cut;
use recordings::scan::Scan;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Runs the command.
pub fn run(args: &cli::Estimate, json: bool, reporter: &Reporter) -> Result<(), Failure> {
    let started = Instant::now();
    let budget = Duration::from_secs_f64(args.effort.budget);
    let output = args.output.clone().unwrap_or_else(|| beside(&args.scan));
    check_parent(&output)?;
    memory::limit(args.effort.memory)?;
    use_threads(args.effort.threads)?;
    if args.effort.rounds.is_none() {
        reporter.set_deadline(started + budget);
    }

    let shown = args.scan.display();
    let scan = Scan::read(&args.scan)?;
    // Written by the program that made the scan, perhaps of another version: an unknown key is an input error.
    let mut config = Config::from_toml(&scan.config)
        .map_err(|e| Failure::Input(format!("{shown}: its settings: {e}; scan again with this version")))?;
    if let Some(point) = args.effort.quality {
        config.estimator.quality = point.setting();
    }
    let options = Options {
        budget: budget.saturating_sub(started.elapsed()),
        rounds: args.effort.rounds,
        reference: args.reference,
    };
    let result =
        estimator::estimate(&scan, &config.estimator, &options, reporter).map_err(|e| Failure::estimating(shown, e))?;
    result.write(&output).map_err(|e| Failure::Internal(e.to_string()))?;
    let seconds = started.elapsed().as_secs_f64();
    if let Some(path) = &args.preview {
        reporter.stage("preview", 0.0);
        let png = estimator::preview::sheet::sheet(&scan, &result).map_err(|e| Failure::writing(path, e))?;
        write_file(path, &png)?;
    }
    if let Some(path) = &args.viewer {
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
    if json {
        print_json(&Summary {
            result: output.display().to_string(),
            vertices: result.mesh.positions.len(),
            seconds,
            stages: reporter.stages(),
            memory_peak_bytes: memory::peak_bytes(),
        })?;
    } else {
        print(&output.display().to_string())?;
    }
    abandoned(&result.cuts)
}

/// A planned cut is a decision; a stage that had to be given up half-way is not.
fn abandoned(cuts: &[Cut]) -> Result<(), Failure> {
    let stages: Vec<String> = cuts.iter().filter(|c| c.is_abandoned()).map(ToString::to_string).collect();
    if stages.is_empty() { Ok(()) } else { Err(Failure::Abandoned(format!("{}; raise --budget", stages.join(", ")))) }
}

/// `result.lres` for `scan.lscan`, as in the device folder; otherwise of the same stem.
fn beside(scan: &Path) -> PathBuf {
    if scan.file_name().is_some_and(|n| n == "scan.lscan") {
        scan.with_file_name("result.lres")
    } else {
        scan.with_extension("lres")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_abandoned_stages_are_a_failure() {
        let fewer = Cut::FewerRays { rays: 32, instead_of: 128 };
        assert!(abandoned(std::slice::from_ref(&fewer)).is_ok());
        let failure = abandoned(&[fewer, Cut::AbandonedTransfer { rays: 64 }]).unwrap_err();
        assert_eq!(failure.code(), 5);
        assert!(failure.to_string().contains("transfer with 64 rays"));
    }

    #[test]
    fn results_stand_beside_their_scans() {
        assert_eq!(beside(Path::new("a/scan.lscan")), Path::new("a/result.lres"));
        assert_eq!(beside(Path::new("a/ball.lscan")), Path::new("a/ball.lres"));
    }
}
