//! `lumiscan scan`: requests to the daemon.

use crate::cli;
use crate::commands::output::print;
use crate::commands::output::print_json;
use crate::daemon::control_socket;
use crate::failure::Failure;
use crate::orders::Request;

/// Runs the command.
pub fn run(args: &cli::Scan, as_json: bool) -> Result<(), Failure> {
    let path = control_socket::socket_path(args.socket.as_ref(), &args.device);
    let reply = control_socket::ask(&path, args.order.word())?;
    if !reply.ok {
        return Err(Failure::Input(reply.problem.unwrap_or_else(|| "the daemon refused without a reason".into())));
    }
    match args.order {
        Request::Status => print_json(&reply.status),
        Request::Pair if !as_json => print(reply.address.as_deref().unwrap_or_default()),
        _ if as_json => print_json(&reply),
        _ => print("ok"),
    }
}
