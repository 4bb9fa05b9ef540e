//! The estimator as a child process: this executable again with `estimate`, so that a crash or an out-of-memory kill of the
//! estimator never ends the capture.

use crate::child_process::{IDLE, Waited, relay, wait};
use crate::cli::Effort;
use crate::commands::estimate::answers;
use crate::device_folder::manifest::{EstimatorEntry, EstimatorOutcome};
use crate::failure::{Failure, Retry};
use crate::memory;
use crate::report::Reporter;
use crate::stop::Stop;
use estimator::Reference;
use recordings::result::Estimate;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::io::{BufReader, Read};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// The line with which `lumiscan --json estimate` ends.
#[derive(Debug, Serialize, Deserialize)]
pub struct Outcome {
    /// The scan file.
    pub scan: String,
    /// The result file.
    pub result: String,
    /// Exit code of the process.
    pub exit_code: u8,
    /// When the same command may succeed, if it failed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub retry: Option<Retry>,
    /// What the estimator did.
    #[serde(flatten)]
    pub estimator: EstimatorEntry,
}

/// How the estimator ended.
#[derive(Debug, Default)]
pub struct Ended {
    /// What it did.
    pub entry: EstimatorEntry,
    /// Why it failed, if it did.
    pub failure: Option<Failure>,
}

impl Ended {
    /// Without a result.
    #[must_use]
    pub fn failed(failure: Failure) -> Self {
        let (outcome, problem) = (EstimatorOutcome::Failed, Some(failure.to_string()));
        let entry = EstimatorEntry { outcome, problem, ..EstimatorEntry::default() };
        Self { entry, failure: Some(failure) }
    }
}

/// What the estimator reads and writes.
#[derive(Debug, Clone)]
pub struct Files {
    /// The scan.
    pub scan: PathBuf,
    /// The result.
    pub result: PathBuf,
    /// The preview sheet.
    pub preview: Option<PathBuf>,
    /// The viewer page.
    pub viewer: Option<PathBuf>,
}

impl Files {
    /// Those of a folder of the device folder, where preview and viewer follow the result.
    #[must_use]
    pub fn of(folder: &Path) -> Self {
        let [scan, result] = ["scan.lscan", "result.lres"].map(|name| folder.join(name));
        Self { scan, result, preview: None, viewer: None }
    }
}

/// The child is killed after this many budgets plus [`KILL_AFTER`].
const KILL_AFTER_BUDGETS: f64 = 4.0;
/// A coarse estimate is killed after this time.
const COARSE_LIMIT: Duration = Duration::from_secs(60);
/// See [`KILL_AFTER_BUDGETS`].
const KILL_AFTER: Duration = Duration::from_secs(60);

/// Estimates a scan, passing progress on.
///
/// # Errors
/// The child could not be started, or a signal came (the child is killed then). [`Ended`] reports how the child ended.
pub fn estimate(
    files: &Files,
    effort: &Effort,
    reference: Option<Reference>,
    stop: &Stop,
    reporter: &Reporter,
) -> Result<Ended, Failure> {
    if effort.rounds.is_none() {
        reporter.set_deadline(Instant::now() + Duration::from_secs_f64(effort.budget));
    }
    let cannot = |e: std::io::Error| Failure::Internal(format!("the estimator could not be started: {e}"));
    let mut command = Command::new(std::env::current_exe().map_err(cannot)?);
    command.args(["--json", "estimate"]).arg(&files.scan).arg("-o").arg(&files.result);
    for (option, path) in [("--preview", &files.preview), ("--viewer", &files.viewer)] {
        if let Some(path) = path {
            command.arg(option).arg(path);
        }
    }
    command.arg("--parent").arg(std::process::id().to_string());
    command.arg("--budget").arg(effort.budget.to_string());
    if reporter.verbose() {
        command.arg("--verbose");
    }
    if let Some(n) = effort.rounds {
        command.arg("--rounds").arg(n.to_string());
    }
    if let Some(point) = effort.quality {
        command.arg("--quality").arg(point.name());
    }
    if let Some(reference) = reference {
        command.arg("--reference").arg(reference.to_string());
    }
    if let Some(n) = effort.threads {
        command.arg("--threads").arg(n.to_string());
    }
    if let Some(mb) = effort.memory {
        // A backtrace needs memory: printed where none is left, it fails within itself and never ends.
        command.arg("--memory").arg(mb.to_string()).env("RUST_BACKTRACE", "0");
    }
    let limit = match effort.rounds {
        None => Some(KILL_AFTER + Duration::from_secs_f64(KILL_AFTER_BUDGETS * effort.budget)),
        // A fixed number of rounds has no clock.
        Some(_) => None,
    };
    let kills_before = memory::out_of_memory_kills();
    let mut child =
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().map_err(cannot)?;
    let (Some(stdout), Some(stderr)) = (child.stdout.take(), child.stderr.take()) else {
        return Err(Failure::Internal("the estimator's output could not be read".into()));
    };
    std::thread::scope(|scope| {
        let relay = scope.spawn(|| relay(BufReader::new(stderr), "estimator", reporter));
        let answer = scope.spawn(|| {
            let mut text = String::new();
            BufReader::new(stdout).read_to_string(&mut text).map(|_| text).unwrap_or_default()
        });
        let waited = wait(&mut child, stop, limit);
        let is_out_of_memory = memory::out_of_memory_kills() > kills_before;
        let last_lines = relay.join().unwrap_or_default();
        let answer = answer.join().unwrap_or_default();
        let waited = Waited { is_out_of_memory, ..waited.inspect_err(|_| answers::clear(&files.result))? };
        Ok(ended(&waited, &answer, &last_lines, effort.memory, &files.result))
    })
}

/// Estimates a small scan at the lowest priority, with two threads and one round of rays; returns its processor time in
/// seconds.
///
/// # Errors
/// The child could not be started or ended without a result, or a signal came.
pub fn estimate_coarsely(scan: &Path, result: &Path, memory_mb: u32, stop: &Stop) -> Result<f64, Failure> {
    let cannot = |e: std::io::Error| Failure::Internal(format!("the estimator could not be started: {e}"));
    let mut command = Command::new(std::env::current_exe().map_err(cannot)?);
    command.args(["--json", "estimate"]).arg(scan).arg("-o").arg(result).args(["--rounds", "1", "--threads", "2"]);
    command.arg("--parent").arg(std::process::id().to_string());
    command.arg("--memory").arg(memory_mb.to_string()).env("RUST_BACKTRACE", "0");
    let mut child =
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().map_err(cannot)?;
    let pid = rustix::process::Pid::from_child(&child);
    if let Err(e) = rustix::process::setpriority_process(Some(pid), IDLE) {
        tracing::debug!("priority of the estimator: {e}");
    }
    // Its answer is far smaller than a pipe holds.
    let waited = wait(&mut child, stop, Some(COARSE_LIMIT))?;
    let mut answer = String::new();
    child.stdout.take().map(|mut out| out.read_to_string(&mut answer));
    let answer = serde_json::from_str::<Outcome>(&answer).ok().map(|o| o.estimator);
    let ended = || Failure::Internal(format!("the estimator ended without a result ({})", waited.status));
    answer.filter(EstimatorEntry::has_result).and_then(|e| e.cpu_seconds).ok_or_else(ended)
}

/// How the child ended, from its status, its answer and its last log lines.
fn ended(waited: &Waited, answer: &str, last_lines: &VecDeque<String>, limit_mb: Option<u32>, result: &Path) -> Ended {
    let answer = serde_json::from_str::<Outcome>(answer).map(|o| o.estimator).ok();
    let mut failure = match waited.status.code() {
        Some(0) if answer.is_some() => None,
        _ => Some(failure(waited, last_lines, limit_mb)),
    };
    let mut entry = answer.unwrap_or(EstimatorEntry { outcome: EstimatorOutcome::Failed, ..Default::default() });
    if !entry.has_result() && answers::recover(result) {
        entry.outcome = EstimatorOutcome::Partial;
    }
    if entry.has_result() {
        match Estimate::read(result) {
            Ok(estimate) => entry.describe(&estimate),
            Err(e) => {
                entry.outcome = EstimatorOutcome::Failed;
                failure = failure.or(Some(Failure::Internal(e.to_string())));
            }
        }
    }
    entry.problem = failure.as_ref().map(ToString::to_string);
    Ended { entry, failure }
}

/// Why the child ended without success.
fn failure(waited: &Waited, last_lines: &VecDeque<String>, limit_mb: Option<u32>) -> Failure {
    let Waited { status, killed_after, is_out_of_memory } = waited;
    let message = last_lines.iter().map(String::as_str).collect::<Vec<_>>().join(" · ");
    if let Some(failure) = status.code().and_then(|code| Failure::of_child(code, message.clone())) {
        return failure;
    }
    if let Some(time) = killed_after {
        let time = time.as_secs_f64();
        return Failure::Abandoned(format!(
            "the estimator did not end within {time:.0} s and was killed; there is no result"
        ));
    }
    let hint = limit_mb.map_or(String::new(), |mb| {
        format!("; run `lumiscan estimate` on it without a memory limit, or with one above {mb} MB")
    });
    let text = format!("the estimator ended early ({status}) {message}; the scan itself is complete{hint}");
    // The system's out-of-memory killer sends SIGKILL, as others may; an allocation that the limit refuses aborts.
    let is_killed = *is_out_of_memory && status.signal() == Some(signal_hook::consts::SIGKILL);
    if is_killed || message.contains("memory allocation of") { Failure::Memory(text) } else { Failure::Internal(text) }
}
