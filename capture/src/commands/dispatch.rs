//! From the parsed command line to the command that runs.

use crate::cli::{Cli, Command};
use crate::commands::capture;
use crate::commands::{
    check, config, estimate, export, handoff, import, inspect, list, manual, record, render, replay, scan, trade,
};
use crate::failure::Failure;
use crate::report::Reporter;

/// Runs the command.
///
/// # Errors
/// What ended it.
pub fn run(cli: &Cli, reporter: &Reporter) -> Result<(), Failure> {
    match &cli.command {
        Command::Replay(a) => replay::run(a, cli.json, reporter),
        Command::Estimate(a) => estimate::command::run(a, cli.json, reporter),
        Command::Import(a) => import::run(a),
        Command::Export(a) => export::run(a),
        Command::Render(a) => render::command::run(a, reporter),
        Command::Config(a) => config::run(a, cli.json),
        Command::Capture(a) => capture::run(a, reporter),
        Command::Scan(a) => scan::run(a, cli.json),
        Command::Handoff(a) => handoff::run(a, cli.json),
        Command::Check(a) => check::run(a, cli.json),
        Command::List(a) => list::run(a, cli.json),
        Command::Record(a) => record::run(a, cli.json, reporter),
        Command::Inspect(a) => inspect::run(a, cli.json),
        Command::Trade(a) => trade::run(a, reporter),
        Command::Manual(a) => manual::run(a),
    }
}
