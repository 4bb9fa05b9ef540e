//! Reads equirectangular panoramas (`.hdr`, `.exr`, `.png`, `.jpg`), reduced while they are read.
//!
//! Row r: θ = (r + ½)/H · π from +Z; column c: azimuth 2π (c + ½)/W from +Y, clockwise from above.

use crate::numerics::sh;
use crate::render::error::{RenderError, Result};
use crate::render::lighting::environment::Environment;
use glam::Vec3;
use rayon::prelude::*;
use recordings::codec::image::PictureHeader;
use recordings::types::{Response, RgbImage};
use std::f32::consts::{PI, TAU};
use std::io::{BufRead, Read, Seek};
use std::path::Path;

/// Widest panorama that is accepted, in pixels.
const MAX_WIDTH: usize = 16_384;
/// Widest that is kept: finer than the texels of an [`Environment`].
const KEPT_WIDTH: usize = 1024;
/// Largest file, in bytes.
const MAX_FILE_BYTES: u64 = 1 << 30;
/// Longest line of a Radiance header, in bytes.
const MAX_LINE_BYTES: u64 = 4096;
const TRUNCATED: &str = "is truncated";

/// A panorama: linear RGB radiance, row-major, `2 height` × `height`.
#[derive(Debug, Clone, PartialEq)]
pub struct Panorama {
    width: usize,
    pixels: Vec<Vec3>,
}

/// Sums pixels of a large panorama into a smaller one.
struct Reduced {
    from: [usize; 2],
    width: usize,
    sums: Vec<Vec3>,
    counts: Vec<u32>,
}

impl Reduced {
    fn new(width: usize, height: usize) -> std::result::Result<Self, String> {
        if width == 0 || Some(width) != height.checked_mul(2) {
            return Err(format!("is {width}x{height}: a panorama of all directions is twice as wide as high"));
        }
        if width > MAX_WIDTH {
            return Err(format!("is {width} pixels wide, more than {MAX_WIDTH}; scale it down first"));
        }
        let kept = width.min(KEPT_WIDTH);
        let n = kept * (kept / 2).max(1);
        Ok(Self { from: [width, height], width: kept, sums: vec![Vec3::ZERO; n], counts: vec![0; n] })
    }

    fn add(&mut self, x: usize, y: usize, value: Vec3) {
        let height = self.sums.len() / self.width;
        let i = (y * height / self.from[1]) * self.width + x * self.width / self.from[0];
        if let (Some(s), Some(c)) = (self.sums.get_mut(i), self.counts.get_mut(i)) {
            *s += value;
            *c += 1;
        }
    }

    fn finish(self) -> std::result::Result<Panorama, String> {
        let pixels: Vec<Vec3> = self.sums.iter().zip(&self.counts).map(|(s, c)| *s / (*c).max(1) as f32).collect();
        Panorama::new(self.width, pixels)
    }
}

impl Panorama {
    /// From pixels.
    ///
    /// # Errors
    /// Not 2:1, or NaN, infinite or negative radiance in it.
    pub fn new(width: usize, pixels: Vec<Vec3>) -> std::result::Result<Self, String> {
        if width == 0 || pixels.len() * 2 != width * width {
            return Err(format!("is {width} pixels wide and not half as high"));
        }
        if let Some(p) = pixels.iter().find(|p| !p.is_finite() || p.min_element() < 0.0) {
            let what = if p.is_finite() { "negative radiance" } else { "NaN or infinite radiance" };
            return Err(format!("has {what} in it"));
        }
        Ok(Self { width, pixels })
    }

    /// Reads a file; what it is, is read from its contents.
    ///
    /// # Errors
    /// Unreadable, damaged, not 2:1, too wide, NaN or negative values.
    pub fn read(path: &Path) -> Result<Self> {
        let size = std::fs::metadata(path).map_err(|e| RenderError::file(path, e))?.len();
        if size > MAX_FILE_BYTES {
            return Err(RenderError::file(path, "is larger than 1 GiB; scale it down first"));
        }
        let file = std::fs::File::open(path).map_err(|e| RenderError::file(path, e))?;
        Self::decode(std::io::BufReader::new(file)).map_err(|e| RenderError::file(path, e))
    }

    /// Decodes a file, high-range forms without holding it as a whole.
    ///
    /// # Errors
    /// As [`Panorama::read`].
    pub fn decode(mut file: impl BufRead + Seek) -> std::result::Result<Self, String> {
        let start = file.fill_buf().map_err(|e| e.to_string())?;
        if start.is_empty() {
            Err("is empty".into())
        } else if start.starts_with(b"#?") {
            radiance(file)
        } else if start.starts_with(&[0x76, 0x2f, 0x31, 0x01]) {
            openexr(file)
        } else {
            let mut bytes = Vec::new();
            file.read_to_end(&mut bytes).map_err(|e| e.to_string())?;
            let unreadable = |e: String| format!("is no panorama that can be read: {e}");
            let header = PictureHeader::read(&bytes).map_err(unreadable)?;
            Reduced::new(header.width as usize, header.height as usize)?;
            let image = RgbImage::decode(&bytes).map_err(unreadable)?;
            let (width, height) = (image.width as usize, image.height as usize);
            let table = Response::Srgb.linear_table();
            let mut out = Reduced::new(width, height)?;
            for (i, p) in image.data.chunks_exact(3).enumerate() {
                let linear = Vec3::new(table[p[0] as usize], table[p[1] as usize], table[p[2] as usize]);
                out.add(i % width, i / width, linear);
            }
            out.finish()
        }
    }

    fn height(&self) -> usize {
        self.width / 2
    }

    /// Bilinear radiance from a unit direction.
    #[must_use]
    pub fn radiance(&self, d: Vec3) -> Vec3 {
        let (w, h) = (self.width as i32, self.height() as i32);
        let u = libm::atan2f(d.x, d.y) / TAU * w as f32 - 0.5;
        let v = (libm::acosf(d.z.clamp(-1.0, 1.0)) / PI * h as f32 - 0.5).clamp(0.0, (h - 1) as f32);
        let (x, y) = (libm::floorf(u), libm::floorf(v));
        let (fx, fy) = (u - x, v - y);
        let at = |x: i32, y: i32| self.pixels[(y.min(h - 1) * w + x.rem_euclid(w)) as usize];
        let (x, y) = (x as i32, y as i32);
        at(x, y).lerp(at(x + 1, y), fx).lerp(at(x, y + 1).lerp(at(x + 1, y + 1), fx), fy)
    }

    /// As light on a scene, turned by `yaw` (radian, counter-clockwise from above).
    #[must_use]
    pub fn environment(&self, yaw: f32) -> Environment {
        let (s, c) = libm::sincosf(-yaw);
        let seen = |d: Vec3| self.radiance(Vec3::new(c * d.x - s * d.y, s * d.x + c * d.y, d.z));
        // Where pixels are finer than texels, a texel is the mean of a few points: small lamps are not missed.
        if self.width > 512 { Environment::averaged(seen) } else { Environment::from_fn(seen) }
    }
}

/// Spherical harmonics of panoramas of one size: the basis is kept, a panorama costs one product.
#[derive(Debug)]
pub struct Projector {
    width: usize,
    bands: usize,
    /// Y_k times solid angle: `[pixel][k]`.
    basis: Vec<f32>,
}

impl Projector {
    /// For panoramas reduced to at most this width.
    const WIDTH: usize = 256;

    /// For panoramas like this one.
    #[must_use]
    pub fn new(panorama: &Panorama, bands: usize) -> Self {
        let width = panorama.width.min(Self::WIDTH);
        let (height, k) = (width / 2, bands * bands);
        let basis = (0..width * height)
            .into_par_iter()
            .flat_map_iter(|i| {
                let (theta, azimuth) = (
                    ((i / width) as f64 + 0.5) / height as f64 * f64::from(PI),
                    ((i % width) as f64 + 0.5) / width as f64 * f64::from(TAU),
                );
                let ((s, c), (sa, ca)) = (libm::sincos(theta), libm::sincos(azimuth));
                let row = (i / width) as f64;
                let cos = |r: f64| libm::cos(r / height as f64 * f64::from(PI));
                let solid = (cos(row) - cos(row + 1.0)) * f64::from(TAU) / width as f64;
                let mut y = [0.0; sh::MAX_COEFFICIENTS];
                sh::eval(glam::DVec3::new(s * sa, s * ca, c), &mut y[..k]);
                y.into_iter().take(k).map(move |y| (y * solid) as f32)
            })
            .collect();
        Self { width, bands, basis }
    }

    /// True if it fits this panorama.
    #[must_use]
    pub fn fits(&self, panorama: &Panorama) -> bool {
        panorama.width.min(Self::WIDTH) == self.width
    }

    /// Coefficients of a panorama: `bands²` rows of RGB.
    #[must_use]
    pub fn project(&self, panorama: &Panorama) -> Vec<[f64; 3]> {
        let k = self.bands * self.bands;
        let range = |i: usize, from: usize, to: usize| (i * from).div_ceil(to)..((i + 1) * from).div_ceil(to);
        let rows: Vec<Vec<[f32; 3]>> = (0..self.width / 2)
            .into_par_iter()
            .map(|row| {
                let mut sum = vec![[0.0f32; 3]; k];
                for column in 0..self.width {
                    let mut p = Vec3::ZERO;
                    let columns = range(column, panorama.width, self.width);
                    let rows = range(row, panorama.height(), self.width / 2);
                    let count = (columns.len() * rows.len()).max(1);
                    for y in rows {
                        p += panorama.pixels[y * panorama.width..][columns.clone()].iter().sum::<Vec3>();
                    }
                    let p = p / count as f32;
                    let y = &self.basis[(row * self.width + column) * k..][..k];
                    for (s, y) in sum.iter_mut().zip(y) {
                        *s = [s[0] + p.x * y, s[1] + p.y * y, s[2] + p.z * y];
                    }
                }
                sum
            })
            .collect();
        let mut sum = vec![[0.0f64; 3]; k];
        for row in rows {
            for (s, r) in sum.iter_mut().zip(row) {
                *s = std::array::from_fn(|c| s[c] + f64::from(r[c]));
            }
        }
        sum
    }
}

/// Coefficients of light turned by `yaw` (radian, counter-clockwise from above).
#[must_use]
pub fn turned(coefficients: &[[f64; 3]], yaw: f64) -> Vec<[f64; 3]> {
    let mut out = coefficients.to_vec();
    let bands = coefficients.len().isqrt();
    for l in 1..bands {
        for m in 1..=l {
            let (s, c) = libm::sincos(m as f64 * yaw);
            let (plus, minus) = (l * (l + 1) + m, l * (l + 1) - m);
            // Y_{l,m} ∝ cos mφ, Y_{l,−m} ∝ sin mφ: f(φ − yaw) mixes the two.
            for k in 0..3 {
                let (a, b) = (coefficients[plus][k], coefficients[minus][k]);
                out[plus][k] = c * a - s * b;
                out[minus][k] = s * a + c * b;
            }
        }
    }
    out
}

/// Radiance RGBE, run-length encoded or not.
fn radiance(mut file: impl BufRead) -> std::result::Result<Panorama, String> {
    let mut line = || {
        let mut text = Vec::new();
        let n = (&mut file).take(MAX_LINE_BYTES).read_until(b'\n', &mut text).map_err(|e| e.to_string())?;
        if n == 0 || text.pop() != Some(b'\n') { Err(TRUNCATED.to_string()) } else { Ok(text) }
    };
    while !line()?.is_empty() {}
    let size = String::from_utf8_lossy(&line()?).into_owned();
    let words: Vec<&str> = size.split_ascii_whitespace().collect();
    let ["-Y", height, "+X", width] = words.as_slice() else {
        return Err(format!("has an orientation that is not read: `{size}`"));
    };
    let number = |s: &str| s.parse::<usize>().map_err(|_| format!("has no size: `{size}`"));
    let (width, height) = (number(width)?, number(height)?);
    let mut out = Reduced::new(width, height)?;
    let mut row = vec![[0u8; 4]; width];
    for y in 0..height {
        scanline(&mut file, &mut row).map_err(|_| TRUNCATED)?;
        for (x, p) in row.iter().enumerate() {
            let scale = if p[3] == 0 { 0.0 } else { libm::ldexpf(1.0, i32::from(p[3]) - 136) };
            out.add(x, y, Vec3::new(f32::from(p[0]), f32::from(p[1]), f32::from(p[2])) * scale);
        }
    }
    out.finish()
}

/// Decodes one scanline.
fn scanline(file: &mut impl Read, row: &mut [[u8; 4]]) -> std::io::Result<()> {
    let mut head = [0; 4];
    file.read_exact(&mut head)?;
    let coded = head[0] == 2 && head[1] == 2 && usize::from(head[2]) << 8 | usize::from(head[3]) == row.len();
    if !coded {
        row[0] = head;
        return row[1..].iter_mut().try_for_each(|p| file.read_exact(p));
    }
    let mut values = [0; 128];
    for component in 0..4 {
        let mut x = 0;
        while x < row.len() {
            let mut n = [0];
            file.read_exact(&mut n)?;
            let (count, run) = if n[0] > 128 { (usize::from(n[0]) - 128, true) } else { (usize::from(n[0]), false) };
            if count == 0 || x + count > row.len() {
                return Err(std::io::ErrorKind::InvalidData.into());
            }
            let values = &mut values[..count];
            if run {
                file.read_exact(&mut values[..1])?;
                values.fill(values[0]);
            } else {
                file.read_exact(values)?;
            }
            row[x..].iter_mut().zip(values).for_each(|(p, v)| p[component] = *v);
            x += count;
        }
    }
    Ok(())
}

fn openexr(mut file: impl BufRead + Seek) -> std::result::Result<Panorama, String> {
    use exr::prelude::*;
    let meta = MetaData::read_from_buffered(&mut file, false).map_err(|e| format!("is damaged: {e}"))?;
    file.rewind().map_err(|e| e.to_string())?;
    let size = meta.headers.first().ok_or("has no picture in it")?.layer_size;
    Reduced::new(size.0, size.1)?;
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |size: Vec2<usize>, _: &RgbChannels| Reduced::new(size.0, size.1).map_err(|e| e.to_string()),
            |out: &mut std::result::Result<Reduced, String>, at: Vec2<usize>, (r, g, b): (f32, f32, f32)| {
                if let Ok(out) = out {
                    out.add(at.0, at.1, Vec3::new(r, g, b));
                }
            },
        )
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(file)
        .map_err(|e| format!("is damaged: {e}"))?;
    image.layer_data.channel_data.pixels?.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_even_panorama_projects_to_its_level_and_turning_keeps_what_it_should() {
        let panorama =
            Panorama::new(128, (0..128 * 64).map(|i| Vec3::splat(1.0 + (i % 128 < 20) as u8 as f32)).collect())
                .unwrap();
        let c = Projector::new(&panorama, 5).project(&panorama);
        assert!((c[0][0] / 0.282_094_79 / (4.0 * f64::from(PI)) - (1.0 + 20.0 / 128.0)).abs() < 1e-3, "{:?}", c[0]);
        // A turn by 90° counter-clockwise takes what comes from +Y to −X.
        let turn = turned(&c, f64::from(PI) / 2.0);
        assert!((turn[3][0] + c[1][0]).abs() < 1e-6 && (turn[1][0] - c[3][0]).abs() < 1e-6);
        let environment = panorama.environment(PI / 2.0).project(5);
        for (a, b) in environment.iter().zip(&turn) {
            assert!((a[0] - b[0]).abs() < 0.02, "{a:?} {b:?}");
        }
    }

    #[test]
    fn what_is_no_panorama_is_refused_by_name() {
        let say = |b: Vec<u8>| Panorama::decode(std::io::Cursor::new(b)).unwrap_err();
        assert!(say(vec![]).contains("empty"));
        assert!(say(b"#?RADIANCE\n\n-Y 4 +X 9\n".to_vec()).contains("9x4"));
        // Twice this is 16 more than what counts.
        assert!(say(b"#?RADIANCE\n\n-Y 9223372036854775816 +X 16\n".to_vec()).contains("9223372036854775816"));
        assert!(say(b"#?RADIANCE\n\n-Y 20000 +X 40000\n".to_vec()).contains("more than"));
        assert!(say(b"#?RADIANCE\n\n-Y 2 +X 4\nabc".to_vec()).contains("truncated"));
        let head = [&b"IHDR"[..], &16384u32.to_be_bytes(), &8192u32.to_be_bytes(), &[8, 2, 0, 0, 0]].concat();
        let crc = 0xad1ccb36_u32.to_be_bytes();
        let png = [b"\x89PNG\r\n\x1a\n\0\0\0\r", &head[..], &crc, b"\0\0\0\0IEND\xae\x42\x60\x82"].concat();
        assert!(say(png).contains("scale it down"));
        assert!(Panorama::new(2, vec![Vec3::NAN; 2]).unwrap_err().contains("NaN"));
        assert!(Panorama::new(2, vec![Vec3::NEG_ONE; 2]).unwrap_err().contains("negative"));
    }
}
