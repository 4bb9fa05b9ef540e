//! Pictures: their headers, checks for truncation, and their pixels.

use crate::camera::MAX_SIDE;
use crate::types::{ColorEncoding, ColorFrame, RgbImage};
use zune_core::bytestream::ZCursor;
use zune_core::colorspace::ColorSpace;
use zune_core::options::DecoderOptions;

/// Pixels of the largest picture that is decoded.
const MAX_PIXELS: u64 = 1 << 26;
/// Working memory of the PNG decoder in bytes.
const PNG_LIMIT: usize = 1 << 28;
const PNG_SIGNATURE: &[u8; 8] = b"\x89PNG\r\n\x1a\n";

impl ColorFrame {
    /// Decodes to RGB (Bayer is demosaiced bilinearly with mirrored borders; grey pictures become grey RGB).
    ///
    /// # Errors
    /// A description of what is wrong with the bytes (truncated, wrong size, not a picture).
    pub fn decode(&self) -> Result<RgbImage, String> {
        let (width, height) = (self.width, self.height);
        let pixels = checked_pixels(width, height)?;
        let raw_of = |channels: usize| {
            if self.bytes.len() == channels * pixels {
                Ok(())
            } else {
                Err(format!("{} bytes, but {width}x{height} needs {}", self.bytes.len(), channels * pixels))
            }
        };
        let data = match self.encoding {
            ColorEncoding::Rgb => {
                raw_of(3)?;
                self.bytes.clone()
            }
            ColorEncoding::BayerGrbg => {
                raw_of(1)?;
                if width < 2 || height < 2 {
                    return Err(format!("{width}x{height} is too small for a Bayer mosaic"));
                }
                demosaic(&self.bytes, width as usize, height as usize)
            }
            ColorEncoding::Jpeg | ColorEncoding::Png => {
                let header = PictureHeader::read(&self.bytes)?;
                if header.encoding != self.encoding {
                    return Err(format!("said to be {:?}, but is {:?}", self.encoding, header.encoding));
                }
                if (header.width, header.height) != (width, height) {
                    return Err(format!("is {}x{}, expected {width}x{height}", header.width, header.height));
                }
                decode_whole(&self.bytes, header)?
            }
        };
        Ok(RgbImage { width, height, data })
    }
}

impl RgbImage {
    /// Decodes a PNG or JPEG of whatever size its header says.
    ///
    /// # Errors
    /// A description of what is wrong with the bytes (truncated, too large, not a picture).
    pub fn decode(bytes: &[u8]) -> Result<Self, String> {
        let header = PictureHeader::read(bytes)?;
        let data = decode_whole(bytes, header)?;
        Ok(Self { width: header.width, height: header.height, data })
    }
}

fn decode_whole(bytes: &[u8], header: PictureHeader) -> Result<Vec<u8>, String> {
    let data = match header.encoding {
        ColorEncoding::Jpeg => decode_jpeg(bytes)?,
        _ => decode_png(bytes)?,
    };
    let expected = 3 * checked_pixels(header.width, header.height)?;
    if data.len() != expected {
        return Err(format!("decoded to {} bytes instead of {expected}", data.len()));
    }
    Ok(data)
}

fn checked_pixels(width: u32, height: u32) -> Result<usize, String> {
    let pixels = u64::from(width) * u64::from(height);
    if pixels == 0 || pixels > MAX_PIXELS || width > MAX_SIDE || height > MAX_SIDE {
        return Err(format!("{width}x{height} pixels cannot be decoded: none, or too many; scale it down"));
    }
    Ok(pixels as usize)
}

/// Format and size of a whole PNG or JPEG.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PictureHeader {
    /// PNG or JPEG.
    pub encoding: ColorEncoding,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl PictureHeader {
    /// Walks the file's structure to its end without decoding pixels, so that a truncated picture is found at once.
    ///
    /// # Errors
    /// Neither PNG nor JPEG, truncated, damaged, or of a size that is not decoded.
    pub fn read(bytes: &[u8]) -> Result<Self, String> {
        let header = if bytes.starts_with(PNG_SIGNATURE) {
            walk_png(bytes)
        } else if bytes.starts_with(&[0xff, 0xd8]) {
            walk_jpeg(bytes)
        } else {
            Err("neither PNG nor JPEG".into())
        }?;
        checked_pixels(header.width, header.height)?;
        Ok(header)
    }
}

fn walk_png(bytes: &[u8]) -> Result<PictureHeader, String> {
    const TRUNCATED: &str = "truncated PNG";
    let mut size = None;
    let mut rest = &bytes[PNG_SIGNATURE.len()..];
    loop {
        let (head, tail) = rest.split_first_chunk::<8>().ok_or(TRUNCATED)?;
        let length = be32(head) as usize;
        let body = tail.get(..length).ok_or(TRUNCATED)?;
        let crc = be32(tail.get(length..length + 4).ok_or(TRUNCATED)?);
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(&head[4..]);
        hasher.update(body);
        if hasher.finalize() != crc {
            return Err("damaged PNG (checksum)".into());
        }
        match &head[4..] {
            b"IHDR" if body.len() == 13 => size = Some((be32(body), be32(&body[4..]))),
            b"IEND" => break,
            _ => {}
        }
        rest = &tail[length + 4..];
    }
    let (width, height) = size.ok_or("PNG without a header")?;
    Ok(PictureHeader { encoding: ColorEncoding::Png, width, height })
}

fn be32(bytes: &[u8]) -> u32 {
    bytes.iter().take(4).fold(0, |x, b| x << 8 | u32::from(*b))
}

fn walk_jpeg(bytes: &[u8]) -> Result<PictureHeader, String> {
    const TRUNCATED: &str = "truncated JPEG";
    let mut size = None;
    // Components of a sequential frame; a progressive one always comes in several scans.
    let mut components = 0;
    let mut at = 2;
    loop {
        // Between segments stand fill bytes; inside a scan, data, stuffed 0xff00 and restart markers.
        let marker = loop {
            let gap = bytes.get(at..).and_then(|b| b.iter().position(|x| *x == 0xff)).ok_or(TRUNCATED)?;
            at += gap + 1;
            match *bytes.get(at).ok_or(TRUNCATED)? {
                0x00 | 0x01 | 0xd0..=0xd7 => at += 1,
                0xff => {}
                marker => break marker,
            }
        };
        at += 1;
        if marker == 0xd9 {
            break;
        }
        let length = be32(bytes.get(at..at + 2).ok_or(TRUNCATED)?) as usize;
        let body = bytes.get(at + 2..at + length).ok_or(if length < 2 { "damaged JPEG" } else { TRUNCATED })?;
        // Start of frame, of whatever coding; 0xc4, 0xc8 and 0xcc are tables.
        if matches!(marker, 0xc0..=0xcf) && !matches!(marker, 0xc4 | 0xc8 | 0xcc) && body.len() >= 5 {
            size = Some((be32(&body[3..5]), be32(&body[1..3])));
            components = if marker <= 0xc1 { body.get(5).copied().unwrap_or(0) } else { 0 };
        }
        // Start of scan. zune-jpeg leaves the colour out of such pictures without a word.
        if marker == 0xda && body.first().is_some_and(|scanned| *scanned < components) {
            return Err("JPEG with one scan per colour component; save it as an interleaved (ordinary) JPEG".into());
        }
        at += length;
    }
    let (width, height) = size.ok_or("JPEG without a frame header")?;
    Ok(PictureHeader { encoding: ColorEncoding::Jpeg, width, height })
}

fn decode_jpeg(bytes: &[u8]) -> Result<Vec<u8>, String> {
    let options = DecoderOptions::default()
        .set_strict_mode(true)
        .set_max_width(MAX_SIDE as usize)
        .set_max_height(MAX_SIDE as usize)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode().map_err(|e| format!("damaged JPEG: {e:?}"))
}

fn decode_png(bytes: &[u8]) -> Result<Vec<u8>, String> {
    let damaged = |e: png::DecodingError| format!("damaged PNG: {e}");
    let mut decoder = png::Decoder::new_with_limits(std::io::Cursor::new(bytes), png::Limits { bytes: PNG_LIMIT });
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
    let mut reader = decoder.read_info().map_err(damaged)?;
    let mut data = vec![0; reader.output_buffer_size().ok_or("PNG too large")?];
    let info = reader.next_frame(&mut data).map_err(damaged)?;
    reader.finish().map_err(damaged)?;
    data.truncate(info.buffer_size());
    match info.color_type {
        png::ColorType::Rgb => Ok(data),
        png::ColorType::Rgba => Ok(data.as_chunks::<4>().0.iter().flat_map(|p| [p[0], p[1], p[2]]).collect()),
        png::ColorType::Grayscale => Ok(data.iter().flat_map(|v| [*v; 3]).collect()),
        png::ColorType::GrayscaleAlpha => Ok(data.as_chunks::<2>().0.iter().flat_map(|p| [p[0]; 3]).collect()),
        png::ColorType::Indexed => Err("PNG palette was not expanded".into()),
    }
}

/// Reads a 16-bit grey PNG of exactly this size.
pub(crate) fn decode_depth_png(bytes: &[u8], width: u32, height: u32) -> Result<Vec<u16>, String> {
    let header = PictureHeader::read(bytes)?;
    if header.encoding != ColorEncoding::Png {
        return Err("depth must be a 16-bit PNG, but this is a JPEG".into());
    }
    if (header.width, header.height) != (width, height) {
        return Err(format!("is {}x{}, expected {width}x{height}", header.width, header.height));
    }
    let damaged = |e: png::DecodingError| format!("damaged PNG: {e}");
    let decoder = png::Decoder::new_with_limits(std::io::Cursor::new(bytes), png::Limits { bytes: PNG_LIMIT });
    let mut reader = decoder.read_info().map_err(damaged)?;
    let kind = reader.output_color_type();
    if kind != (png::ColorType::Grayscale, png::BitDepth::Sixteen) {
        return Err(format!("depth must be 16-bit grey, but this is {:?} {:?}", kind.1, kind.0));
    }
    let mut data = vec![0; 2 * checked_pixels(width, height)?];
    reader.next_frame(&mut data).map_err(damaged)?;
    reader.finish().map_err(damaged)?;
    Ok(data.as_chunks::<2>().0.iter().map(|b| u16::from_be_bytes(*b)).collect())
}

/// Bilinear interpolation of a G R / B G mosaic; beyond the borders the picture is mirrored about its outermost
/// pixels, which keeps the colours of the mosaic in place.
fn demosaic(mosaic: &[u8], width: usize, height: usize) -> Vec<u8> {
    let mirror = |i: usize, n: usize| (if i == 0 { 1 } else { i - 1 }, if i + 1 == n { n - 2 } else { i + 1 });
    let mut rgb = Vec::with_capacity(3 * mosaic.len());
    for y in 0..height {
        let (above, below) = mirror(y, height);
        let row = |r: usize| &mosaic[r * width..(r + 1) * width];
        let (up, here, down) = (row(above), row(y), row(below));
        for x in 0..width {
            let (left, right) = mirror(x, width);
            let value = |v: u8| u32::from(v);
            let mean2 = |a: u8, b: u8| (value(a) + value(b)).div_ceil(2) as u8;
            let cross = || ((value(up[x]) + value(down[x]) + value(here[left]) + value(here[right]) + 2) / 4) as u8;
            let corners =
                || ((value(up[left]) + value(up[right]) + value(down[left]) + value(down[right]) + 2) / 4) as u8;
            let (horizontal, vertical) = (mean2(here[left], here[right]), mean2(up[x], down[x]));
            rgb.extend(match (y % 2, x % 2) {
                (0, 0) => [horizontal, here[x], vertical],
                (0, _) => [here[x], cross(), corners()],
                (_, 0) => [corners(), cross(), here[x]],
                _ => [vertical, here[x], horizontal],
            });
        }
    }
    rgb
}

/// An 8-bit RGB or 16-bit grey PNG; `bytes` in PNG's order (big-endian).
pub(crate) fn encode_png(width: u32, height: u32, kind: png::ColorType, bytes: &[u8]) -> Result<Vec<u8>, String> {
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, width, height);
    encoder.set_color(kind);
    encoder.set_depth(if kind == png::ColorType::Grayscale { png::BitDepth::Sixteen } else { png::BitDepth::Eight });
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().map_err(|e| e.to_string())?;
    writer.write_image_data(bytes).map_err(|e| e.to_string())?;
    writer.finish().map_err(|e| e.to_string())?;
    Ok(out)
}

/// A 16-bit grey PNG of a depth image.
pub(crate) fn encode_depth_png(width: u32, height: u32, depth: &[u16]) -> Result<Vec<u8>, String> {
    let bytes: Vec<u8> = depth.iter().flat_map(|d| d.to_be_bytes()).collect();
    encode_png(width, height, png::ColorType::Grayscale, &bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{GRADIENT_JPEG, color_frame};
    use proptest::prelude::*;

    #[test]
    fn jpeg_is_decoded_and_every_truncation_is_an_error() {
        let frame = color_frame(0, 32, 24, ColorEncoding::Jpeg, GRADIENT_JPEG.to_vec());
        let image = frame.decode().unwrap();
        // The picture is (8x, 10y, 128 + 40 sin(x/3)); JPEG at quality 90 stays within a few levels on it.
        for (x, y) in [(0, 0), (31, 0), (10, 12), (31, 23)] {
            let pixel = &image.data[3 * (y * 32 + x)..][..3];
            assert!((i32::from(pixel[0]) - 8 * x as i32).abs() < 14, "{x} {y} {pixel:?}");
            assert!((i32::from(pixel[1]) - 10 * y as i32).abs() < 14, "{x} {y} {pixel:?}");
        }
        for length in 0..GRADIENT_JPEG.len() {
            let bytes = GRADIENT_JPEG[..length].to_vec();
            assert!(color_frame(0, 32, 24, ColorEncoding::Jpeg, bytes).decode().is_err(), "{length}");
        }
        assert!(color_frame(0, 24, 32, ColorEncoding::Jpeg, GRADIENT_JPEG.to_vec()).decode().is_err());
        assert!(color_frame(0, 32, 24, ColorEncoding::Png, GRADIENT_JPEG.to_vec()).decode().is_err());
    }

    #[test]
    fn jpegs_whose_colours_would_be_lost_are_refused() {
        let mut bytes = Vec::new();
        let mut encoder = jpeg_encoder::Encoder::new(&mut bytes, 90);
        encoder.set_optimized_huffman_tables(true);
        encoder.encode(&[200, 100, 50].repeat(32 * 24), 32, 24, jpeg_encoder::ColorType::Rgb).unwrap();
        let problem = color_frame(0, 32, 24, ColorEncoding::Jpeg, bytes).decode().unwrap_err();
        assert!(problem.contains("interleaved"), "{problem}");
    }

    #[test]
    fn png_comes_back_and_every_truncation_is_an_error() {
        let data: Vec<u8> = (0..7 * 5 * 3).map(|i| (i * 37 % 251) as u8).collect();
        let bytes = encode_png(7, 5, png::ColorType::Rgb, &data).unwrap();
        let image = color_frame(0, 7, 5, ColorEncoding::Png, bytes.clone()).decode().unwrap();
        assert_eq!(image.data, data);
        for length in 0..bytes.len() {
            assert!(color_frame(0, 7, 5, ColorEncoding::Png, bytes[..length].to_vec()).decode().is_err());
        }
    }

    #[test]
    fn depth_png_comes_back_and_other_kinds_are_refused() {
        let depth: Vec<u16> = (0..35).map(|i| i * 1871).collect();
        let bytes = encode_depth_png(7, 5, &depth).unwrap();
        assert_eq!(decode_depth_png(&bytes, 7, 5).unwrap(), depth);
        assert!(decode_depth_png(&bytes, 5, 7).unwrap_err().contains("expected 5x7"));
        let rgb = encode_png(7, 5, png::ColorType::Rgb, &[9; 105]).unwrap();
        assert!(decode_depth_png(&rgb, 7, 5).unwrap_err().contains("16-bit"));
        assert!(decode_depth_png(GRADIENT_JPEG, 32, 24).is_err());
    }

    #[test]
    fn demosaicing_keeps_flat_colours_and_ramps() {
        // Flat: every channel its own value, borders included.
        let mosaic: Vec<u8> = (0..6 * 4).map(|i| [[90, 200], [40, 90]][i / 6 % 2][i % 6 % 2]).collect();
        let image = color_frame(0, 6, 4, ColorEncoding::BayerGrbg, mosaic).decode().unwrap();
        assert!(image.data.as_chunks::<3>().0.iter().all(|p| *p == [200, 90, 40]), "{:?}", image.data);
        // A horizontal ramp is linear, so interpolation meets it exactly away from the borders.
        let mosaic: Vec<u8> = (0..8 * 6).map(|i| (10 * (i % 8)) as u8).collect();
        let image = color_frame(0, 8, 6, ColorEncoding::BayerGrbg, mosaic).decode().unwrap();
        for (i, p) in image.data.as_chunks::<3>().0.iter().enumerate() {
            if (1..7).contains(&(i % 8)) {
                assert_eq!(*p, [(10 * (i % 8)) as u8; 3], "pixel {i}");
            }
        }
        assert!(color_frame(0, 6, 4, ColorEncoding::BayerGrbg, vec![0; 23]).decode().is_err());
        assert!(color_frame(0, 1, 1, ColorEncoding::BayerGrbg, vec![0]).decode().is_err());
        assert!(color_frame(0, 0, 0, ColorEncoding::Rgb, vec![]).decode().is_err());
        assert!(color_frame(0, u32::MAX, u32::MAX, ColorEncoding::Rgb, vec![]).decode().is_err());
    }

    #[test]
    fn jpeg_pixels_do_not_depend_on_the_instruction_set() {
        let plain = |bytes: &[u8]| {
            let options = DecoderOptions::default().set_use_unsafe(false).jpeg_set_out_colorspace(ColorSpace::RGB);
            zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(bytes), options).decode().unwrap()
        };
        assert!(decode_jpeg(GRADIENT_JPEG).unwrap() == plain(GRADIENT_JPEG));
    }

    proptest! {
        #[test]
        fn bit_flips_never_panic(at in 0usize..GRADIENT_JPEG.len(), bit in 0u8..8) {
            let mut bytes = GRADIENT_JPEG.to_vec();
            bytes[at] ^= 1 << bit;
            let _ = color_frame(0, 32, 24, ColorEncoding::Jpeg, bytes.clone()).decode();
            let _ = color_frame(0, 32, 25, ColorEncoding::Jpeg, bytes).decode();
            let mut bytes = encode_png(7, 5, png::ColorType::Rgb, &[77; 105]).unwrap();
            let at = at % bytes.len();
            bytes[at] ^= 1 << bit;
            prop_assert!(color_frame(0, 7, 5, ColorEncoding::Png, bytes).decode().is_err());
        }

        #[test]
        fn random_bytes_are_no_picture(bytes in proptest::collection::vec(any::<u8>(), 0..200), jpeg in any::<bool>()) {
            let mut whole = if jpeg { vec![0xff, 0xd8] } else { PNG_SIGNATURE.to_vec() };
            whole.extend(bytes);
            let encoding = if jpeg { ColorEncoding::Jpeg } else { ColorEncoding::Png };
            prop_assert!(color_frame(0, 7, 5, encoding, whole.clone()).decode().is_err());
            prop_assert!(decode_depth_png(&whole, 7, 5).is_err());
        }
    }
}
