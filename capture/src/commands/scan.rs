//! `lumiscan scan`: orders to the daemon.

use crate::cli::{self, ScanOrder};
use crate::commands::output::print;
use crate::commands::output::print_json;
use crate::daemon::control_socket;
use crate::failure::Failure;

/// Runs the command.
pub fn run(args: &cli::Scan, as_json: bool) -> Result<(), Failure> {
    let path = control_socket::socket_path(args.socket.as_ref(), &args.device);
    let word = match args.order {
        ScanOrder::Start => "start",
        ScanOrder::Stop => "stop",
        ScanOrder::Status => "status",
    };
    let answer = control_socket::ask(&path, word)?;
    if answer["ok"] != true {
        return Err(Failure::Input(answer["problem"].as_str().unwrap_or("the daemon said nothing of use").into()));
    }
    match args.order {
        ScanOrder::Status => print_json(&answer["status"]),
        _ if as_json => print_json(&answer),
        _ => print("ok"),
    }
}
