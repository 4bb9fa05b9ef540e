//! A small HTTP client, and the web page under test.

use super::usage::Usage;
use super::{EXECUTABLE, arg};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Upper bound of every wait.
const PATIENCE: Duration = Duration::from_secs(240);

/// An answer.
#[derive(Debug)]
pub struct Reply {
    pub status: u16,
    pub headers: BTreeMap<String, String>,
    pub body: Vec<u8>,
}

impl Reply {
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.body).unwrap_or_default()
    }

    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }
}

/// An executable that serves the page; killed at the end if it still runs.
pub struct Served {
    child: Child,
    /// `HOST:PORT`.
    pub host: String,
    /// The pairing code.
    pub code: String,
    /// Headers of every request: the token or the cookie.
    pub access: String,
    pub stderr: Arc<Mutex<String>>,
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Served {
    /// Starts the executable and waits for the line with its address. The token of programs is in `folder`.
    pub fn start(folder: &Path, args: &[&str]) -> Self {
        let token = folder.join("token");
        let mut child = Command::new(EXECUTABLE)
            .args(args)
            .args(["--set", &format!("serve.token_file={}", arg(&token))])
            .env_remove("LUMISCAN_DEVICE")
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the executable starts");
        let stderr: Arc<Mutex<String>> = Arc::default();
        let (log, lines) = (Arc::clone(&stderr), BufReader::new(child.stderr.take().expect("stderr")));
        std::thread::spawn(move || {
            for line in lines.lines().map_while(Result::ok) {
                log.lock().expect("no panic").push_str(&format!("{line}\n"));
            }
        });
        let began = Instant::now();
        let address = loop {
            let text = stderr.lock().expect("no panic").clone();
            if let Some((_, address)) = text.lines().find_map(|l| l.strip_prefix("serving ")?.split_once("://")) {
                break address.to_owned();
            }
            assert!(began.elapsed() < PATIENCE, "no address: {text}");
            std::thread::sleep(Duration::from_millis(20));
        };
        let (host, code) = address.split_once("/?code=").expect("an address with a code");
        let token = std::fs::read_to_string(token).expect("the token was made");
        let access = format!("Authorization: Bearer {}\r\n", token.trim());
        Self { child, host: host.into(), code: code.into(), access, stderr }
    }

    pub fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(&self.host).expect("the page listens");
        stream.set_read_timeout(Some(Duration::from_secs(30))).expect("a socket");
        stream
    }

    /// Sends a request as it stands, and reads the answer until the connection ends.
    pub fn raw(&self, request: &[u8]) -> Reply {
        let mut stream = self.connect();
        let _ = stream.write_all(request);
        let mut bytes = Vec::new();
        let _ = stream.read_to_end(&mut bytes);
        let at = bytes.windows(4).position(|w| w == b"\r\n\r\n").unwrap_or(bytes.len());
        let head = String::from_utf8_lossy(&bytes[..at]).into_owned();
        let mut lines = head.lines();
        let status = lines.next().and_then(|l| l.split(' ').nth(1)?.parse().ok()).unwrap_or(0);
        let headers = lines.filter_map(|l| l.split_once(": ")).map(|(k, v)| (k.to_ascii_lowercase(), v.to_owned()));
        Reply { status, headers: headers.collect(), body: bytes.split_off((at + 4).min(bytes.len())) }
    }

    /// A request with further headers (each ended by CR LF) and a body.
    pub fn ask(&self, method: &str, path: &str, headers: &str, body: &str) -> Reply {
        let (host, length) = (&self.host, body.len());
        let text = format!(
            "{method} {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\nContent-Length: {length}\r\n{headers}\r\n{body}"
        );
        self.raw(text.as_bytes())
    }

    /// Takes a kilobyte a second of an answer without end, until it is told to stop.
    pub fn read_slowly(&self, path: &str, over: &AtomicBool) {
        let mut stream = self.connect();
        let request = format!("GET {path} HTTP/1.1\r\nHost: {}\r\n{}\r\n", self.host, self.access);
        stream.write_all(request.as_bytes()).expect("a request is taken");
        while !over.load(Ordering::Relaxed) && stream.read(&mut [0; 100]).is_ok_and(|n| n > 0) {
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    pub fn get(&self, path: &str) -> Reply {
        self.ask("GET", path, &self.access, "")
    }

    pub fn post(&self, path: &str, body: &str) -> Reply {
        self.ask("POST", path, &self.access, body)
    }

    /// Waits until the status is as wanted.
    pub fn wait(&mut self, what: &str, wanted: impl Fn(&serde_json::Value) -> bool) -> serde_json::Value {
        let began = Instant::now();
        loop {
            let status = self.get("/api/status").json();
            if wanted(&status) {
                return status;
            }
            let ended = self.child.try_wait().expect("a child");
            assert!(ended.is_none() && began.elapsed() < PATIENCE, "{what}: {ended:?} {status}\n{}", self.log());
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    pub fn log(&self) -> String {
        self.stderr.lock().expect("no panic").clone()
    }

    /// Resident memory in bytes.
    pub fn memory(&self) -> u64 {
        Usage::of(self.child.id()).map_or(0, |u| u.resident_kib * 1024)
    }

    /// Sends a signal.
    pub fn signal(&self, name: &str) {
        let sent = Command::new("kill").args([name, &self.child.id().to_string()]).status();
        assert!(sent.is_ok_and(|s| s.success()));
    }

    /// Waits for the end; exit code and stdout.
    pub fn ended(mut self) -> (Option<i32>, String) {
        let began = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().expect("a child") {
                let mut out = String::new();
                let _ = self.child.stdout.take().map(|mut s| s.read_to_string(&mut out));
                assert!(!self.log().contains("panicked"), "{}", self.log());
                return (status.code(), out);
            }
            assert!(began.elapsed() < PATIENCE, "it does not end\n{}", self.log());
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}
