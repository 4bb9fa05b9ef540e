//! Pictures: PNG as screens take them, OpenEXR linear.

use crate::export::file::write_whole;
use exr::prelude::WritableImage as _;
use glam::Vec3;
use std::io::{BufWriter, Error, Result, Write};
use std::path::Path;

/// Writes 8-bit RGB (`3 width height` bytes).
///
/// # Errors
/// The disk is full or gone.
pub fn write_png(path: &Path, width: u32, height: u32, bytes: &[u8]) -> Result<()> {
    write_whole(path, |file| {
        let out = BufWriter::new(file);
        encode(out, width, height, bytes, png::ColorType::Rgb, png::Compression::Fast)
    })
}

/// An 8-bit RGBA PNG in memory.
pub(crate) fn encode_rgba(width: u32, height: u32, bytes: &[u8]) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    encode(&mut out, width, height, bytes, png::ColorType::Rgba, png::Compression::default())?;
    Ok(out)
}

/// An 8-bit RGB PNG in memory.
pub(crate) fn encode_rgb(width: u32, height: u32, bytes: &[u8], compression: png::Compression) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    encode(&mut out, width, height, bytes, png::ColorType::Rgb, compression)?;
    Ok(out)
}

/// An 8-bit RGB JPEG in memory, without subsampling of colour.
pub(crate) fn encode_jpeg(width: u32, height: u32, bytes: &[u8], quality: u8) -> Result<Vec<u8>> {
    let (width, height) = (u16::try_from(width).map_err(Error::other)?, u16::try_from(height).map_err(Error::other)?);
    let mut out = Vec::new();
    let mut encoder = jpeg_encoder::Encoder::new(&mut out, quality);
    encoder.set_sampling_factor(jpeg_encoder::SamplingFactor::F_1_1);
    encoder.encode(bytes, width, height, jpeg_encoder::ColorType::Rgb).map_err(Error::other)?;
    Ok(out)
}

fn encode(
    out: impl Write,
    width: u32,
    height: u32,
    bytes: &[u8],
    color: png::ColorType,
    compression: png::Compression,
) -> Result<()> {
    let mut encoder = png::Encoder::new(out, width, height);
    encoder.set_color(color);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(compression);
    let mut writer = encoder.write_header().map_err(Error::other)?;
    writer.write_image_data(bytes).map_err(Error::other)?;
    writer.finish().map_err(Error::other)
}

/// Writes linear RGB, 32-bit float, ZIP-compressed.
///
/// # Errors
/// The disk is full or gone.
pub fn write_exr(path: &Path, width: usize, height: usize, pixels: &[Vec3]) -> Result<()> {
    use exr::prelude::{Blocks, Compression, Encoding, Image, LineOrder, SpecificChannels};
    let channels = SpecificChannels::rgb(|at: exr::math::Vec2<usize>| {
        let p = pixels.get(at.1 * width + at.0).copied().unwrap_or_default();
        (p.x, p.y, p.z)
    });
    let encoding =
        Encoding { compression: Compression::ZIP16, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
    let layer = exr::prelude::Layer::new((width, height), exr::prelude::LayerAttributes::default(), encoding, channels);
    write_whole(path, |file| {
        Image::from_layer(layer).write().non_parallel().to_buffered(BufWriter::new(file)).map_err(Error::other)
    })
}
