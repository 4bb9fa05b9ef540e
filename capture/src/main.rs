//! The `lumiscan` executable.

mod child;
mod cli;
mod commands;
mod device;
mod failure;
mod manifest;
mod memory;
mod pair;
mod pipeline;
mod report;
mod source;
mod stop;
mod trajectory;

use clap::Parser;
use failure::Failure;
use report::Reporter;
use std::process::ExitCode;

fn main() -> ExitCode {
    let cli = cli::Cli::parse();
    let reporter = Reporter::start(cli.verbose, cli.json);
    let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| commands::run(&cli, &reporter)))
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
