//! What requests are answered from.

use crate::live_config::LiveConfig;
use crate::orders::Orders;
use crate::report::Reporter;
use crate::serve::access::Access;
use crate::serve::jobs::Jobs;
use crate::serve::live::hub::Hub;
use crate::serve::render::desk::Desk;
use crate::status::Board;
use firmware_config::Config;
use std::path::PathBuf;
use std::sync::Arc;

/// The parts of the box that the page shows and drives.
pub struct Context {
    /// Who may do what.
    pub access: Access,
    /// `https` with a certificate, `http` without.
    pub scheme: &'static str,
    /// The scan in progress.
    pub hub: Arc<Hub>,
    /// The state of the box.
    pub board: Arc<Board>,
    /// Takes requests.
    pub orders: Orders,
    /// Device folder.
    pub device: PathBuf,
    /// Settings that the program was started with.
    pub config: Config,
    /// Those of the next scan, where they may change.
    pub live_config: Option<Arc<LiveConfig>>,
    /// Progress and log.
    pub reporter: Reporter,
    /// Work on finished scans.
    pub jobs: Jobs,
    /// Files and picture of what is rendered.
    pub desk: Desk,
}

impl Context {
    /// The settings as they are now.
    #[must_use]
    pub fn settings(&self) -> Config {
        self.live_config.as_ref().map_or_else(|| self.config.clone(), |live| live.get())
    }
}
