//! Data of other programs. Where several files belong together, the input holds them one after the other, with a zero byte
//! between two.

use crate::scratch;
use recordings::import::npy::Array;
use recordings::import::trajectory::read_trajectory;
use recordings::import::transforms::Transforms;
use recordings::import::tum::TumReader;
use recordings::ply::read::{parse_ply, read_ply};

/// Lists and camera of a TUM folder.
pub fn lists(bytes: &[u8]) {
    let mut parts = bytes.splitn(3, |b| *b == 0);
    let mut folder = None;
    for name in ["rgb.txt", "depth.txt", "camera.txt"] {
        let path = scratch::file(name, parts.next().unwrap_or_default());
        folder = path.parent().map(std::path::Path::to_path_buf);
    }
    if let Some(folder) = folder
        && let Ok(mut reader) = TumReader::open(&folder)
    {
        let _ = reader.next_event();
    }
}

pub fn trajectory(bytes: &[u8]) {
    let _ = read_trajectory(&scratch::file("trajectory.txt", bytes));
}

pub fn transforms(bytes: &[u8]) {
    let Ok(transforms) = Transforms::read(&scratch::file("transforms.json", bytes)) else { return };
    for frame in &transforms.frames {
        let _ = (transforms.size(frame), transforms.camera(frame, 640, 480), frame.pose());
    }
}

pub fn npy(bytes: &[u8]) {
    let _ = Array::read(&scratch::file("array.npy", bytes));
}

pub fn ply(bytes: &[u8]) {
    let _ = parse_ply(bytes, &["red", "confidence"]);
    let _ = read_ply(&scratch::file("mesh.ply", bytes));
    let _ = estimator::render::objects::ply::read(bytes);
}
