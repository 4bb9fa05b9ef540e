//! Work on finished scans, one at a time, beside the scan in progress.

use crate::child_process::{IDLE, relay, wait};
use crate::cli::{Effort, QualityPoint};
use crate::failure::Failure;
use crate::lock::lock;
use crate::publish;
use crate::report::{Reporter, Step};
use crate::stop::Stop;
use serde::Serialize;
use std::ffi::OsString;
use std::io::BufReader;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// A picture that takes longer is given up.
const RENDER_LIMIT: Duration = Duration::from_secs(600);

/// What is done.
#[derive(Debug, Clone)]
pub enum Work {
    /// The scan in this folder is estimated again, at this quality, within so many seconds.
    Estimate(PathBuf, QualityPoint, f64),
    /// A picture is rendered: arguments of `lumiscan render`.
    Render(Vec<OsString>),
}

impl Work {
    fn name(&self) -> &'static str {
        match self {
            Self::Estimate(..) => "estimate",
            Self::Render(..) => "render",
        }
    }

    fn run(&self, stop: &Stop, reporter: &Reporter) -> Result<(), Failure> {
        match self {
            Self::Estimate(folder, quality, budget) => {
                let effort =
                    Effort { budget: *budget, rounds: None, quality: Some(*quality), threads: None, memory: None };
                publish::again(folder, &effort, stop, reporter)
            }
            Self::Render(arguments) => render(arguments, stop, reporter),
        }
    }
}

/// How far it is.
#[derive(Debug, Clone, Serialize)]
pub struct Progress {
    /// The scan's id.
    scan: String,
    /// `estimate` or `render`.
    work: &'static str,
    quality: Option<&'static str>,
    step: Option<Step>,
    /// True when it is over.
    done: bool,
    problem: Option<String>,
}

#[derive(Default)]
struct Current {
    job: Option<(String, Work, Reporter)>,
    done: bool,
    problem: Option<String>,
}

/// The job that runs, or ran last.
#[derive(Clone, Default)]
pub struct Jobs {
    current: Arc<Mutex<Current>>,
    stop: Stop,
}

impl Jobs {
    /// Jobs that end when `stop` is set.
    #[must_use]
    pub fn new(stop: &Stop) -> Self {
        Self { stop: stop.clone(), ..Self::default() }
    }

    /// How far the last job is.
    #[must_use]
    pub fn now(&self) -> Option<Progress> {
        let current = lock(&self.current);
        let (scan, work, reporter) = current.job.as_ref()?;
        Some(Progress {
            scan: scan.clone(),
            work: work.name(),
            quality: if let Work::Estimate(_, quality, _) = work { Some(quality.name()) } else { None },
            step: reporter.current(),
            done: current.done,
            problem: current.problem.clone(),
        })
    }

    /// True while a job works on this scan.
    #[must_use]
    pub fn works_on(&self, id: &str) -> bool {
        let current = lock(&self.current);
        !current.done && current.job.as_ref().is_some_and(|(scan, ..)| scan == id)
    }

    /// True while a job runs.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        let current = lock(&self.current);
        !current.done && current.job.is_some()
    }

    /// Starts work on the scan of this id.
    ///
    /// # Errors
    /// Another job runs, or `prepare` says why there is none.
    pub fn start(&self, scan: &str, prepare: impl FnOnce() -> Result<Work, String>) -> Result<(), String> {
        let mut current = lock(&self.current);
        if let Some((other, work, _)) = current.job.as_ref().filter(|_| !current.done) {
            return Err(format!("the box is busy with {other} ({}); wait until that is done", work.name()));
        }
        let (work, reporter) = (prepare()?, Reporter::silent());
        *current = Current { job: Some((scan.to_owned(), work.clone(), reporter.clone())), ..Current::default() };
        drop(current);
        let jobs = self.clone();
        let run = move || {
            let outcome = work.run(&jobs.stop, &reporter);
            let mut current = lock(&jobs.current);
            (current.done, current.problem) = (true, outcome.err().map(|e| e.to_string()));
        };
        std::thread::Builder::new().name("job".into()).spawn(run).map(drop).map_err(|e| {
            lock(&self.current).done = true;
            e.to_string()
        })
    }
}

/// Renders a picture in a process of its own, at the lowest priority.
fn render(arguments: &[OsString], stop: &Stop, reporter: &Reporter) -> Result<(), Failure> {
    let cannot = |e: std::io::Error| Failure::Internal(format!("the renderer could not be started: {e}"));
    let mut child = Command::new(std::env::current_exe().map_err(cannot)?)
        .args(["--json", "render"])
        .args(arguments)
        .args(["--parent", &std::process::id().to_string()])
        .env("RUST_BACKTRACE", "0")
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(cannot)?;
    if let Err(e) = rustix::process::setpriority_process(Some(rustix::process::Pid::from_child(&child)), IDLE) {
        tracing::debug!("priority of the renderer: {e}");
    }
    let stderr = child.stderr.take();
    let (waited, last) = std::thread::scope(|scope| {
        let relay = scope.spawn(|| stderr.map(|e| relay(BufReader::new(e), "render", reporter)).unwrap_or_default());
        let waited = wait(&mut child, stop, Some(RENDER_LIMIT));
        (waited, relay.join().unwrap_or_default())
    });
    let waited = waited?;
    let said = last.iter().map(String::as_str).collect::<Vec<_>>().join(" · ");
    match (waited.status.success(), waited.killed_after) {
        (true, _) => Ok(()),
        (false, Some(time)) => Err(Failure::Abandoned(format!(
            "the picture was not ready after {:.0} s and was given up; make it smaller",
            time.as_secs_f64()
        ))),
        (false, None) if said.contains("memory allocation of") => {
            Err(Failure::Memory("the picture needs more than daemon.estimator_limit_mb; make it smaller".into()))
        }
        (false, None) => Err(Failure::Internal(if said.is_empty() { waited.status.to_string() } else { said })),
    }
}
