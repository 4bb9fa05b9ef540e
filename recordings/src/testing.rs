//! What the unit tests share.

use crate::decode::encode_depth_png;
use crate::types::{ColorEncoding, ColorFrame};
use std::path::PathBuf;

/// A 32x24 JPEG: (8x, 10y, 128 + 40 sin(x/3)), quality 90.
pub(crate) const GRADIENT_JPEG: &[u8] = include_bytes!("../data/samples/gradient.jpg");

/// The folder of test data that is not part of the repository.
pub(crate) fn shared() -> Option<PathBuf> {
    let dir = std::env::var_os("LUMISCAN_SHARED").map(PathBuf::from);
    if dir.is_none() {
        println!("skipped: LUMISCAN_SHARED is not set (the folder with the test data)");
    }
    dir
}

pub(crate) fn color_frame(ns: i64, width: u32, height: u32, encoding: ColorEncoding, bytes: Vec<u8>) -> ColorFrame {
    ColorFrame { timestamp_ns: ns, width, height, encoding, bytes, missing_packets: 0 }
}

/// A TUM folder of 32x24 frames: colour every 33 ms, depth every 43 ms, depth value 1000 + pixel index.
pub(crate) fn tum_folder(frames: usize) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let (mut rgb, mut depth) = (String::from("# colour\n"), String::from("# depth\n"));
    for sub in ["rgb", "depth"] {
        std::fs::create_dir(dir.path().join(sub)).unwrap();
    }
    for i in 0..frames {
        rgb += &format!("0.{:06} rgb/{i}.jpg\n", i * 33_000);
        depth += &format!("0.{:06} depth/{i}.png\n", i * 43_000);
        std::fs::write(dir.path().join(format!("rgb/{i}.jpg")), GRADIENT_JPEG).unwrap();
        let values: Vec<u16> = (0..32 * 24).map(|p| 1000 + p + i as u16).collect();
        let png = encode_depth_png(32, 24, &values).unwrap();
        std::fs::write(dir.path().join(format!("depth/{i}.png")), png).unwrap();
    }
    std::fs::write(dir.path().join("rgb.txt"), rgb).unwrap();
    std::fs::write(dir.path().join("depth.txt"), depth).unwrap();
    let camera = "# a small camera\n30 30 15.5 11.5 5000 32 24\n# k1 k2 p1 p2 k3 = 0.1 -0.01 0.001 0.002 0.003\n";
    std::fs::write(dir.path().join("camera.txt"), camera).unwrap();
    dir
}
