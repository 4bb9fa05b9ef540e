//! Settings of the web page that shows a scan while it is made.

use crate::settings::section;

/// Where the appliance serves its page: in every network that it is in.
pub const APPLIANCE_ADDRESS: &str = "0.0.0.0:8080";

section! {
    /// The web page: where it is, who may open it, what it may cost. A scan does not depend on any of these.
    ServeConfig = "serve" {
        /// Address and port of the web page, 0.0.0.0:8080 for every network that the box is in; empty = no page. Port 0 = any free one. `--serve` wins over it.
        address: String = String::new(), [64], "", "";
        /// Browsers on the box itself need a pairing code, too.
        pair_loopback: bool = true, [()], "", "";
        /// File with the token of programs (`Authorization: Bearer …`), made with a random token if it is missing; empty = programs have no token.
        token_file: String = String::new(), [4096], "", "";
        /// Certificate of the web page (PEM; the chain, the box's own first): with it, everything goes through TLS; empty = in clear.
        certificate_file: String = String::new(), [4096], "", "";
        /// Private key of that certificate (PEM, without a password).
        key_file: String = String::new(), [4096], "", "";
        /// In every network that the box serves, its page is announced by mDNS as `lumiscan-<serial of the Kinect>.local`.
        announce: bool = true, [()], "", "";
        /// Further host names of the box, separated by commas. Requests under names that are neither these nor the box's own are refused.
        names: String = String::new(), [1024], "", "";
        /// Largest number of connections; a tenth of a second without a request makes one give way to a new one when all are taken.
        max_connections: u32 = 48, [4..=1024], "", "";
        /// Live pictures per second.
        picture_hz: u32 = 8, [1..=30], "1/s", "";
        /// Largest width of a live picture.
        picture_width: u32 = 320, [80..=1280], "px", "";
        /// JPEG quality of a live picture.
        picture_quality: u32 = 70, [10..=95], "", "";
        /// Blocks of the surface that are read per frame while someone watches.
        surface_blocks: u32 = 128, [8..=4096], "blocks", "";
        /// Weight from which surface counts as seen well, in frames from 1 m.
        good_weight: f64 = 12.0, [1.0..=1000.0], "frames", "";
        /// While someone watches a scan, the light found so far is estimated every few seconds, in a process of the lowest priority.
        light: bool = true, [()], "", "";
        /// Time between two estimates of the light so far; in the first seconds of a scan they come sooner.
        light_interval_s: f64 = 3.0, [0.5..=600.0], "s", "";
        /// Largest number of vertices of such an estimate.
        light_vertices: u32 = 6000, [200..=20000], "vertices", "";
        /// Largest number of pictures of such an estimate.
        light_pictures: u32 = 16, [2..=32], "pictures", "";
        /// Time that a replay with --watch waits for the first page to open.
        wait_s: f64 = 60.0, [0.0..=3600.0], "s", "";
    }
}
