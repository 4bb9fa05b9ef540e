//! `--if-changed`: nothing is done where the result is there already. The estimator runs as a child, so that its end for want of memory
//! is reported, too.

use crate::cli;
use crate::commands::estimate::inputs::Inputs;
use crate::device_folder::files::beside;
use crate::device_folder::manifest::{EstimatorEntry, EstimatorOutcome};
use crate::estimator_process::{self, Ended, Files};
use crate::failure::Failure;
use crate::report::Reporter;
use crate::stop::Stop;
use recordings::codec::exclusive::open_exclusive;
use recordings::decision::Cut;
use recordings::result::{Estimate, Origin};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Time between two attempts to get a claim.
const POLL: Duration = Duration::from_millis(100);

/// Estimates, unless the result is there.
pub fn run(args: &cli::Estimate, files: &Files, reporter: &Reporter) -> Result<Ended, Failure> {
    let stop = Stop::on_signals()?;
    let Inputs { origin, .. } = Inputs::read(&files.scan, &args.effort, args.reference)?;
    let _claim = Claim::take(&files.result, &stop)?;
    match finished(files, &origin) {
        Some(result) => {
            let outcome = EstimatorOutcome::Unchanged;
            let mut entry = EstimatorEntry { outcome, origin: Some(origin), ..EstimatorEntry::default() };
            entry.describe(&result);
            Ok(Ended { entry, failure: None })
        }
        None => estimator_process::estimate(files, &args.effort, args.reference, &stop, reporter),
    }
}

/// The result, if it is complete, undamaged, and made from the same.
fn finished(files: &Files, origin: &Origin) -> Option<Estimate> {
    let others = [&files.preview, &files.viewer];
    if others.into_iter().flatten().any(|path| !path.exists())
        || Origin::read(&files.result).ok()?.as_ref() != Some(origin)
    {
        return None;
    }
    Estimate::read(&files.result).ok().filter(|result| !result.cuts.iter().any(Cut::is_abandoned))
}

/// The right to make a result: one process at a time has it. It ends with the process.
struct Claim {
    path: PathBuf,
    _file: File,
}

impl Claim {
    /// Waits for it.
    ///
    /// # Errors
    /// The folder cannot be written, or a signal came.
    fn take(result: &Path, stop: &Stop) -> Result<Self, Failure> {
        let path = beside(result, ".lock");
        let mut is_waiting = false;
        loop {
            stop.check()?;
            match open_exclusive(&path) {
                Ok(Some(file)) => return Ok(Self { path, _file: file }),
                Ok(None) if !is_waiting => tracing::info!("waiting: another process makes {}", result.display()),
                Ok(None) => {}
                Err(e) => return Err(Failure::writing(&path, e)),
            }
            is_waiting = true;
            std::thread::sleep(POLL);
        }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        // While it is locked, so that nobody else has it.
        let _ = std::fs::remove_file(&self.path);
    }
}
