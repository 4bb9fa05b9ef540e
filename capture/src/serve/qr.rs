//! Addresses as QR codes: for a terminal, and for a page.

use qrcode::render::{svg, unicode};
use qrcode::{EcLevel, QrCode};

/// For a terminal: two modules a character. Empty for an address that is too long for a code.
#[must_use]
pub fn terminal(address: &str) -> String {
    // Terminals are dark: what is printed is the light part.
    code(address).map_or(String::new(), |c| {
        c.render::<unicode::Dense1x2>()
            .dark_color(unicode::Dense1x2::Light)
            .light_color(unicode::Dense1x2::Dark)
            .build()
    })
}

/// For a page. Empty for an address that is too long for a code.
#[must_use]
pub fn svg(address: &str) -> String {
    code(address).map_or(String::new(), |c| c.render::<svg::Color<'_>>().min_dimensions(200, 200).build())
}

fn code(address: &str) -> Option<QrCode> {
    QrCode::with_error_correction_level(address, EcLevel::L).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_become_codes() {
        let text = terminal("http://192.168.178.100:8080/?code=abcdefghijkm");
        assert!((15..25).contains(&text.lines().count()) && text.contains('█'), "{text}");
        assert!(svg("http://box/").starts_with("<?xml"));
        assert_eq!(svg(&"x".repeat(9000)), "");
    }
}
