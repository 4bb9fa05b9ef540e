//! One connection: requests in, answers out, each within its time.

use crate::serve::http::link::Link;
use crate::serve::http::request::{HEAD_BYTES, Method, Refused, Request};
use crate::serve::http::response::Response;
use rustls::ServerConfig;
use std::io::ErrorKind;
use std::net::{IpAddr, TcpStream};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Longest time from the first byte of a head to its last one, and of a body.
const HEAD_TIME: Duration = Duration::from_secs(5);
/// Longest wait for the next request.
const IDLE_TIME: Duration = Duration::from_secs(15);
/// Longest time in which a client takes no byte.
const STALL_TIME: Duration = Duration::from_secs(60);
/// Most requests of a connection.
const REQUESTS: u32 = 10_000;

/// Most requests of a connection in a second; it waits before the next one is read.
const RATE: u32 = 100;

/// A request with its body and the client's address.
pub struct Asked {
    /// The head.
    pub request: Request,
    /// The body.
    pub body: Vec<u8>,
    /// Where it came from.
    pub peer: IpAddr,
}

/// Serves a connection until it ends. `idle` is told when the connection waits for a request or its body, and when it no longer
/// does.
///
/// # Errors
/// The client is gone, or too slow.
pub fn serve(
    stream: TcpStream,
    peer: IpAddr,
    tls: Option<&Arc<ServerConfig>>,
    answer: impl Fn(Asked) -> Response,
    idle: impl Fn(bool),
) -> std::io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(STALL_TIME))?;
    let mut link = match tls {
        None => Link::clear(stream),
        Some(tls) if Link::begins_tls(&stream, Instant::now() + IDLE_TIME)? => Link::tls(stream, tls)?,
        Some(_) => {
            let mut link = Link::clear(stream);
            Response::error(400, "this page is encrypted: open it with https://").write(&mut link, false, false)?;
            return drain(&mut link);
        }
    };
    let mut received = Vec::new();
    let mut second = (Instant::now(), 0);
    for _ in 0..REQUESTS {
        keep_to_rate(&mut second);
        idle(true);
        let request = match read_head(&mut link, &mut received)? {
            Some(Ok(request)) => request,
            Some(Err(Refused(status))) => {
                Response::error(status, "the request is malformed or too large").write(&mut link, false, false)?;
                return drain(&mut link);
            }
            None => return Ok(()),
        };
        let body = read_body(&mut link, &mut received, request.body_bytes)?;
        idle(false);
        let (keep_alive, head_only) = (request.keep_alive, request.method == Method::Head);
        let response = answer(Asked { request, body, peer });
        if !response.write(&mut link, head_only, keep_alive)? {
            return drain(&mut link);
        }
    }
    Ok(())
}

/// Counts a request; waits for the next second where this one has had its share.
fn keep_to_rate((began, requests): &mut (Instant, u32)) {
    let left = Duration::from_secs(1).saturating_sub(began.elapsed());
    *requests += 1;
    if left.is_zero() || *requests > RATE {
        std::thread::sleep(left);
        (*began, *requests) = (Instant::now(), 1);
    }
}

/// The next request; `None` at the end of the connection. What was received beyond it stays in `received`.
fn read_head(link: &mut Link, received: &mut Vec<u8>) -> std::io::Result<Option<Result<Request, Refused>>> {
    let mut deadline = Instant::now() + if received.is_empty() { IDLE_TIME } else { HEAD_TIME };
    loop {
        match Request::parse(received) {
            Ok(Some((request, n))) => {
                received.drain(..n);
                return Ok(Some(Ok(request)));
            }
            Ok(None) => {}
            Err(refused) => return Ok(Some(Err(refused))),
        }
        let first = received.is_empty();
        if receive(link, received, HEAD_BYTES, deadline)? == 0 {
            return Ok(None);
        }
        if first {
            deadline = Instant::now() + HEAD_TIME;
        }
    }
}

fn read_body(link: &mut Link, received: &mut Vec<u8>, bytes: usize) -> std::io::Result<Vec<u8>> {
    let deadline = Instant::now() + HEAD_TIME;
    while received.len() < bytes {
        if receive(link, received, bytes, deadline)? == 0 {
            return Err(ErrorKind::UnexpectedEof.into());
        }
    }
    Ok(received.drain(..bytes).collect())
}

/// Receives what is there, up to `most` bytes in all, before the deadline.
fn receive(link: &mut Link, received: &mut Vec<u8>, most: usize, deadline: Instant) -> std::io::Result<usize> {
    let mut buffer = [0; 2048];
    let room = most.saturating_sub(received.len()).clamp(1, buffer.len());
    let n = link.read_before(deadline, &mut buffer[..room])?;
    received.extend_from_slice(&buffer[..n]);
    Ok(n)
}

/// Lets the client read the last answer: closing with unread input would take it back.
fn drain(link: &mut Link) -> std::io::Result<()> {
    link.finish()?;
    let deadline = Instant::now() + Duration::from_millis(500);
    let mut rest = Vec::new();
    while receive(link, &mut rest, HEAD_BYTES, deadline)? > 0 && rest.len() < HEAD_BYTES {}
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_connection_has_its_share_of_requests_a_second() {
        let began = Instant::now();
        let mut second = (began, 0);
        (0..RATE).for_each(|_| keep_to_rate(&mut second));
        assert!(began.elapsed() < Duration::from_secs(1));
        (0..RATE + 1).for_each(|_| keep_to_rate(&mut second));
        assert!(began.elapsed() >= Duration::from_secs(2));
    }
}
