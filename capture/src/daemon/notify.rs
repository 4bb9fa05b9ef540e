//! sd_notify(3): lines of `KEY=value` as datagrams to the service manager's socket.

use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};

/// Sends to the service manager, if one listens.
pub struct Notifier(Option<(UnixDatagram, SocketAddr)>);

impl Notifier {
    /// As `NOTIFY_SOCKET` says; a leading `@` stands for the abstract name space.
    #[must_use]
    pub fn from_environment() -> Self {
        let socket = std::env::var("NOTIFY_SOCKET").ok().and_then(|name| {
            let address = match name.strip_prefix('@') {
                Some(name) => SocketAddr::from_abstract_name(name),
                None => SocketAddr::from_pathname(&name),
            };
            Some((UnixDatagram::unbound().ok()?, address.ok()?))
        });
        Self(socket)
    }

    /// Sends one line. That nobody listens is no fault.
    pub fn send(&self, line: &str) {
        if let Some((socket, address)) = &self.0 {
            let _ = socket.send_to_addr(line.as_bytes(), address);
        }
    }
}
