//! Progress and log output of a command, on stderr.
//!
//! A progress bar on a terminal, plain log lines elsewhere, one JSON object per line with `--json`.

use crate::lock::lock;
use crate::memory;
use indicatif::{ProgressBar, ProgressStyle};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::io::{IsTerminal, Write};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tracing_subscriber::fmt::MakeWriter;

/// Form of the output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    /// A progress bar.
    Bar,
    /// Log lines, a few per stage.
    Plain,
    /// One JSON object per line.
    Json,
    /// Nothing is printed.
    Silent,
}

/// A step of a stage, as `--json` prints it and the estimator's parent reads it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// Name of the stage.
    pub stage: String,
    /// Share done, 0 to 1; absent where unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fraction: Option<f64>,
    /// Figures of the stage ("31.2 fps", "12 keyframes").
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub detail: String,
}

/// Progress of one command. Clones share it.
#[derive(Clone)]
pub struct Reporter {
    form: Form,
    verbose: bool,
    bar: ProgressBar,
    state: Arc<Mutex<State>>,
    log: Log,
}

#[derive(Default)]
struct State {
    step: Option<Step>,
    stage: String,
    stage_started: Option<Instant>,
    /// Seconds of every stage that has ended.
    ended: Vec<(String, f64)>,
    printed: Option<Instant>,
    deadline: Option<Instant>,
}

/// Minimum time between two log lines of the same stage.
const PLAIN_INTERVAL: Duration = Duration::from_secs(5);
/// The same with `--json`.
const JSON_INTERVAL: Duration = Duration::from_millis(200);

impl Reporter {
    /// Starts log output and progress. Respects `NO_COLOR` and `TERM=dumb`.
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
        let log = Log::default();
        let writer = BesideBar { bar: bar.clone(), log: log.clone() };
        let lines = tracing_subscriber::fmt().with_max_level(level).with_writer(writer).with_target(verbose);
        // Fails only where a test has set a subscriber before.
        let _ = match form {
            Form::Json => {
                tracing::subscriber::set_global_default(lines.json().flatten_event(true).without_time().finish())
            }
            _ => tracing::subscriber::set_global_default(lines.with_ansi(color).without_time().finish()),
        };
        Self { form, verbose, bar, state: Arc::default(), log }
    }

    /// Prints nothing; for work beside that of the command.
    #[must_use]
    pub fn silent() -> Self {
        let bar = ProgressBar::hidden();
        Self { form: Form::Silent, verbose: false, bar, state: Arc::default(), log: Log::default() }
    }

    /// The last step.
    #[must_use]
    pub fn current(&self) -> Option<Step> {
        lock(&self.state).step.clone()
    }

    /// The last log lines.
    #[must_use]
    pub fn log(&self) -> Vec<String> {
        lock(&self.log.0).iter().cloned().collect()
    }

    /// True with `--verbose`.
    #[must_use]
    pub fn verbose(&self) -> bool {
        self.verbose
    }

    /// Shows the time left until `deadline` from now on.
    pub fn set_deadline(&self, deadline: Instant) {
        lock(&self.state).deadline = Some(deadline);
    }

    /// Shows a step.
    pub fn step(&self, step: &Step) {
        let mut state = lock(&self.state);
        state.step = Some(step.clone());
        let new = state.stage != step.stage;
        let left = state.deadline.map(|d| d.saturating_duration_since(Instant::now()).as_secs());
        let left = left.map_or(String::new(), |s| format!(" · {s} s left"));
        let due = |interval| new || step.fraction == Some(1.0) || state.printed.is_none_or(|t| t.elapsed() >= interval);
        match self.form {
            Form::Bar => {
                self.bar.set_prefix(step.stage.clone());
                self.bar.set_position((step.fraction.unwrap_or(0.0).clamp(0.0, 1.0) * 1000.0) as u64);
                self.bar.set_message(format!("{}{left}", step.detail));
            }
            Form::Plain if due(PLAIN_INTERVAL) => {
                let percent = step.fraction.map_or(String::new(), |f| format!(" {:.0} %", f * 100.0));
                let detail = if step.detail.is_empty() { String::new() } else { format!(" · {}", step.detail) };
                tracing::info!("{}{percent}{detail}{left}", step.stage);
                state.printed = Some(Instant::now());
            }
            Form::Json if due(JSON_INTERVAL) => {
                let line = serde_json::to_string(step).unwrap_or_default();
                // The parent process is gone, so nobody waits for the result.
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
        let mut state = lock(&self.state);
        state.end_stage();
        state.ended.clone()
    }

    /// Removes the progress bar.
    pub fn clear(&self) {
        self.bar.finish_and_clear();
    }
}

impl State {
    /// Adds the time of the current stage to its total; a stage may run several times.
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

/// The last log lines.
#[derive(Clone, Default)]
struct Log(Arc<Mutex<VecDeque<String>>>);

/// Log lines that are kept, and bytes of the longest of them.
const KEPT_LINES: usize = 300;
const LINE_BYTES: usize = 1000;

impl Log {
    fn add(&self, bytes: &[u8]) {
        let mut lines = lock(&self.0);
        if lines.len() == KEPT_LINES {
            lines.pop_front();
        }
        let text = String::from_utf8_lossy(&bytes[..bytes.len().min(LINE_BYTES)]);
        lines.push_back(text.trim_end().to_owned());
    }
}

/// Writes log lines above the progress bar.
#[derive(Clone)]
struct BesideBar {
    bar: ProgressBar,
    log: Log,
}

impl Write for BesideBar {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.log.add(bytes);
        self.bar.suspend(|| std::io::stderr().write(bytes))
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
