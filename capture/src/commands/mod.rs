//! One file a command.

pub mod capture;
pub mod check;
pub mod config;
pub mod estimate;
pub mod export;
pub mod frames;
pub mod import;
pub mod inspect;
pub mod list;
#[cfg(feature = "openni")]
pub mod openni;
pub mod record;
pub mod render;
pub mod replay;
pub mod scan;
pub mod trade;

use crate::cli::{Cli, Command, Settings};
use crate::failure::Failure;
use crate::report::Reporter;
use firmware_config::{Config, ConfigError};
use std::io::Write;
use std::path::Path;

/// Runs the command.
///
/// # Errors
/// What ended it.
pub fn run(cli: &Cli, reporter: &Reporter) -> Result<(), Failure> {
    match &cli.command {
        Command::Replay(a) => replay::run(a, cli.json, reporter),
        Command::Estimate(a) => estimate::run(a, cli.json, reporter),
        Command::Import(a) => import::run(a),
        Command::Export(a) => export::run(a),
        Command::Render(a) => render::run(a, reporter),
        Command::Config(a) => config::run(a, cli.json),
        Command::Capture(a) => capture::run(a, reporter),
        Command::Scan(a) => scan::run(a, cli.json),
        Command::Check(a) => check::run(a, cli.json),
        Command::List(a) => list::run(a, cli.json),
        Command::Record(a) => record::run(a, cli.json, reporter),
        Command::Inspect(a) => inspect::run(a, cli.json),
        Command::Trade(a) => trade::run(a, reporter),
    }
}

/// Defaults, the file over them, `--set` over that.
fn load(settings: &Settings) -> Result<Config, Failure> {
    let mut config = match &settings.config {
        None => Config::default(),
        Some(path) => {
            let shown = path.display();
            let text = std::fs::read_to_string(path).map_err(|e| {
                Failure::Usage(format!("{shown}: {e}; `lumiscan config > FILE` writes a settings file"))
            })?;
            Config::from_toml(&text).map_err(|e| Failure::Usage(format!("{shown}: {e}")))?
        }
    };
    for assignment in &settings.set {
        config.set(assignment).map_err(|e: ConfigError| Failure::Usage(format!("--set {assignment}: {e}")))?;
    }
    Ok(config)
}

/// Gives rayon its number of threads; without, it takes one a processor.
fn use_threads(threads: Option<u16>) -> Result<(), Failure> {
    let Some(n) = threads else { return Ok(()) };
    rayon::ThreadPoolBuilder::new()
        .num_threads(usize::from(n))
        .build_global()
        .map_err(|e| Failure::Internal(format!("{n} threads could not be started: {e}; try a smaller --threads")))
}

/// Prints a result line.
fn print(text: &str) -> Result<(), Failure> {
    let mut out = std::io::stdout().lock();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        // Whoever read has seen enough (`lumiscan … | head`).
        Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => other.map_err(|e| Failure::Internal(format!("stdout: {e}"))),
    }
}

/// Prints a result as JSON.
fn print_json(value: &impl serde::Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value).map_err(|e| Failure::Internal(e.to_string()))?;
    print(&text)
}

/// The folder a file will be written in must be there before any work is done.
fn check_parent(path: &Path) -> Result<(), Failure> {
    let parent = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !parent.is_dir() {
        let shown = parent.display();
        return Err(Failure::Usage(format!("{}: there is no folder {shown}; make it first", path.display())));
    }
    if path.is_dir() {
        return Err(Failure::Usage(format!("{} is a folder; name a file", path.display())));
    }
    Ok(())
}
