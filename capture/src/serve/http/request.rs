//! The head of a request: parsed by `httparse`, then checked. Nothing in it is trusted.

use std::collections::BTreeMap;

/// Bytes of the longest head.
pub const HEAD_BYTES: usize = 8 << 10;
/// Most headers.
const HEADERS: usize = 64;
/// Bytes of the longest body.
pub const BODY_BYTES: usize = 64 << 10;

/// What a request asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Read.
    Get,
    /// Read the headers.
    Head,
    /// Change.
    Post,
    /// Remove.
    Delete,
}

/// A request whose head is well-formed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Request {
    /// What it asks for.
    pub method: Method,
    /// The decoded segments of its path; none of them is empty, `.` or `..`, or contains a slash or a control character.
    pub path: Vec<String>,
    /// The decoded query.
    pub query: BTreeMap<String, String>,
    /// Headers by their lower-case names.
    headers: BTreeMap<String, String>,
    /// Bytes of its body.
    pub body_bytes: usize,
    /// True if the connection stays open afterwards.
    pub keep_alive: bool,
}

/// Why a head is refused: the status of the answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Refused(pub u16);

impl Request {
    /// Parses a head; `None` while it is incomplete. Returns the number of its bytes, too.
    ///
    /// # Errors
    /// It is malformed, too large, or of a kind that is not served.
    pub fn parse(bytes: &[u8]) -> Result<Option<(Self, usize)>, Refused> {
        let mut headers = [httparse::EMPTY_HEADER; HEADERS];
        let mut head = httparse::Request::new(&mut headers);
        let length = match head.parse(bytes) {
            Ok(httparse::Status::Complete(n)) if n <= HEAD_BYTES => n,
            Ok(httparse::Status::Complete(_)) | Err(httparse::Error::TooManyHeaders) => return Err(Refused(431)),
            Ok(httparse::Status::Partial) if bytes.len() >= HEAD_BYTES => return Err(Refused(431)),
            Ok(httparse::Status::Partial) => return Ok(None),
            Err(httparse::Error::Version) => return Err(Refused(505)),
            Err(_) => return Err(Refused(400)),
        };
        let (Some(method), Some(target), Some(version)) = (head.method, head.path, head.version) else {
            return Err(Refused(400));
        };
        let method = match method {
            "GET" => Method::Get,
            "HEAD" => Method::Head,
            "POST" => Method::Post,
            "DELETE" => Method::Delete,
            _ => return Err(Refused(405)),
        };
        let mut headers = BTreeMap::new();
        for header in head.headers.iter() {
            let value = std::str::from_utf8(header.value).map_err(|_| Refused(400))?.trim();
            let name = header.name.to_ascii_lowercase();
            // Two readings of one request are how requests are smuggled.
            let twice = headers.insert(name.clone(), value.to_owned()).is_some();
            if twice
                && matches!(name.as_str(), "host" | "content-length" | "origin" | "authorization" | "cookie" | "range")
            {
                return Err(Refused(400));
            }
        }
        if headers.contains_key("transfer-encoding") {
            return Err(Refused(411));
        }
        let body_bytes = match headers.get("content-length") {
            None => 0,
            Some(digits) if digits.is_empty() || !digits.bytes().all(|b| b.is_ascii_digit()) => {
                return Err(Refused(400));
            }
            Some(digits) => digits.parse().ok().filter(|n| *n <= BODY_BYTES).ok_or(Refused(413))?,
        };
        let (path, query) = split_target(target)?;
        let said = headers.get("connection").map_or(String::new(), |c| c.to_ascii_lowercase());
        let keep_alive = if version == 1 { said != "close" } else { said == "keep-alive" };
        Ok(Some((Self { method, path, query, headers, body_bytes, keep_alive }, length)))
    }

    /// A header by its lower-case name.
    #[must_use]
    pub fn header(&self, name: &str) -> Option<&str> {
        self.headers.get(name).map(String::as_str)
    }

    /// The path's segments as string slices.
    #[must_use]
    pub fn segments(&self) -> Vec<&str> {
        self.path.iter().map(String::as_str).collect()
    }
}

fn split_target(target: &str) -> Result<(Vec<String>, BTreeMap<String, String>), Refused> {
    let (path, query) = target.split_once('?').unwrap_or((target, ""));
    let Some(path) = path.strip_prefix('/') else { return Err(Refused(400)) };
    let mut segments = Vec::new();
    for raw in path.split('/') {
        let segment = decode(raw).ok_or(Refused(400))?;
        if segment == "." || segment == ".." || segment.contains(['/', '\\']) || segment.contains(char::is_control) {
            return Err(Refused(404));
        }
        segments.push(segment);
    }
    // `/` itself, and a slash at the end.
    if segments.last().is_some_and(String::is_empty) {
        segments.pop();
    }
    if segments.iter().any(String::is_empty) {
        return Err(Refused(404));
    }
    let pairs = query.split('&').filter(|p| !p.is_empty()).map(|pair| {
        let (name, value) = pair.split_once('=').unwrap_or((pair, ""));
        Some((decode(name)?, decode(&value.replace('+', " "))?))
    });
    Ok((segments, pairs.collect::<Option<_>>().ok_or(Refused(400))?))
}

/// Percent-decodes once; `None` if that is not UTF-8, or an escape is cut off.
fn decode(text: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.bytes();
    while let Some(b) = rest.next() {
        bytes.push(match b {
            b'%' => {
                let digits = [rest.next()?, rest.next()?].map(|d| char::from(d).to_digit(16));
                (digits[0]? * 16 + digits[1]?) as u8
            }
            b => b,
        });
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parse(text: &str) -> Result<Option<Request>, Refused> {
        Request::parse(text.as_bytes()).map(|r| r.map(|r| r.0))
    }

    fn path_of(target: &str) -> Result<Vec<String>, Refused> {
        parse(&format!("GET {target} HTTP/1.1\r\nHost: x\r\n\r\n")).map(|r| r.unwrap().path)
    }

    #[test]
    fn a_head_is_read_once_it_is_complete() {
        let text = "POST /api/scan/start?a=1%202&b HTTP/1.1\r\nHost: box:8080\r\nContent-Length: 5\r\n\r\nabcde";
        assert_eq!(parse(&text[..40]), Ok(None));
        let (r, n) = Request::parse(text.as_bytes()).unwrap().unwrap();
        assert_eq!(
            (r.method, r.segments(), r.body_bytes, &text[n..]),
            (Method::Post, vec!["api", "scan", "start"], 5, "abcde")
        );
        assert_eq!(
            (r.query["a"].as_str(), r.query["b"].as_str(), r.header("host"), r.keep_alive),
            ("1 2", "", Some("box:8080"), true)
        );
    }

    #[test]
    fn no_path_leads_out() {
        for target in [
            "/a/../b",
            "/%2e%2e/b",
            "/%2E./b",
            "/..",
            "/a%2fb",
            "/a%5cb",
            "/a%00",
            "/a//b",
            "/./a",
            "//etc/passwd",
            "/a%0a",
        ] {
            assert_eq!(path_of(target), Err(Refused(404)), "{target}");
        }
        for target in ["http://x/a", "*", "/%", "/%4", "/%zz", "/%ff"] {
            assert_eq!(path_of(target), Err(Refused(400)), "{target}");
        }
        assert_eq!(path_of("/%252e%252e/").unwrap(), ["%2e%2e"], "decoded once");
        assert_eq!((path_of("/").unwrap(), path_of("/a/").unwrap()), (vec![], vec!["a".to_owned()]));
    }

    #[test]
    fn heads_that_two_parsers_could_read_differently_are_refused() {
        let with = |headers: &str| parse(&format!("GET / HTTP/1.1\r\n{headers}\r\n\r\n")).map(|_| ());
        assert_eq!(with("Host: a\r\nHost: b"), Err(Refused(400)));
        assert_eq!(with("Content-Length: 1\r\nContent-Length: 1"), Err(Refused(400)));
        assert_eq!(with("Content-Length: +1"), Err(Refused(400)));
        assert_eq!(with("Content-Length: 99999999999999999999"), Err(Refused(413)));
        assert_eq!(with("Content-Length: 99999999"), Err(Refused(413)));
        assert_eq!(with("Transfer-Encoding: chunked"), Err(Refused(411)));
        assert_eq!(parse("BREW / HTTP/1.1\r\n\r\n"), Err(Refused(405)));
        assert_eq!(parse("GET / HTTP/2.0\r\n\r\n"), Err(Refused(505)));
        assert_eq!(with(&"x: y\r\n".repeat(65)), Err(Refused(431)));
        assert_eq!(with(&format!("x: {}", "y".repeat(HEAD_BYTES))), Err(Refused(431)));
        assert_eq!(parse(&"G".repeat(HEAD_BYTES)), Err(Refused(431)));
    }

    /// A request with bytes replaced, inserted and removed.
    fn mutated() -> impl Strategy<Value = Vec<u8>> {
        let seeds = [
            "GET /scans/20261121T110534Z-a/scan.lscan HTTP/1.1\r\nHost: 10.0.0.2:8080\r\nRange: bytes=1-2\r\nCookie: lumiscan=abc\r\n\r\n",
            "POST /api/scan/name?x=%41 HTTP/1.1\r\nHost: a\r\nContent-Length: 3\r\nOrigin: http://a\r\n\r\nabc",
            "GET /%2e%2e/%2e%2e/etc/passwd HTTP/1.0\r\nHost: a\r\n\r\n",
        ];
        let edits = prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..3u8), 0..8);
        (prop::sample::select(seeds.to_vec()), edits).prop_map(|(seed, edits)| {
            let mut bytes = seed.as_bytes().to_vec();
            for (at, byte, kind) in edits {
                let at = at.index(bytes.len());
                match kind {
                    0 => bytes[at] = byte,
                    1 => bytes.insert(at, byte),
                    _ => drop(bytes.remove(at)),
                }
            }
            bytes
        })
    }

    fn is_harmless(bytes: &[u8]) {
        if let Ok(Some((r, n))) = Request::parse(bytes) {
            assert!(n <= bytes.len() && r.body_bytes <= BODY_BYTES);
            for segment in &r.path {
                assert!(!segment.is_empty() && segment != "." && segment != "..");
                assert!(!segment.contains(['/', '\\', '\0']));
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 20_000, ..ProptestConfig::default() })]
        #[test]
        fn whatever_comes_is_a_request_or_refused(bytes in mutated()) {
            is_harmless(&bytes);
        }
        #[test]
        fn so_are_any_bytes(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
            is_harmless(&bytes);
        }
    }

    /// `cargo test --release -p capture --bin lumiscan a_million -- --ignored`
    #[test]
    #[ignore = "takes a minute"]
    fn a_million_requests() {
        let mut runner =
            proptest::test_runner::TestRunner::new(ProptestConfig { cases: 1_000_000, ..ProptestConfig::default() });
        runner
            .run(&mutated(), |bytes| {
                is_harmless(&bytes);
                Ok(())
            })
            .unwrap();
    }
}
