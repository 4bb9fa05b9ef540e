//! Work on finished scans, one at a time, beside the scan in progress.

use crate::cli::{Effort, QualityPoint};
use crate::publish;
use crate::report::{Reporter, Step};
use crate::stop::Stop;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A scan that is estimated again.
#[derive(Debug, Clone)]
pub struct Job {
    /// The scan's id.
    pub scan: String,
    /// At this quality.
    pub quality: QualityPoint,
    /// Within this time.
    pub budget_s: f64,
}

/// How far it is.
#[derive(Debug, Clone, Serialize)]
pub struct Progress {
    scan: String,
    quality: &'static str,
    step: Option<Step>,
    /// True when it is over.
    done: bool,
    problem: Option<String>,
}

#[derive(Default)]
struct Current {
    job: Option<(Job, Reporter)>,
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
        let current = self.lock();
        let (job, reporter) = current.job.as_ref()?;
        Some(Progress {
            scan: job.scan.clone(),
            quality: job.quality.name(),
            step: reporter.current(),
            done: current.done,
            problem: current.problem.clone(),
        })
    }

    /// True while a job works on this scan.
    #[must_use]
    pub fn works_on(&self, id: &str) -> bool {
        let current = self.lock();
        !current.done && current.job.as_ref().is_some_and(|(job, _)| job.scan == id)
    }

    /// Starts a job.
    ///
    /// # Errors
    /// Another one runs.
    pub fn start(&self, folder: PathBuf, job: Job) -> Result<(), String> {
        let mut current = self.lock();
        if current.job.is_some() && !current.done {
            return Err("another scan is being estimated; wait until that is done".into());
        }
        let reporter = Reporter::silent();
        let effort =
            Effort { budget: job.budget_s, rounds: None, quality: Some(job.quality), threads: None, memory: None };
        *current = Current { job: Some((job, reporter.clone())), ..Current::default() };
        drop(current);
        let jobs = self.clone();
        let work = move || {
            let outcome = publish::again(&folder, &effort, &jobs.stop, &reporter);
            let mut current = jobs.lock();
            (current.done, current.problem) = (true, outcome.err().map(|e| e.to_string()));
        };
        std::thread::Builder::new().name("job".into()).spawn(work).map(drop).map_err(|e| {
            self.lock().done = true;
            e.to_string()
        })
    }

    fn lock(&self) -> MutexGuard<'_, Current> {
        self.current.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
