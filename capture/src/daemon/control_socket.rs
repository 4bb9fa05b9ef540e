//! The control socket of `lumiscan scan`: the client sends one word ([`Request`]), the daemon answers with one line of JSON
//! ([`Reply`]).

use crate::failure::Failure;
use crate::orders::{Orders, Request};
use crate::serve::service::Service;
use crate::status::Board;
use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::io::{ErrorKind, Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Longest wait for the peer.
const LIMIT: Duration = Duration::from_secs(2);
/// Bytes of the longest request.
const REQUEST_BYTES: usize = 1024;

/// The daemon's answer to a request.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reply {
    /// True if the request was carried out.
    pub ok: bool,
    /// Why it was refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
    /// An address that pairs a browser, if asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub address: Option<String>,
    /// The contents of `status.json`, if asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub status: Option<Value>,
}

impl Reply {
    fn new(outcome: Result<(), String>) -> Self {
        Self { ok: outcome.is_ok(), problem: outcome.err(), address: None, status: None }
    }
}

/// The listening socket; removed from the file system when dropped.
pub struct Server {
    listener: UnixListener,
    path: PathBuf,
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

impl Server {
    /// Listens at `path`, for the user and its group. A socket that nobody listens to any more is replaced.
    ///
    /// # Errors
    /// Another daemon listens there, or the folder cannot be written.
    pub fn listen(path: &Path) -> Result<Self, Failure> {
        let cannot = |e: std::io::Error| {
            Failure::Usage(format!(
                "{}: {e}; choose another place for the control socket with --socket",
                path.display()
            ))
        };
        if UnixStream::connect(path).is_ok() {
            return Err(Failure::Usage(format!("{}: another `lumiscan capture` runs; stop it first", path.display())));
        }
        if let Err(e) = std::fs::remove_file(path)
            && e.kind() != ErrorKind::NotFound
        {
            return Err(cannot(e));
        }
        let listener = UnixListener::bind(path).map_err(cannot)?;
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o660)).map_err(cannot)?;
        listener.set_nonblocking(true).map_err(cannot)?;
        Ok(Self { listener, path: path.into() })
    }

    /// Answers until `done` is set; the body of a thread.
    pub fn serve(&self, board: &Board, orders: &Orders, page: Option<&Service>, done: &AtomicBool) {
        while !done.load(Ordering::Relaxed) {
            match self.listener.accept() {
                Ok((stream, _)) => {
                    if let Err(e) = answer(stream, board, orders, page) {
                        tracing::debug!("control socket: {e}");
                    }
                }
                Err(_) => std::thread::sleep(Duration::from_millis(50)),
            }
        }
    }
}

fn answer(mut stream: UnixStream, board: &Board, orders: &Orders, page: Option<&Service>) -> std::io::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(LIMIT))?;
    stream.set_write_timeout(Some(LIMIT))?;
    let mut request = [0u8; REQUEST_BYTES];
    let mut length = 0;
    while length < request.len() && !request[..length].contains(&b'\n') {
        match stream.read(&mut request[length..])? {
            0 => break,
            n => length += n,
        }
    }
    let reply = reply(String::from_utf8_lossy(&request[..length]).trim(), board, orders, page);
    writeln!(stream, "{}", serde_json::to_string(&reply)?)
}

/// Carries out a request, as far as the state allows it.
fn reply(request: &str, board: &Board, orders: &Orders, page: Option<&Service>) -> Reply {
    let status = board.get();
    match Request::from_str(request, false) {
        Ok(Request::Status) => Reply { status: serde_json::to_value(status).ok(), ..Reply::new(Ok(())) },
        Ok(Request::Start) => Reply::new(orders.start_in(status.state)),
        Ok(Request::Stop) => Reply::new(orders.stop_in(status.state)),
        Ok(Request::Pair) => match page.map(Service::pairing_address) {
            Some(Ok(address)) => Reply { address: Some(address), ..Reply::new(Ok(())) },
            Some(Err(e)) => Reply::new(Err(e.to_string())),
            None => Reply::new(Err("there is no web page; start `lumiscan capture` with --serve".into())),
        },
        Err(_) => Reply::new(Err("unknown request; send start, stop, status or pair".into())),
    }
}

/// Asks the daemon at `path`.
///
/// # Errors
/// No daemon listens there, or it does not answer.
pub fn ask(path: &Path, request: &str) -> Result<Reply, Failure> {
    let failed = |e: std::io::Error| {
        Failure::Input(format!("{}: {e}; is `lumiscan capture` running, and are you in its group?", path.display()))
    };
    let mut stream = UnixStream::connect(path).map_err(failed)?;
    stream.set_read_timeout(Some(2 * LIMIT)).map_err(failed)?;
    writeln!(stream, "{request}").map_err(failed)?;
    let mut text = String::new();
    stream.take(1 << 20).read_to_string(&mut text).map_err(failed)?;
    serde_json::from_str(&text).map_err(|e| failed(e.into()))
}

/// Where the daemon listens: as given, or at the service's place if that runs, or in the device folder.
#[must_use]
pub fn socket_path(given: Option<&PathBuf>, device: &Path) -> PathBuf {
    const OF_THE_SERVICE: &str = "/run/lumiscan/control";
    let service = Path::new(OF_THE_SERVICE);
    match given {
        Some(path) => path.clone(),
        None if service.exists() => service.into(),
        None => device.join("control"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::status::State;

    #[test]
    fn orders_follow_the_state() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("control");
        let (board, orders, done) = (Board::default(), Orders::default(), AtomicBool::new(false));
        let server = Server::listen(&path).unwrap();
        std::thread::scope(|scope| {
            scope.spawn(|| server.serve(&board, &orders, None, &done));
            let ok = |request| ask(&path, request).unwrap().ok;
            assert!(!ok("start") && !orders.take_start());
            board.enter(State::Ready);
            assert!(!ok("stop") && ok("start") && orders.take_start() && !orders.take_start());
            board.begin_scan("x");
            assert!(!ok("start") && ok("stop") && orders.take_stop());
            assert_eq!(ask(&path, "status").unwrap().status.unwrap()["scan"]["name"], "x");
            assert!(!ok("sing") && !ok("yyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyyy"));
            // A silent client does not block the others for long.
            let silent = UnixStream::connect(&path).unwrap();
            silent.shutdown(std::net::Shutdown::Write).unwrap();
            assert!(!ok(""));
            assert!(matches!(Server::listen(&path), Err(Failure::Usage(_))), "one daemon at a place");
            done.store(true, Ordering::Relaxed);
        });
        drop(server);
        assert!(!path.exists() && ask(&path, "status").is_err());
    }
}
