//! A client's connection as bytes, in clear or through TLS. What is read has a deadline.

use rustls::{ServerConfig, ServerConnection, StreamOwned};
use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpStream};
use std::sync::Arc;
use std::time::Instant;

/// The first byte of a TLS connection: a handshake record.
const HANDSHAKE: u8 = 0x16;

/// The socket below; every read from it ends at the deadline, however many reads TLS needs for a record.
pub struct Socket {
    stream: TcpStream,
    deadline: Instant,
}

impl Socket {
    fn set_time(&self) -> std::io::Result<()> {
        let left = self.deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(ErrorKind::TimedOut.into());
        }
        self.stream.set_read_timeout(Some(left))
    }
}

impl Read for Socket {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        self.set_time()?;
        self.stream.read(buffer)
    }
}

impl Write for Socket {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.stream.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// A connection.
pub enum Link {
    /// As it is.
    Clear(Socket),
    /// Encrypted.
    Tls(Box<StreamOwned<ServerConnection, Socket>>),
}

impl Link {
    /// In clear. Nothing is read before [`Link::read_before`] names a deadline.
    #[must_use]
    pub fn clear(stream: TcpStream) -> Self {
        Self::Clear(Socket { stream, deadline: Instant::now() })
    }

    /// Encrypted; the handshake is part of the first read.
    ///
    /// # Errors
    /// The settings do not allow a connection.
    pub fn tls(stream: TcpStream, config: &Arc<ServerConfig>) -> std::io::Result<Self> {
        let tls = ServerConnection::new(Arc::clone(config)).map_err(std::io::Error::other)?;
        Ok(Self::Tls(Box::new(StreamOwned::new(tls, Socket { stream, deadline: Instant::now() }))))
    }

    /// True if a client speaks TLS; waits for its first byte until the deadline.
    ///
    /// # Errors
    /// It is gone, or sends nothing.
    pub fn begins_tls(stream: &TcpStream, deadline: Instant) -> std::io::Result<bool> {
        stream.set_read_timeout(Some(deadline.saturating_duration_since(Instant::now())))?;
        let mut first = [0];
        match stream.peek(&mut first)? {
            0 => Err(ErrorKind::UnexpectedEof.into()),
            _ => Ok(first[0] == HANDSHAKE),
        }
    }

    /// Reads what is there before the deadline.
    ///
    /// # Errors
    /// The client is gone, too slow, or breaks the protocol.
    pub fn read_before(&mut self, deadline: Instant, buffer: &mut [u8]) -> std::io::Result<usize> {
        match self {
            Self::Clear(socket) => {
                socket.deadline = deadline;
                socket.read(buffer)
            }
            Self::Tls(tls) => {
                tls.sock.deadline = deadline;
                tls.read(buffer)
            }
        }
    }

    /// Tells the client that nothing more comes.
    ///
    /// # Errors
    /// It is gone.
    pub fn finish(&mut self) -> std::io::Result<()> {
        match self {
            Self::Clear(socket) => socket.stream.shutdown(Shutdown::Write),
            Self::Tls(tls) => {
                tls.conn.send_close_notify();
                tls.flush()?;
                tls.sock.stream.shutdown(Shutdown::Write)
            }
        }
    }
}

impl Write for Link {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        match self {
            Self::Clear(socket) => socket.write(bytes),
            // Flushed at once, so that an error is that of the bytes which met it.
            Self::Tls(tls) => {
                let n = tls.conn.writer().write(bytes)?;
                tls.flush()?;
                Ok(n)
            }
        }
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}
