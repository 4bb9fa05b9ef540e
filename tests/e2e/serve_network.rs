//! The web page in a network: through TLS with a certificate of the owner's, and found by its name.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "these are tests")]

mod common;

use common::http::Served;
use common::{arg, fails};
use rustls::pki_types::ServerName;
use rustls::{ClientConfig, ClientConnection, RootCertStore, StreamOwned};
use simple_dns::rdata::RData;
use simple_dns::{CLASS, Name, Packet, QCLASS, QTYPE, Question, TYPE};
use std::io::{Read, Write};
use std::net::{Ipv4Addr, UdpSocket};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Serial number of the simulated Kinect.
const SERIAL: &str = "SIMULATED0000001";

fn daemon(folder: &Path, serve: &str, more: &[&str]) -> Served {
    let device = arg(folder.join("device"));
    let fixed = ["capture", "--device", &device, "--simulate", "pattern", "--serve", serve];
    Served::start(folder, &[&fixed[..], &["--set", "daemon.min_free_mb=1"], more].concat())
}

/// A certificate for this machine in `box.crt` and `box.key`; returns it.
fn certificate(folder: &Path) -> rcgen::CertifiedKey<rcgen::KeyPair> {
    let made = rcgen::generate_simple_self_signed(vec!["localhost".into()]).unwrap();
    std::fs::write(folder.join("box.crt"), made.cert.pem()).unwrap();
    std::fs::write(folder.join("box.key"), made.signing_key.serialize_pem()).unwrap();
    made
}

#[test]
fn with_a_certificate_everything_is_encrypted() {
    let folder = tempfile::tempdir().unwrap();
    let made = certificate(folder.path());
    let settings = ["certificate_file=box.crt", "key_file=box.key"].map(|s| {
        let (key, name) = s.split_once('=').unwrap();
        format!("serve.{key}={}", arg(folder.path().join(name)))
    });
    let s = daemon(folder.path(), "127.0.0.1:0", &["--set", &settings[0], "--set", &settings[1]]);
    assert!(s.log().contains(&format!("serving https://{}/?code=", s.host)), "{}", s.log());

    let mut roots = RootCertStore::empty();
    roots.add(made.cert.der().clone()).unwrap();
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let config = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions().unwrap();
    let config = Arc::new(config.with_root_certificates(roots).with_no_client_auth());
    let get = |path: &str, more: &str| {
        let tls = ClientConnection::new(Arc::clone(&config), ServerName::try_from("localhost").unwrap()).unwrap();
        let mut stream = StreamOwned::new(tls, s.connect());
        let host = &s.host;
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{more}\r\n").unwrap();
        let mut text = Vec::new();
        stream.read_to_end(&mut text).expect("the end is announced, so that nothing can be cut off");
        String::from_utf8_lossy(&text).into_owned()
    };
    // Clients that stall in the handshake keep nobody else waiting.
    let stalled: Vec<_> = (0..20)
        .map(|i| {
            let mut stream = s.connect();
            let _ = stream.write_all(&[0x16, 3, 1, 2, 0, 1][..i % 7]);
            stream
        })
        .collect();
    std::thread::sleep(Duration::from_millis(200));
    let paired = get(&format!("/?code={}", s.code), "");
    assert!(paired.starts_with("HTTP/1.1 303") && paired.contains("; Secure"), "{paired}");
    drop(stalled);
    let cookie = paired.lines().find_map(|l| l.strip_prefix("Set-Cookie: ")?.split(';').next()).unwrap();
    let page = get("/live.js", &format!("Cookie: {cookie}\r\n"));
    let script = include_str!("../../capture/src/serve/page/live.js");
    assert!(page.starts_with("HTTP/1.1 200") && page.ends_with(script), "the whole file comes");
    assert!(get("/api/status", "").starts_with("HTTP/1.1 401"));

    let clear = s.ask("GET", "/api/status", &s.access, "");
    assert!(clear.status == 400 && clear.text().contains("https://") && !clear.text().contains("sensor"));
    s.signal("-TERM");
    assert_eq!(s.ended().0, Some(0));
}

#[test]
fn a_certificate_that_cannot_be_used_is_named() {
    let folder = tempfile::tempdir().unwrap();
    certificate(folder.path());
    let device = arg(folder.path().join("device"));
    let file = |name: &str| arg(folder.path().join(name));
    for (certificate, key, said) in [
        (file("box.crt"), String::new(), "serve.key_file"),
        (file("box.crt"), file("none.key"), "none.key"),
        (file("box.key"), file("box.key"), "holds no certificate"),
    ] {
        let (certificate, key) = (format!("serve.certificate_file={certificate}"), format!("serve.key_file={key}"));
        let fixed = ["capture", "--device", &device, "--simulate", "pattern", "--serve", "127.0.0.1:0"];
        let told = fails(2, &[&fixed[..], &["--set", &certificate, "--set", &key]].concat());
        assert!(told.contains(said), "{told}");
    }
}

/// Asks for the address of a host over the loopback network, as a resolver without multicast does.
fn resolved(host: &str) -> Option<Ipv4Addr> {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    rustix::net::sockopt::set_ip_multicast_if(&socket, &Ipv4Addr::LOCALHOST).unwrap();
    socket.set_read_timeout(Some(Duration::from_millis(300))).unwrap();
    let mut query = Packet::new_query(77);
    let (kind, class) = (QTYPE::TYPE(TYPE::A), QCLASS::CLASS(CLASS::IN));
    query.questions.push(Question::new(Name::new(host).unwrap(), kind, class, false));
    socket.send_to(&query.build_bytes_vec().unwrap(), "224.0.0.251:5353").unwrap();
    let mut buffer = [0; 2000];
    let (n, _) = socket.recv_from(&mut buffer).ok()?;
    let reply = Packet::parse(&buffer[..n]).unwrap();
    assert_eq!(reply.id(), 77);
    reply.answers.iter().find_map(|a| match &a.rdata {
        RData::A(a) => Some(Ipv4Addr::from(a.address)),
        _ => None,
    })
}

#[test]
fn the_page_is_found_by_the_serial_number() {
    let folder = tempfile::tempdir().unwrap();
    let mut s = daemon(folder.path(), "0.0.0.0:0", &["-v"]);
    s.wait("ready", |s| s["state"] == "ready");
    let host = format!("lumiscan-{}.local", SERIAL.to_ascii_lowercase());
    let began = Instant::now();
    let address = loop {
        // Where the socket cannot be opened, the log says so.
        assert!(began.elapsed() < Duration::from_secs(30) && !s.log().contains("not announced"), "{}", s.log());
        if let Some(address) = resolved(&host) {
            break address;
        }
    };
    assert_eq!(address, Ipv4Addr::LOCALHOST, "the address in the network of the one who asks");
    assert_eq!(resolved("lumiscan-other.local"), None);

    // The page answers to that name, and to no other.
    let port = s.host.rsplit_once(':').unwrap().1;
    let status = |name: &str| {
        let head = format!("GET /api/status HTTP/1.1\r\nHost: {name}:{port}\r\nConnection: close\r\n{}\r\n", s.access);
        s.raw(head.as_bytes()).status
    };
    assert_eq!((status(&host), status("lumiscan-other.local")), (200, 421));
    s.signal("-TERM");
    assert_eq!(s.ended().0, Some(0));
    assert_eq!(resolved(&host), None, "the name ends with the page");
}
