//! `lumiscan capture`: starts the daemon with its control socket and status file.

use crate::cli;
use crate::commands::settings::load;
use crate::commands::settings::use_threads;
use crate::daemon::control_socket::Server;
use crate::daemon::notify::Notifier;
use crate::daemon::scan_loop::Daemon;
use crate::daemon::status_file;
use crate::failure::Failure;
use crate::live_config::LiveConfig;
use crate::memory;
use crate::orders::Orders;
use crate::report::Reporter;
use crate::serve::service::{Service, Shown};
use crate::sources::sensor;
use crate::status::Board;
use crate::stop::Stop;
use firmware_config::ServeConfig;
use std::cell::Cell;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Port of the web page where none is given.
const DEFAULT_PORT: u16 = 8080;

/// Runs the command.
pub fn run(args: &cli::Capture, reporter: &Reporter) -> Result<(), Failure> {
    memory::return_large_blocks();
    let config = load(&args.settings)?;
    use_threads(args.threads)?;
    let plan = memory::planned(&config)?;
    let bus = sensor::bus(args.simulate.as_ref())?;
    std::fs::create_dir_all(&args.device).map_err(|e| Failure::writing(&args.device, e))?;
    let socket = args.socket.clone().unwrap_or_else(|| args.device.join("control"));
    let server = Server::listen(&socket)?;
    let stop = Stop::on_signals()?;
    let orders = Orders::default();
    orders.by_signals()?;

    let board = Arc::new(Board::default());
    board.set(|s| (s.auto, s.memory_plan_bytes) = (args.auto, plan));
    orders.set_auto(args.auto);
    let live_config = Arc::new(LiveConfig::new(&config));
    let page = match page_address(args, &config.serve)? {
        None => None,
        Some(address) => {
            let (config, device, browsers) = (&config, &args.device, Some(args.device.join(".browsers")));
            let live_config = Some(&live_config);
            let shown =
                Shown { config, live_config, device, board: &board, orders: &orders, stop: &stop, reporter, browsers };
            let page = Service::start(address, shown)?;
            page.announce()?;
            Some(page)
        }
    };
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| server.serve(&board, &orders, page.as_ref(), &done));
        scope.spawn(|| status_file::publish(&board, &args.device, &stop, &done, &config.daemon.tuning.supervision));
        Notifier::from_environment().send("READY=1");
        let daemon = Daemon {
            args,
            config: &config,
            live_config: &live_config,
            board: &board,
            orders: &orders,
            stop: &stop,
            page: page.as_ref(),
            reporter,
            last_scan_failed: Cell::new(false),
            dates_are_right: Cell::new(false),
        };
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| daemon.run(bus)))
            .unwrap_or_else(|panic| Err(Failure::panic(panic.as_ref())));
        Notifier::from_environment().send("STOPPING=1");
        done.store(true, Ordering::Relaxed);
        outcome
    })
}

/// Where the web page is, if there is one.
fn page_address(args: &cli::Capture, config: &ServeConfig) -> Result<Option<SocketAddr>, Failure> {
    let set = match config.address.as_str() {
        "" => None,
        text => Some(cli::address(text).map_err(|e| Failure::Usage(format!("serve.address: {e}")))?),
    };
    Ok(match args.serve {
        None => set,
        Some(given) => Some(given.or(set).unwrap_or(SocketAddr::from(([0, 0, 0, 0], DEFAULT_PORT)))),
    })
}
