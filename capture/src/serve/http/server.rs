//! The listening socket and the threads of its connections.

use crate::failure::Failure;
use crate::serve::http::connection::{self, Asked};
use crate::serve::http::link::Link;
use crate::serve::http::response::Response;
use crate::serve::http::slots::Slots;
use rustls::ServerConfig;
use std::io::ErrorKind;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Stack of a connection's thread.
const STACK: usize = 256 << 10;
/// Niceness of the server's threads: fusion goes first.
const NICE: i32 = 5;
/// Bytes that the system may hold for a client that reads slowly.
const SEND_BUFFER: usize = 64 << 10;

/// Answers requests.
pub type Handler = Arc<dyn Fn(Asked) -> Response + Send + Sync>;

/// A running server; ends when dropped.
pub struct Server {
    address: SocketAddr,
    ended: Arc<AtomicBool>,
    slots: Arc<Slots>,
    acceptor: Option<std::thread::JoinHandle<()>>,
}

impl Server {
    /// Listens, and answers in threads of its own; through TLS if there is a certificate.
    ///
    /// # Errors
    /// The address is taken, or not one of this machine.
    pub fn start(
        address: SocketAddr,
        most: usize,
        tls: Option<Arc<ServerConfig>>,
        handler: Handler,
    ) -> Result<Self, Failure> {
        let cannot = |e: std::io::Error| {
            Failure::Usage(format!("{address}: {e}; choose another address or port for the web page with --serve"))
        };
        let listener = TcpListener::bind(address).map_err(cannot)?;
        let address = listener.local_addr().map_err(cannot)?;
        let (ended, slots) = (Arc::new(AtomicBool::new(false)), Arc::new(Slots::new(most)));
        let acceptor = {
            let (ended, slots) = (Arc::clone(&ended), Arc::clone(&slots));
            let work = move || accept(&listener, &ended, &slots, tls.as_ref(), &handler);
            std::thread::Builder::new().name("serve".into()).stack_size(STACK).spawn(work).map_err(cannot)?
        };
        Ok(Self { address, ended, slots, acceptor: Some(acceptor) })
    }

    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Release);
        self.slots.close();
        // Wakes the acceptor.
        let mut address = self.address;
        if address.ip().is_unspecified() {
            address.set_ip(if address.is_ipv4() { Ipv4Addr::LOCALHOST.into() } else { Ipv6Addr::LOCALHOST.into() });
        }
        let woken = TcpStream::connect_timeout(&address, Duration::from_secs(1));
        if let (Some(acceptor), true) = (self.acceptor.take(), woken.is_ok()) {
            let _ = acceptor.join();
        }
    }
}

fn accept(
    listener: &TcpListener,
    ended: &AtomicBool,
    slots: &Arc<Slots>,
    tls: Option<&Arc<ServerConfig>>,
    handler: &Handler,
) {
    // Fails only where the system does not allow it; the threads that are started from here have the same niceness.
    let _ = rustix::process::setpriority_process(Some(rustix::thread::gettid()), NICE);
    while !ended.load(Ordering::Acquire) {
        match listener.accept() {
            Ok((stream, peer)) if !ended.load(Ordering::Acquire) => admit(stream, peer, slots, tls, handler),
            Ok(_) => {}
            Err(e) => {
                // No file descriptor is left, or the client has gone again.
                tracing::debug!("web page: {e}");
                std::thread::sleep(Duration::from_millis(20));
            }
        }
    }
}

fn admit(stream: TcpStream, peer: SocketAddr, slots: &Arc<Slots>, tls: Option<&Arc<ServerConfig>>, handler: &Handler) {
    let peer = peer.ip().to_canonical();
    let Some(id) = slots.take(&stream, peer) else {
        // There is no time for a handshake.
        if tls.is_none() {
            let _ = stream.set_write_timeout(Some(Duration::from_millis(50)));
            let busy = Response::error(503, "too many connections; try again").with("Retry-After", "1");
            let _ = busy.write(&mut Link::clear(stream), false, false);
        }
        return;
    };
    let _ = rustix::net::sockopt::set_socket_send_buffer_size(&stream, SEND_BUFFER);
    let (threads_slots, handler, tls) = (Arc::clone(slots), Arc::clone(handler), tls.cloned());
    let work = move || {
        let slots = threads_slots;
        // A panic ends this connection alone.
        let served = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            connection::serve(stream, peer, tls.as_ref(), |asked| handler(asked), |idle| slots.set_idle(id, idle))
        }));
        slots.release(id);
        match served {
            Ok(Err(e))
                if !matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::ConnectionReset) =>
            {
                tracing::debug!("web page: {peer}: {e}");
            }
            Ok(_) => {}
            Err(_) => tracing::error!("the web page failed at a request; the scan goes on"),
        }
    };
    if std::thread::Builder::new().name("client".into()).stack_size(STACK).spawn(work).is_err() {
        slots.release(id);
    }
}
