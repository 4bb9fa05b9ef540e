//! The web page of `lumiscan replay --watch`: opened before the scan begins, served until it is published, or until Ctrl-C.

use crate::cli;
use crate::failure::Failure;
use crate::orders::Orders;
use crate::report::Reporter;
use crate::serve::service::{Service, Shown};
use crate::status::{Board, State};
use crate::stop::Stop;
use firmware_config::{Config, ServeConfig};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Time between two looks at what clients do.
const POLL: Duration = Duration::from_millis(50);
/// Time in which clients learn that the scan is published, before the page ends.
const FAREWELL: Duration = Duration::from_millis(600);

/// A replay that can be watched.
pub struct Watched {
    /// Its page.
    pub page: Service,
    /// Its state.
    pub board: Arc<Board>,
    /// Requests of those who watch.
    pub orders: Orders,
}

impl Watched {
    /// Starts the page, if there is to be one, and prints its address.
    ///
    /// # Errors
    /// The address is taken.
    pub fn start(
        args: &cli::Replay,
        config: &Config,
        stop: &Stop,
        reporter: &Reporter,
    ) -> Result<Option<Self>, Failure> {
        let Some(address) = args.watch else { return Ok(None) };
        let (board, orders) = (Arc::new(Board::default()), Orders::default());
        board.set(|s| s.sensor = Some(args.source.display().to_string()));
        board.enter(State::Ready);
        let live_config = None;
        let shown = Shown {
            config,
            live_config,
            device: &args.device,
            board: &board,
            orders: &orders,
            stop,
            reporter,
            browsers: None,
        };
        let page = Service::start(address, shown)?;
        page.announce()?;
        Ok(Some(Self { page, board, orders }))
    }

    /// Waits until someone watches or starts the scan, so that its beginning is seen.
    ///
    /// # Errors
    /// A signal came.
    pub fn wait_for_page(&self, config: &ServeConfig, stop: &Stop) -> Result<(), Failure> {
        let began = Instant::now();
        while !self.page.hub().is_watched()
            && !self.orders.take_start()
            && began.elapsed().as_secs_f64() < config.wait_s
        {
            stop.check()?;
            std::thread::sleep(POLL);
        }
        Ok(())
    }

    /// Tells clients that the scan is over, and goes on serving until a signal comes if that is wanted.
    pub fn end(&self, keep: bool, folder: Option<&Path>, stop: &Stop) {
        self.board.set(|s| {
            s.finished_scans += u64::from(folder.is_some());
            s.last_scan = folder.map(|f| f.display().to_string());
        });
        self.board.enter(State::Done);
        if !keep {
            if self.page.hub().is_watched() {
                std::thread::sleep(FAREWELL);
            }
            return;
        }
        tracing::info!("the page is served until Ctrl-C");
        while stop.check().is_ok() {
            std::thread::sleep(POLL);
        }
    }
}
