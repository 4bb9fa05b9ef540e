//! What a person, or a program, is told while a command runs: everything here goes to stderr.
//!
//! On a terminal a progress bar; elsewhere plain log lines; with `--json` one JSON object a line.

use crate::memory;
use indicatif::{ProgressBar, ProgressStyle};
use serde::{Deserialize, Serialize};
use std::io::{IsTerminal, Write};
use std::sync::Mutex;
use std::time::{Duration, Instant};
use tracing_subscriber::fmt::MakeWriter;

/// How a stage is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    /// A progress bar.
    Bar,
    /// Log lines, a few a stage.
    Plain,
    /// A JSON object a line.
    Json,
}

/// A step of a stage, as `--json` prints it and the estimator's parent reads it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// Name of the stage.
    pub stage: String,
    /// Share done, 0 to 1; absent where it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fraction: Option<f64>,
    /// Figures worth seeing ("31.2 fps", "12 keyframes").
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub detail: String,
}

/// Shows the progress of one command.
pub struct Reporter {
    form: Form,
    verbose: bool,
    bar: ProgressBar,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    stage: String,
    stage_started: Option<Instant>,
    /// Seconds of every stage that has ended.
    ended: Vec<(String, f64)>,
    printed: Option<Instant>,
    deadline: Option<Instant>,
}

/// Between two lines of the same stage where there is no bar.
const QUIET: Duration = Duration::from_secs(5);
/// The same for programs.
const QUIET_JSON: Duration = Duration::from_millis(200);

impl Reporter {
    /// Starts log output and progress. `NO_COLOR` and `TERM=dumb` are honoured.
    #[must_use]
    pub fn start(verbose: bool, json: bool) -> Self {
        let terminal = std::io::stderr().is_terminal() && std::env::var_os("TERM").is_none_or(|t| t != "dumb");
        let form = if json {
            Form::Json
        } else if terminal {
            Form::Bar
        } else {
            Form::Plain
        };
        let color = terminal && std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty());
        let bar = if form == Form::Bar { ProgressBar::new(1000) } else { ProgressBar::hidden() };
        let template = if color { "{prefix:.cyan} {wide_bar:.green/white} {msg}" } else { "{prefix} {wide_bar} {msg}" };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        let level = if verbose { tracing::Level::DEBUG } else { tracing::Level::INFO };
        let lines =
            tracing_subscriber::fmt().with_max_level(level).with_writer(BesideBar(bar.clone())).with_target(verbose);
        // A second subscriber in one process is a test's business only.
        let _ = match form {
            Form::Json => {
                tracing::subscriber::set_global_default(lines.json().flatten_event(true).without_time().finish())
            }
            _ => tracing::subscriber::set_global_default(lines.with_ansi(color).without_time().finish()),
        };
        Self { form, verbose, bar, state: Mutex::default() }
    }

    /// True if more log lines are wanted.
    #[must_use]
    pub fn verbose(&self) -> bool {
        self.verbose
    }

    /// From now on the time left is shown.
    pub fn set_deadline(&self, deadline: Instant) {
        self.lock().deadline = Some(deadline);
    }

    /// Shows a step.
    pub fn step(&self, step: &Step) {
        let mut state = self.lock();
        let new = state.stage != step.stage;
        let left = state.deadline.map(|d| d.saturating_duration_since(Instant::now()).as_secs());
        let left = left.map_or(String::new(), |s| format!(" · {s} s left"));
        let due = |quiet| new || step.fraction == Some(1.0) || state.printed.is_none_or(|t| t.elapsed() >= quiet);
        match self.form {
            Form::Bar => {
                self.bar.set_prefix(step.stage.clone());
                self.bar.set_position((step.fraction.unwrap_or(0.0).clamp(0.0, 1.0) * 1000.0) as u64);
                self.bar.set_message(format!("{}{left}", step.detail));
            }
            Form::Plain if due(QUIET) => {
                let percent = step.fraction.map_or(String::new(), |f| format!(" {:.0} %", f * 100.0));
                let detail = if step.detail.is_empty() { String::new() } else { format!(" · {}", step.detail) };
                tracing::info!("{}{percent}{detail}{left}", step.stage);
                state.printed = Some(Instant::now());
            }
            Form::Json if due(QUIET_JSON) => {
                let line = serde_json::to_string(step).unwrap_or_default();
                // Whoever started this process is gone: nobody waits for the result any more.
                if writeln!(std::io::stderr(), "{line}").is_err() {
                    std::process::exit(1);
                }
                state.printed = Some(Instant::now());
            }
            _ => {}
        }
        if new {
            state.end_stage();
            state.stage.clone_from(&step.stage);
            state.stage_started = Some(Instant::now());
        }
    }

    /// Seconds of every stage so far, in the order they ran.
    #[must_use]
    pub fn stages(&self) -> Vec<(String, f64)> {
        let mut state = self.lock();
        state.end_stage();
        state.ended.clone()
    }

    /// Takes the bar away.
    pub fn clear(&self) {
        self.bar.finish_and_clear();
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

impl State {
    /// Adds the time of the current stage to what it took before: stages may come back.
    fn end_stage(&mut self) {
        let Some(seconds) = self.stage_started.take().map(|t| t.elapsed().as_secs_f64()) else { return };
        match self.ended.iter_mut().find(|(name, _)| *name == self.stage) {
            Some((_, total)) => *total += seconds,
            None => self.ended.push((self.stage.clone(), seconds)),
        }
    }
}

impl estimator::Progress for Reporter {
    fn stage(&self, name: &'static str, fraction: f64) {
        if fraction == 0.0 {
            tracing::debug!("{name} begins, peak memory {} MiB", memory::peak_bytes().unwrap_or(0) >> 20);
        }
        self.step(&Step { stage: name.to_owned(), fraction: Some(fraction), detail: String::new() });
    }
}

/// Writes log lines above the progress bar.
#[derive(Clone)]
struct BesideBar(ProgressBar);

impl Write for BesideBar {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.suspend(|| std::io::stderr().write(bytes))
    }
    fn flush(&mut self) -> std::io::Result<()> {
        std::io::stderr().flush()
    }
}

impl<'a> MakeWriter<'a> for BesideBar {
    type Writer = Self;
    fn make_writer(&'a self) -> Self {
        self.clone()
    }
}
