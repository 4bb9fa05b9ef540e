//! Answers to requests, and how they are written.

use crate::serve::http::link::Link;
use std::io::{Read, Write};
use std::sync::Arc;

/// What may run and load in a page of ours: its own files, nothing inline, nothing from elsewhere.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; \
                      frame-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'self'";
/// Bytes of a file that are read at once.
const CHUNK: usize = 64 << 10;

/// Writes a stream of unknown length; returns when the client is gone or the server ends.
pub type Streamer = Box<dyn FnOnce(&mut Link) -> std::io::Result<()> + Send>;

/// What follows the head.
pub enum Body {
    /// Bytes in memory.
    Bytes(Vec<u8>),
    /// Bytes in memory that several clients get.
    Shared(Arc<[u8]>),
    /// So many bytes of a reader.
    Reader(Box<dyn Read + Send>, u64),
    /// A stream without end.
    Stream(Streamer),
}

/// An answer.
pub struct Response {
    /// Its status.
    pub status: u16,
    headers: Vec<(&'static str, String)>,
    body: Body,
}

impl Response {
    /// An answer with a body of this type.
    #[must_use]
    pub fn new(status: u16, content_type: &str, body: Body) -> Self {
        Self { status, headers: vec![("Content-Type", content_type.to_owned())], body }
    }

    /// A text or page.
    #[must_use]
    pub fn text(status: u16, content_type: &str, text: impl Into<String>) -> Self {
        Self::new(status, content_type, Body::Bytes(text.into().into_bytes()))
    }

    /// A value as JSON.
    #[must_use]
    pub fn json(value: &impl serde::Serialize) -> Self {
        match serde_json::to_vec(value) {
            Ok(bytes) => Self::new(200, "application/json", Body::Bytes(bytes)),
            Err(e) => Self::error(500, &e.to_string()),
        }
    }

    /// An error that a program can read.
    #[must_use]
    pub fn error(status: u16, problem: &str) -> Self {
        Self::text(status, "application/json", serde_json::json!({ "error": problem }).to_string())
    }

    /// Nothing to tell.
    #[must_use]
    pub fn empty() -> Self {
        Self { status: 204, headers: Vec::new(), body: Body::Bytes(Vec::new()) }
    }

    /// Another address to go to.
    #[must_use]
    pub fn redirect(to: &str) -> Self {
        Self::text(303, "text/plain", "").with("Location", to)
    }

    /// With a header, in place of an earlier one of the same name. Values of several lines are left out.
    #[must_use]
    pub fn with(mut self, name: &'static str, value: impl Into<String>) -> Self {
        let value = value.into();
        self.headers.retain(|(n, _)| *n != name);
        if !value.contains(|c: char| c.is_control()) {
            self.headers.push((name, value));
        }
        self
    }

    /// Bytes of the body, if that is known.
    fn length(&self) -> Option<u64> {
        match &self.body {
            Body::Bytes(b) => Some(b.len() as u64),
            Body::Shared(b) => Some(b.len() as u64),
            Body::Reader(_, n) => Some(*n),
            Body::Stream(_) => None,
        }
    }

    /// Writes the answer; true if another request may follow.
    ///
    /// # Errors
    /// The client is gone, or does not read.
    pub fn write(self, link: &mut Link, head_only: bool, keep_alive: bool) -> std::io::Result<bool> {
        let length = self.length();
        let keep_alive = keep_alive && length.is_some();
        let mut head = format!("HTTP/1.1 {} {}\r\n", self.status, reason(self.status));
        let own = |name: &str| self.headers.iter().any(|(n, _)| *n == name);
        let usual = [
            ("Content-Security-Policy", POLICY),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
            ("Cross-Origin-Resource-Policy", "same-origin"),
            ("Cache-Control", "no-store"),
        ];
        for (name, value) in usual.into_iter().filter(|(name, _)| !own(name)) {
            head += &format!("{name}: {value}\r\n");
        }
        for (name, value) in &self.headers {
            head += &format!("{name}: {value}\r\n");
        }
        if let Some(length) = length.filter(|_| self.status != 204) {
            head += &format!("Content-Length: {length}\r\n");
        }
        head += if keep_alive { "Connection: keep-alive\r\n\r\n" } else { "Connection: close\r\n\r\n" };
        match self.body {
            _ if head_only => link.write_all(head.as_bytes())?,
            // In one write, so that a small answer is one packet.
            Body::Bytes(bytes) => link.write_all(&[head.as_bytes(), &bytes].concat())?,
            Body::Shared(bytes) => link.write_all(&[head.as_bytes(), &bytes].concat())?,
            Body::Reader(reader, n) => {
                link.write_all(head.as_bytes())?;
                copy(reader, n, link)?;
            }
            Body::Stream(streamer) => {
                link.write_all(head.as_bytes())?;
                streamer(link)?;
            }
        }
        Ok(keep_alive)
    }
}

/// Copies exactly `n` bytes; an input that is shorter breaks the connection, since its length was announced.
fn copy(mut reader: Box<dyn Read + Send>, n: u64, link: &mut Link) -> std::io::Result<()> {
    let mut buffer = vec![0; CHUNK.min(n as usize).max(1)];
    let mut left = n;
    while left > 0 {
        let want = left.min(buffer.len() as u64) as usize;
        let got = reader.read(&mut buffer[..want])?;
        if got == 0 {
            return Err(std::io::ErrorKind::UnexpectedEof.into());
        }
        link.write_all(&buffer[..got])?;
        left -= got as u64;
    }
    Ok(())
}

fn reason(status: u16) -> &'static str {
    match status {
        200 => "OK",
        204 => "No Content",
        206 => "Partial Content",
        303 => "See Other",
        400 => "Bad Request",
        401 => "Unauthorized",
        403 => "Forbidden",
        404 => "Not Found",
        405 => "Method Not Allowed",
        408 => "Request Timeout",
        409 => "Conflict",
        411 => "Length Required",
        413 => "Content Too Large",
        416 => "Range Not Satisfiable",
        421 => "Misdirected Request",
        429 => "Too Many Requests",
        431 => "Request Header Fields Too Large",
        503 => "Service Unavailable",
        505 => "HTTP Version Not Supported",
        _ => "Internal Server Error",
    }
}
