//! The web page as a service of `capture` and of a watched `replay`.

use crate::failure::Failure;
use crate::live_config::LiveConfig;
use crate::orders::Orders;
use crate::report::Reporter;
use crate::serve::access::Access;
use crate::serve::announcement::{Announcement, host_name};
use crate::serve::context::Context;
use crate::serve::http::certificate;
use crate::serve::http::server::Server;
use crate::serve::jobs::Jobs;
use crate::serve::light::worker;
use crate::serve::live::hub::Hub;
use crate::serve::render::desk::Desk;
use crate::serve::{qr, routes};
use crate::status::Board;
use crate::stop::Stop;
use firmware_config::Config;
use rustix::net::{AddressFamily, SocketType, connect, getsockname, socket};
use std::io::{IsTerminal, Write};
use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What the page shows and drives.
pub struct Shown<'a> {
    /// Settings.
    pub config: &'a Config,
    /// Settings of the next scan; `None` = they do not change.
    pub live_config: Option<&'a Arc<LiveConfig>>,
    /// Device folder.
    pub device: &'a Path,
    /// State of the box.
    pub board: &'a Arc<Board>,
    /// Takes requests.
    pub orders: &'a Orders,
    /// Signals.
    pub stop: &'a Stop,
    /// Progress and log.
    pub reporter: &'a Reporter,
    /// Where paired browsers are remembered; `None` = not beyond this run.
    pub browsers: Option<PathBuf>,
}

/// A running web page; it ends when dropped.
pub struct Service {
    context: Arc<Context>,
    server: Server,
    announcement: Option<Announcement>,
}

impl Service {
    /// Starts it.
    ///
    /// # Errors
    /// The address is taken, or the token file or the certificate cannot be used.
    pub fn start(address: SocketAddr, shown: Shown<'_>) -> Result<Self, Failure> {
        let serve = &shown.config.serve;
        let mut names: Vec<String> = serve.names.split(',').map(|n| n.trim().to_ascii_lowercase()).collect();
        let host = rustix::system::uname().nodename().to_string_lossy().to_ascii_lowercase();
        names.extend([format!("{host}.local"), host]);
        names.retain(|n| !n.is_empty());
        let tls = certificate::tls(serve)?;
        let token = (!serve.token_file.is_empty()).then(|| Path::new(&serve.token_file));
        let context = Arc::new(Context {
            access: Access::new(names, serve.pair_loopback, token, shown.browsers)?,
            scheme: if tls.is_some() { "https" } else { "http" },
            hub: Arc::new(Hub::new(serve)),
            board: Arc::clone(shown.board),
            orders: shown.orders.clone(),
            device: shown.device.into(),
            config: shown.config.clone(),
            live_config: shown.live_config.cloned(),
            reporter: shown.reporter.clone(),
            jobs: Jobs::new(shown.stop),
            desk: Desk::default(),
        });
        if serve.light {
            worker::start(&context.hub, shown.config, shown.stop);
        }
        let answering = Arc::clone(&context);
        let handler = Arc::new(move |asked| routes::answer(&answering, asked));
        let server = Server::start(address, serve.max_connections as usize, tls, handler)?;
        // The loopback address is no other machine's business.
        let announced = serve.announce && !address.ip().is_loopback();
        let announcement = announced.then(|| Announcement::start(address.ip())).transpose().unwrap_or_else(|e| {
            tracing::warn!("the page is not announced in the network: {e}");
            None
        });
        Ok(Self { context, server, announcement })
    }

    /// What clients see.
    #[must_use]
    pub fn hub(&self) -> &Hub {
        &self.context.hub
    }

    /// True while a job works on the scan of this id.
    #[must_use]
    pub fn works_on(&self, id: &str) -> bool {
        self.context.jobs.works_on(id)
    }

    /// The box is known by the serial number of its sensor from now on.
    pub fn set_serial(&self, serial: &str) {
        let Some(announcement) = &self.announcement else { return };
        let host = host_name(serial);
        self.context.access.add_name(&host);
        announcement.set(&host);
        tracing::info!("the page is at {}://{host}:{}/, too", self.context.scheme, self.server.address().port());
    }

    /// An address that pairs one browser.
    ///
    /// # Errors
    /// The system has no random numbers.
    pub fn pairing_address(&self) -> Result<String, Failure> {
        let (scheme, address) = (self.context.scheme, reachable(self.server.address()));
        Ok(format!("{scheme}://{address}/?code={}", self.context.access.new_code()?))
    }

    /// Prints the address on stderr, as a QR code, too, where that is of use.
    ///
    /// # Errors
    /// The system has no random numbers.
    pub fn announce(&self) -> Result<(), Failure> {
        let address = self.pairing_address()?;
        let mut stderr = std::io::stderr();
        let _ = writeln!(stderr, "serving {address}");
        // A phone cannot reach the loopback address.
        if !self.server.address().ip().is_loopback()
            && (stderr.is_terminal() || std::env::var_os("JOURNAL_STREAM").is_some())
        {
            let _ = writeln!(stderr, "{}", qr::terminal(&address));
        }
        Ok(())
    }
}

/// The address under which others reach a socket: where it listens on all of them, the one that leads to other networks.
fn reachable(mut address: SocketAddr) -> SocketAddr {
    if address.ip().is_unspecified() {
        address.set_ip(own_address().unwrap_or(IpAddr::from([127, 0, 0, 1])));
    }
    address
}

/// The address of this machine on the way to other networks. Connecting a datagram socket sends nothing, it only finds the
/// way; 192.0.2.1 is reserved for documentation.
fn own_address() -> Option<IpAddr> {
    let probe = socket(AddressFamily::INET, SocketType::DGRAM, None).ok()?;
    connect(&probe, &SocketAddr::from(([192, 0, 2, 1], 9))).ok()?;
    let own: SocketAddr = getsockname(&probe).ok()?.try_into().ok()?;
    Some(own.ip())
}
