//! What the network sends.

use lumiscan::serve::announcement::asked;
use lumiscan::serve::api::ranges::wanted;
use lumiscan::serve::http::request::Request;
use std::net::Ipv4Addr;

pub fn http(bytes: &[u8]) {
    if let Ok(Some((request, length))) = Request::parse(bytes) {
        assert!(length <= bytes.len());
        assert!(request.path.iter().all(|s| !s.is_empty() && s != ".." && !s.contains('/')));
        let _ = (wanted(request.header("range"), 1000), wanted(request.header("range"), 0));
    }
}

pub fn dns(bytes: &[u8]) {
    let _ = asked(bytes, "lumiscan-a00366a08793039a.local", Ipv4Addr::new(10, 0, 0, 2));
}
