//! The `lumiscan` executable. What reads bytes from outside is public, since `fuzz/` compiles this file as a library.

mod child_process;
pub mod cli;
mod commands;
mod daemon;
mod device_folder;
mod estimator_process;
mod failure;
mod handoff;
pub mod kinect;
mod live_config;
mod lock;
mod memory;
mod orders;
mod pages;
mod pipeline;
mod publish;
mod report;
pub mod serve;
pub mod simulator;
mod sources;
mod status;
mod stop;

use crate::failure::Failure;
use crate::report::Reporter;
use clap::Parser;
use std::process::ExitCode;

/// Runs the command line.
pub fn main() -> ExitCode {
    let cli = cli::Cli::parse();
    let reporter = Reporter::start(cli.verbose, cli.json);
    let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| commands::dispatch::run(&cli, &reporter)))
        .unwrap_or_else(|panic| Err(Failure::panic(panic.as_ref())));
    reporter.clear();
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            if cli.json {
                tracing::error!(exit_code = failure.code(), "{failure}");
            } else {
                eprintln!("error: {failure}");
            }
            ExitCode::from(failure.code())
        }
    }
}
