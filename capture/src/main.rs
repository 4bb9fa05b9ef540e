//! The `lumiscan` executable.

mod child;
mod cli;
mod clock;
mod commands;
mod control;
mod daemon;
mod decode;
mod depth;
mod device;
mod disk;
mod failure;
mod kinect;
mod live;
mod manifest;
mod memory;
mod motion;
mod notify;
#[cfg(feature = "openni")]
mod openni;
mod packet;
mod pair;
mod pipeline;
mod protocol;
mod publish;
mod report;
mod retention;
mod sensor;
mod sim;
mod source;
mod status;
mod stop;
mod streaming;
mod trajectory;
mod transport;
mod usb;

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
