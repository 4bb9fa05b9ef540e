//! This executable as a child process: its log and progress are passed on, it is ended when it takes too long, and it ends with its
//! parent.

use crate::failure::Failure;
use crate::report::{Reporter, Step};
use crate::stop::Stop;
use serde::Deserialize;
use std::collections::VecDeque;
use std::io::BufRead;
use std::process::{Child, ExitStatus};
use std::time::{Duration, Instant};
use tracing::Level;

/// Time between two checks of the child.
const POLL: Duration = Duration::from_millis(20);
/// Last lines of its stderr that the error message quotes.
const KEPT_LINES: usize = 4;
/// Niceness of what must never take time from the scan.
pub const IDLE: i32 = 19;

/// How a child ended.
pub struct Waited {
    /// Its status.
    pub status: ExitStatus,
    /// It was killed here, after this time.
    pub killed_after: Option<Duration>,
    /// Meanwhile the system killed a process for want of memory.
    pub is_out_of_memory: bool,
}

/// Waits for the child to end; kills it when a signal comes or `limit` has passed.
///
/// # Errors
/// A signal came, or the child cannot be waited for.
pub fn wait(child: &mut Child, stop: &Stop, limit: Option<Duration>) -> Result<Waited, Failure> {
    let began = Instant::now();
    let mut killed_after = None;
    loop {
        match child.try_wait() {
            Ok(Some(status)) => return Ok(Waited { status, killed_after, is_out_of_memory: false }),
            Ok(None) => {}
            Err(e) => return Err(Failure::Internal(format!("waiting for a child process: {e}"))),
        }
        if let Err(stopped) = stop.check() {
            let _ = child.kill();
            let _ = child.wait();
            return Err(stopped);
        }
        if limit.is_some_and(|p| began.elapsed() > p) {
            // It may have ended just now; its status is read in the next turn.
            let _ = child.kill();
            killed_after.get_or_insert(began.elapsed());
        }
        std::thread::sleep(POLL);
    }
}

/// Shows the child's progress as this process's own and forwards its log lines; returns its last warnings and errors.
pub fn relay(lines: impl BufRead, who: &str, reporter: &Reporter) -> VecDeque<String> {
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
            Level::WARN => tracing::warn!("{who}: {message}"),
            Level::INFO => tracing::info!("{who}: {message}"),
            _ => tracing::debug!("{who}: {message}"),
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

/// Makes the system end this process with its parent, so that nobody works for a process that is gone.
///
/// # Errors
/// The parent has ended.
pub fn end_with_parent(parent: Option<u32>) -> Result<(), Failure> {
    let Some(parent) = parent else { return Ok(()) };
    #[cfg(target_os = "linux")]
    {
        let signal = Some(rustix::process::Signal::KILL);
        rustix::process::set_parent_process_death_signal(signal).map_err(|e| Failure::Internal(e.to_string()))?;
    }
    // It may have ended before.
    let is_parent = rustix::process::getppid().is_some_and(|id| id.as_raw_nonzero().get().unsigned_abs() == parent);
    if is_parent { Ok(()) } else { Err(Failure::Internal(format!("the parent process {parent} has ended"))) }
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
        let waited = wait(&mut child, &Stop::default(), Some(Duration::from_millis(50))).unwrap();
        assert!(!waited.status.success() && waited.killed_after.is_some());
    }
}
