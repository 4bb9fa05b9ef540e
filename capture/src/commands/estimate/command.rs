//! The command: where the result goes, and how the estimate ended.

use crate::cli;
use crate::commands::estimate::{here, if_changed};
use crate::commands::output::{check_parent, print};
use crate::estimator_process::{Ended, Files, Outcome};
use crate::failure::Failure;
use crate::report::Reporter;
use std::path::{Path, PathBuf};

/// Runs the command.
pub fn run(args: &cli::Estimate, json: bool, reporter: &Reporter) -> Result<(), Failure> {
    let files = Files {
        scan: args.scan.clone(),
        result: args.output.clone().unwrap_or_else(|| beside(&args.scan)),
        preview: args.preview.clone(),
        viewer: args.viewer.clone(),
    };
    let run = if args.if_changed { if_changed::run } else { here::run };
    let ended = check_parent(&files.result).and_then(|()| run(args, &files, reporter));
    let Ended { entry, failure } = ended.unwrap_or_else(Ended::failed);
    reporter.clear();
    let result = files.result.display().to_string();
    if json {
        let outcome = Outcome {
            scan: files.scan.display().to_string(),
            result,
            exit_code: failure.as_ref().map_or(0, Failure::code),
            retry: failure.as_ref().map(Failure::retry),
            estimator: entry,
        };
        print(&serde_json::to_string(&outcome).map_err(|e| Failure::Internal(e.to_string()))?)?;
    } else if entry.has_result() {
        print(&result)?;
    }
    failure.map_or(Ok(()), Err)
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
    fn results_stand_beside_their_scans() {
        assert_eq!(beside(Path::new("a/scan.lscan")), Path::new("a/result.lres"));
        assert_eq!(beside(Path::new("a/ball.lscan")), Path::new("a/ball.lres"));
    }
}
