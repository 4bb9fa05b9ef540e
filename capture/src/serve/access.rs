//! Who may open the page: pairing codes, browser tokens, the token of programs, and the checks against foreign web sites.

use crate::device_folder::files::replace_unsynced;
use crate::failure::Failure;
use crate::lock::lock;
use crate::serve::guesses::{Guesses, TooMany};
use crate::serve::http::request::{Method, Request};
use std::fs::OpenOptions;
use std::io::Write;
use std::net::{IpAddr, Ipv6Addr};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// The cookie of a paired browser.
const COOKIE: &str = "lumiscan";
/// Letters of a code: none that look alike.
const LETTERS: &[u8; 32] = b"abcdefghijkmnpqrstuvwxyz23456789";
/// Letters of a pairing code: 60 bits.
const CODE_LETTERS: usize = 12;
/// Letters of a token: 160 bits.
const TOKEN_LETTERS: usize = 32;
/// Pairing codes that are valid at a time, and browsers that are remembered; the oldest give way.
const CODES: usize = 8;
const BROWSERS: usize = 32;
/// Names of the box.
const NAMES: usize = 64;

/// How a client may act.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// A paired browser.
    Browser,
    /// A program with the token, or a client on the box itself where those need none.
    Program,
}

/// What became of a pairing code.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Pairing {
    /// It was right: the cookie that pairs the browser.
    Paired(String),
    /// It is wrong, or was used before.
    Wrong,
    /// It was not looked at, since too many guesses wait for their answer.
    TooMany,
}

/// The secrets, and who knows them.
pub struct Access {
    names: Mutex<Vec<String>>,
    pair_loopback: bool,
    program: Option<String>,
    codes: Mutex<Vec<String>>,
    browsers: Mutex<Vec<String>>,
    /// Where browsers are remembered.
    file: Option<PathBuf>,
    guesses: Guesses,
}

impl Access {
    /// Reads the token of programs (made if it is missing) and the paired browsers.
    ///
    /// # Errors
    /// The token cannot be read or written, or is too short; the system has no random numbers.
    pub fn new(
        names: Vec<String>,
        pair_loopback: bool,
        token: Option<&Path>,
        file: Option<PathBuf>,
    ) -> Result<Self, Failure> {
        let program = token.map(token_of).transpose()?;
        let known = file.as_ref().and_then(|f| std::fs::read_to_string(f).ok()).unwrap_or_default();
        let browsers = known.lines().filter(|l| l.len() == TOKEN_LETTERS).take(BROWSERS).map(Into::into).collect();
        Ok(Self {
            names: Mutex::new(names),
            pair_loopback,
            program,
            codes: Mutex::default(),
            browsers: Mutex::new(browsers),
            file,
            guesses: Guesses::default(),
        })
    }

    /// The box is reached under this name, too.
    pub fn add_name(&self, name: &str) {
        let mut names = lock(&self.names);
        names.retain(|n| n != name);
        push(&mut names, name.to_owned(), NAMES);
    }

    /// A new pairing code.
    ///
    /// # Errors
    /// The system has no random numbers.
    pub fn new_code(&self) -> Result<String, Failure> {
        let code = random(CODE_LETTERS)?;
        push(&mut lock(&self.codes), code.clone(), CODES);
        Ok(code)
    }

    /// Uses a pairing code up. A wrong code costs time.
    ///
    /// # Errors
    /// The system has no random numbers.
    pub fn pair(&self, code: &str, peer: IpAddr) -> Result<Pairing, Failure> {
        // Not looked at where too many wait, so that no guess is free.
        let Ok(guess) = self.guesses.begin(peer) else { return Ok(Pairing::TooMany) };
        let found = {
            let mut codes = lock(&self.codes);
            let at = codes.iter().position(|c| is_same(c, code));
            at.map(|i| codes.remove(i))
        };
        if found.is_none() {
            guess.punish();
            return Ok(Pairing::Wrong);
        }
        let token = random(TOKEN_LETTERS)?;
        let mut browsers = lock(&self.browsers);
        push(&mut browsers, token.clone(), BROWSERS);
        if let Some(file) = &self.file {
            // A browser that is not remembered is paired again after a restart.
            if let Err(e) = replace_unsynced(file, browsers.join("\n").as_bytes()).and_then(|()| owner_only(file)) {
                tracing::warn!("{}: {e}; browsers have to be paired again after a restart", file.display());
            }
        }
        Ok(Pairing::Paired(format!("{COOKIE}={token}; Path=/; HttpOnly; SameSite=Lax; Max-Age=31536000")))
    }

    /// How the client of a request may act; `None` if it is a stranger. A wrong token costs time.
    ///
    /// # Errors
    /// A wrong token, and too many guesses wait for their answer.
    pub fn standing(&self, request: &Request, peer: IpAddr) -> Result<Option<Standing>, TooMany> {
        let wrong = || self.guesses.begin(peer).map(|guess| guess.punish());
        if let Some(given) = request.header("authorization") {
            let token = given.strip_prefix("Bearer ").unwrap_or("").trim();
            if self.program.as_ref().is_some_and(|own| is_same(own, token)) {
                return Ok(Some(Standing::Program));
            }
            wrong()?;
            return Ok(None);
        }
        let cookies = request.header("cookie").unwrap_or_default().split(';');
        let given = cookies.filter_map(|c| c.trim().strip_prefix(COOKIE)?.strip_prefix('=')).next();
        if given.is_some_and(|token| lock(&self.browsers).iter().any(|own| is_same(own, token))) {
            return Ok(Some(Standing::Browser));
        }
        if peer.is_loopback() && !self.pair_loopback {
            return Ok(Some(Standing::Program));
        }
        if given.is_some() {
            wrong()?;
        }
        Ok(None)
    }

    /// True if the request names this box: a foreign site whose name was rebound to our address does not.
    #[must_use]
    pub fn is_own_host(&self, request: &Request) -> bool {
        let Some(host) = request.header("host") else { return false };
        let name = match host.strip_prefix('[').and_then(|h| h.split_once(']')) {
            Some((inner, _)) => return inner.parse::<Ipv6Addr>().is_ok(),
            None => host.rsplit_once(':').map_or(host, |(name, _)| name),
        };
        let name = name.trim_end_matches('.').to_ascii_lowercase();
        name.parse::<IpAddr>().is_ok() || name == "localhost" || lock(&self.names).contains(&name)
    }

    /// True if a request may change something: one of a browser must come from a page of ours.
    #[must_use]
    pub fn may_change(request: &Request, standing: Standing) -> bool {
        if matches!(request.method, Method::Get | Method::Head) {
            return true;
        }
        let own = request.header("host").map(str::to_ascii_lowercase);
        match request.header("origin") {
            Some(origin) => {
                let origin = origin.to_ascii_lowercase();
                let from = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
                from.is_some() && from == own.as_deref()
            }
            None => standing == Standing::Program,
        }
    }
}

fn push(list: &mut Vec<String>, new: String, most: usize) {
    list.push(new);
    let surplus = list.len().saturating_sub(most);
    list.drain(..surplus);
}

/// Compares in a time that does not depend on where the texts differ.
fn is_same(a: &str, b: &str) -> bool {
    a.len() == b.len() && a.bytes().zip(b.bytes()).fold(0, |d, (a, b)| d | (a ^ b)) == 0
}

fn random(letters: usize) -> Result<String, Failure> {
    let mut bytes = vec![0; letters];
    getrandom::fill(&mut bytes).map_err(|e| Failure::Internal(format!("the system has no random numbers: {e}")))?;
    Ok(bytes.iter().map(|b| char::from(LETTERS[usize::from(b % 32)])).collect())
}

/// The token in a file; a missing file is made, for its owner alone.
fn token_of(path: &Path) -> Result<String, Failure> {
    let cannot = |e: std::io::Error| {
        Failure::Usage(format!("{}: {e}; set serve.token_file to a file that can be read", path.display()))
    };
    match std::fs::read_to_string(path) {
        Ok(text) if text.trim().len() >= 16 => Ok(text.trim().to_owned()),
        Ok(_) => Err(Failure::Usage(format!(
            "{}: the token has fewer than 16 characters; remove the file, and a random one is made",
            path.display()
        ))),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            let token = random(TOKEN_LETTERS)?;
            let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path).map_err(cannot)?;
            writeln!(file, "{token}").map_err(cannot)?;
            Ok(token)
        }
        Err(e) => Err(cannot(e)),
    }
}

fn owner_only(path: &Path) -> std::io::Result<()> {
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o600))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::serve::guesses::COST;
    use std::time::Instant;

    fn request(text: &str) -> Request {
        Request::parse(format!("{text}\r\n\r\n").as_bytes()).unwrap().unwrap().0
    }

    fn access(file: Option<PathBuf>) -> Access {
        Access::new(vec!["lumiscan-1.local".into()], true, None, file).unwrap()
    }

    const PEER: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);

    #[test]
    fn a_code_pairs_once_and_the_browser_is_remembered() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("browsers");
        let a = access(Some(file.clone()));
        let code = a.new_code().unwrap();
        let Pairing::Paired(cookie) = a.pair(&code, PEER).unwrap() else { panic!("a code that was made") };
        assert!(cookie.contains("HttpOnly") && cookie.contains("SameSite"));
        let token = cookie.split(';').next().unwrap();
        let with = request(&format!("GET / HTTP/1.1\r\nCookie: a=b; {token}"));
        assert_eq!(a.standing(&with, PEER), Ok(Some(Standing::Browser)));
        assert_eq!(access(Some(file)).standing(&with, PEER), Ok(Some(Standing::Browser)), "after a restart");
        let began = Instant::now();
        assert_eq!(a.pair(&code, PEER).unwrap(), Pairing::Wrong, "used up");
        let wrong = request("GET / HTTP/1.1\r\nCookie: lumiscan=wrong");
        assert_eq!(a.standing(&wrong, PEER), Ok(None));
        assert!(began.elapsed() >= 2 * COST, "each guess costs time");
        assert_eq!(a.standing(&request("GET / HTTP/1.1"), PEER), Ok(None));
        let _waiting = a.guesses.begin(PEER).unwrap();
        let right = a.new_code().unwrap();
        assert_eq!(a.pair(&right, PEER).unwrap(), Pairing::TooMany, "not looked at");
        assert_eq!(a.standing(&wrong, PEER), Err(TooMany));
        assert_eq!(a.standing(&with, PEER), Ok(Some(Standing::Browser)), "who is paired is not concerned");
    }

    #[test]
    fn a_missing_token_file_is_made_for_its_owner() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        let a = Access::new(vec![], true, Some(&path), None).unwrap();
        let token = std::fs::read_to_string(&path).unwrap();
        let with = request(&format!("POST / HTTP/1.1\r\nAuthorization: Bearer {}", token.trim()));
        assert_eq!(a.standing(&with, PEER), Ok(Some(Standing::Program)));
        assert!(Access::may_change(&with, Standing::Program));
        std::fs::write(&path, "short").unwrap();
        assert!(Access::new(vec![], true, Some(&path), None).is_err());
    }

    #[test]
    fn hosts_are_addresses_and_own_names() {
        let a = access(None);
        let is_own = |host: &str| a.is_own_host(&request(&format!("GET / HTTP/1.1\r\nHost: {host}")));
        assert!(
            ["10.0.0.2:80", "[::1]:80", "localhost:1", "LumiScan-1.local:80", "lumiscan-1.local."]
                .iter()
                .all(|h| is_own(h))
        );
        assert!(
            !["evil.example", "evil.example:80", "[evil]:80", "lumiscan-1.local.evil.example", ""]
                .iter()
                .any(|h| is_own(h))
        );
        assert!(!a.is_own_host(&request("GET / HTTP/1.1")));
    }

    #[test]
    fn a_change_comes_from_a_page_of_ours() {
        let may = |more: &str| {
            Access::may_change(&request(&format!("POST / HTTP/1.1\r\nHost: a:80{more}")), Standing::Browser)
        };
        assert!(may("\r\nOrigin: http://a:80") && may("\r\nOrigin: https://A:80"));
        assert!(
            !may("")
                && !may("\r\nOrigin: http://b")
                && !may("\r\nOrigin: null")
                && !may("\r\nOrigin: http://a:80.evil")
        );
        assert!(!Access::may_change(&request("POST / HTTP/1.1\r\nHost: a\r\nOrigin: http://b"), Standing::Program));
    }

    #[test]
    fn loopback_needs_no_pairing_only_if_asked() {
        let a = Access::new(vec![], false, None, None).unwrap();
        assert_eq!(a.standing(&request("GET / HTTP/1.1"), PEER), Ok(Some(Standing::Program)));
        assert_eq!(a.standing(&request("GET / HTTP/1.1"), IpAddr::from([10, 0, 0, 9])), Ok(None));
    }
}
