//! Pictures, panoramas and objects.

use estimator::render::lighting::panorama::Panorama;
use estimator::render::objects::gltf::document;
use recordings::codec::image::PictureHeader;
use recordings::types::RgbImage;
use std::io::Cursor;
use std::path::Path;

/// Pixels of the largest picture that is decoded here: the time for more says nothing new.
const MOST_PIXELS: u64 = 1 << 18;

/// True if the bytes do not say that they are a large picture.
fn is_small(bytes: &[u8]) -> bool {
    PictureHeader::read(bytes).is_ok_and(|h| u64::from(h.width) * u64::from(h.height) <= MOST_PIXELS)
}

pub fn image(bytes: &[u8]) {
    if is_small(bytes) {
        let _ = RgbImage::decode(bytes);
    }
}

pub fn panorama(bytes: &[u8]) {
    if PictureHeader::read(bytes).is_err() || is_small(bytes) {
        let _ = Panorama::decode(Cursor::new(bytes));
    }
}

pub fn gltf(bytes: &[u8]) {
    let _ = document::read(bytes, Path::new("/nonexistent"));
}
