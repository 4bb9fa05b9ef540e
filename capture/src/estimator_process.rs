//! The estimator as a child process: this executable again with `estimate`, so that a crash or an out-of-memory kill of the
//! estimator never ends the capture.

use crate::cli::Effort;
use crate::failure::Failure;
use crate::report::{Reporter, Step};
use crate::stop::Stop;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};
use tracing::Level;

/// The answer of `lumiscan --json estimate` on stdout.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// The result file.
    pub result: String,
    /// Vertices of the result.
    pub vertices: usize,
    /// Seconds from the process's start to the result on disk.
    pub seconds: f64,
    /// Seconds of each stage, in the order they ran.
    pub stages: Vec<(String, f64)>,
    /// Peak resident memory.
    pub memory_peak_bytes: Option<u64>,
}

/// How the estimator ended.
#[derive(Debug)]
pub struct Outcome {
    /// Its answer, if it wrote a result.
    pub summary: Option<Summary>,
    /// Why it failed, if it did.
    pub failure: Option<Failure>,
}

/// Time between two checks of the child.
const POLL: Duration = Duration::from_millis(20);
/// Last lines of its stderr that the error message quotes.
const KEPT_LINES: usize = 4;
/// The child is killed after this many budgets plus [`KILL_AFTER`].
const KILL_AFTER_BUDGETS: f64 = 4.0;
/// See [`KILL_AFTER_BUDGETS`].
const KILL_AFTER: Duration = Duration::from_secs(60);

/// Estimates `folder`'s `scan.lscan` into `result.lres`, `preview.png` and `viewer.html`, passing progress on.
///
/// # Errors
/// The child could not be started, or a signal came (the child is killed then). [`Outcome`] reports how the child ended.
pub fn estimate(folder: &Path, effort: &Effort, stop: &Stop, reporter: &Reporter) -> Result<Outcome, Failure> {
    let cannot = |e: std::io::Error| Failure::Internal(format!("the estimator could not be started: {e}"));
    let mut command = Command::new(std::env::current_exe().map_err(cannot)?);
    command.args(["--json", "estimate"]).arg(folder.join("scan.lscan"));
    command.arg("-o").arg(folder.join("result.lres")).arg("--preview").arg(folder.join("preview.png"));
    command.arg("--viewer").arg(folder.join("viewer.html"));
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
    let mut child =
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().map_err(cannot)?;
    let (Some(stdout), Some(stderr)) = (child.stdout.take(), child.stderr.take()) else {
        return Err(Failure::Internal("the estimator's output could not be read".into()));
    };
    std::thread::scope(|scope| {
        let relay = scope.spawn(|| relay(BufReader::new(stderr), reporter));
        let answer = scope.spawn(|| {
            let mut text = String::new();
            BufReader::new(stdout).read_to_string(&mut text).map(|_| text).unwrap_or_default()
        });
        let status = wait(&mut child, stop, limit);
        let last_lines = relay.join().unwrap_or_default();
        let answer = answer.join().unwrap_or_default();
        let status = status?;
        let summary = serde_json::from_str(&answer).ok();
        let failure = match status.code() {
            Some(0) if summary.is_some() => None,
            _ => Some(failure(status, &last_lines, effort.memory)),
        };
        Ok(Outcome { summary, failure })
    })
}

/// Waits for the child to end; kills it when a signal comes or `limit` has passed.
fn wait(child: &mut Child, stop: &Stop, limit: Option<Duration>) -> Result<ExitStatus, Failure> {
    let began = Instant::now();
    loop {
        match child.try_wait() {
            Ok(Some(status)) => return Ok(status),
            Ok(None) => {}
            Err(e) => return Err(Failure::Internal(format!("waiting for the estimator: {e}"))),
        }
        if let Err(stopped) = stop.check() {
            let _ = child.kill();
            let _ = child.wait();
            return Err(stopped);
        }
        if limit.is_some_and(|p| began.elapsed() > p) {
            tracing::warn!("the estimator has not ended after {:.0} s and is killed", began.elapsed().as_secs_f64());
            // It may have ended just now; its status is read in the next turn.
            let _ = child.kill();
        }
        std::thread::sleep(POLL);
    }
}

/// Shows the child's progress as this process's own and forwards its log lines; returns its last warnings and errors.
fn relay(lines: impl BufRead, reporter: &Reporter) -> VecDeque<String> {
    #[derive(Deserialize)]
    struct LogLine {
        level: String,
        message: String,
    }
    let mut last = VecDeque::new();
    for line in lines.lines().map_while(Result::ok) {
        if let Ok(step) = serde_json::from_str::<Step>(&line) {
            reporter.step(&step);
            continue;
        }
        let (level, message) = match serde_json::from_str::<LogLine>(&line) {
            Ok(l) => (l.level.parse().unwrap_or(Level::WARN), l.message),
            Err(_) => (Level::WARN, line),
        };
        match level {
            // Part of the failure that is returned.
            Level::ERROR => {}
            Level::WARN => tracing::warn!("estimator: {message}"),
            Level::INFO => tracing::info!("estimator: {message}"),
            _ => tracing::debug!("estimator: {message}"),
        }
        if level <= Level::WARN {
            last.push_back(message);
            if last.len() > KEPT_LINES {
                last.pop_front();
            }
        }
    }
    last
}

/// Why the child ended without success.
fn failure(status: ExitStatus, last_lines: &VecDeque<String>, limit_mb: Option<u32>) -> Failure {
    let message = last_lines.iter().map(String::as_str).collect::<Vec<_>>().join(" · ");
    if let Some(failure) = status.code().and_then(|code| Failure::of_child(code, message.clone())) {
        return failure;
    }
    let hint = limit_mb.map_or(String::new(), |mb| {
        format!("; run `lumiscan estimate` on it without a memory limit, or with one above {mb} MB")
    });
    Failure::Internal(format!("the estimator ended early ({status}) {message}; the scan itself is complete{hint}"))
}

#[cfg(test)]
mod tests {
    use super::wait;
    use crate::stop::Stop;
    use std::process::Command;
    use std::time::Duration;

    #[test]
    #[cfg(unix)]
    fn a_child_that_never_ends_is_ended() {
        let mut child = Command::new("sleep").arg("1000").spawn().unwrap();
        let status = wait(&mut child, &Stop::default(), Some(Duration::from_millis(50))).unwrap();
        assert!(!status.success());
    }
}
