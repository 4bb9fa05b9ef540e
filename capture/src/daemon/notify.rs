//! sd_notify(3): `KEY=value` lines as datagrams to the service manager's socket.

use std::os::linux::net::SocketAddrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};

/// Connection to the service manager, if there is one.
pub struct Notifier(Option<(UnixDatagram, SocketAddr)>);

impl Notifier {
    /// From `NOTIFY_SOCKET`; a leading `@` means the abstract name space.
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

    /// Sends one line; without a service manager it does nothing.
    pub fn send(&self, line: &str) {
        if let Some((socket, address)) = &self.0 {
            let _ = socket.send_to_addr(line.as_bytes(), address);
        }
    }
}
