//! rsync as a child process.

use crate::failure::Failure;
use crate::stop::Stop;
use firmware_config::HandoffConfig;
use std::io::Read;
use std::process::{Command, Stdio};
use std::time::Duration;

/// Time between two checks of the child.
const POLL: Duration = Duration::from_millis(50);
/// Exit codes of a transfer in which single files failed.
const SINGLE_FILES: [i32; 2] = [23, 24];

/// Why rsync ended without success.
pub struct Failed {
    /// What it said.
    pub failure: Failure,
    /// The next scan may fare better; otherwise the network or the other machine is gone for all.
    pub is_single: bool,
}

/// rsync with what every transfer needs: files are compared by their contents, clocks decide nothing.
pub fn rsync(config: &HandoffConfig) -> Command {
    let mut command = Command::new("rsync");
    command.args(["--recursive", "--times", "--checksum", "--relative", "--partial-dir=.rsync-partial"]);
    command.args(["--chmod=D0750,F0640", "--exclude=.*"]);
    command.arg(format!("--rsh={}", config.ssh)).arg(format!("--timeout={}", config.timeout_s));
    if config.max_rate_kb > 0 {
        command.arg(format!("--bwlimit={}", config.max_rate_kb));
    }
    command
}

/// Runs it; returns what it printed.
pub fn run(mut command: Command, stop: &Stop) -> Result<String, Failed> {
    let fatal = |text: String| Failed { failure: Failure::Internal(text), is_single: false };
    let spawned = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let mut child = spawned.map_err(|e| fatal(format!("rsync: {e}; install the package rsync")))?;
    let (stdout, stderr) = (child.stdout.take(), child.stderr.take());
    std::thread::scope(|scope| {
        let printed = scope.spawn(|| text_of(stdout));
        let complaint = scope.spawn(|| text_of(stderr));
        let status = loop {
            match child.try_wait() {
                Ok(Some(status)) => break status,
                Ok(None) => {}
                Err(e) => return Err(fatal(format!("waiting for rsync: {e}"))),
            }
            if let Err(failure) = stop.check() {
                let _ = child.kill();
                let _ = child.wait();
                return Err(Failed { failure, is_single: false });
            }
            std::thread::sleep(POLL);
        };
        let (printed, complaint) = (printed.join().unwrap_or_default(), complaint.join().unwrap_or_default());
        if status.success() {
            return Ok(printed);
        }
        let reason = complaint.lines().filter(|l| !l.trim().is_empty()).take(4).collect::<Vec<_>>().join(" · ");
        let is_single = status.code().is_some_and(|code| SINGLE_FILES.contains(&code));
        Err(Failed { failure: Failure::Internal(format!("rsync ({status}): {reason}")), is_single })
    })
}

/// Everything a child writes to a pipe.
fn text_of(pipe: Option<impl Read>) -> String {
    let mut bytes = Vec::new();
    if let Some(mut pipe) = pipe {
        let _ = pipe.read_to_end(&mut bytes);
    }
    String::from_utf8_lossy(&bytes).into_owned()
}
