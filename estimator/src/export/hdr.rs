//! Distant light as an equirectangular panorama, in Radiance's RGBE format and as OpenEXR.
//!
//! Row r: θ = (r + ½)/H · π from +Z; column c: azimuth 2π (c + ½)/W from +Y, clockwise from above;
//! direction = (sin θ sin a, sin θ cos a, cos θ).

use crate::export::file::write_whole;
use crate::render::lighting::environment::Environment;
use glam::{DVec3, Vec3};
use std::f64::consts::PI;
use std::fs::File;
use std::io::{BufWriter, Result, Write};
use std::path::Path;

/// Size of the panorama: at the equator its pixels are as wide as the texels of [`Environment`].
const SIZE: (usize, usize) = (512, 256);

/// Direction of a pixel of a panorama of `width` × `height`.
#[must_use]
pub fn direction(x: usize, y: usize, (width, height): (usize, usize)) -> DVec3 {
    let theta = (y as f64 + 0.5) / height as f64 * PI;
    let azimuth = 2.0 * PI * (x as f64 + 0.5) / width as f64;
    let (sin, cos) = libm::sincos(theta);
    let (sin_a, cos_a) = libm::sincos(azimuth);
    DVec3::new(sin * sin_a, sin * cos_a, cos)
}

/// Radiance over all directions, row-major.
#[must_use]
pub fn panorama(light: &Environment, size: (usize, usize)) -> Vec<Vec3> {
    let pixels = (0..size.1).flat_map(|y| (0..size.0).map(move |x| (x, y)));
    pixels.map(|(x, y)| light.radiance(direction(x, y, size).as_vec3())).collect()
}

/// Writes the panorama to `path`. Nothing appears under that name before it is complete.
///
/// # Errors
/// The disk is full or gone.
pub fn write(light: &Environment, path: &Path) -> Result<()> {
    write_whole(path, |file| write_to(&panorama(light, SIZE), SIZE, BufWriter::new(file)))
}

/// Writes the panorama to `path` as OpenEXR.
///
/// # Errors
/// The disk is full or gone.
pub fn write_exr(light: &Environment, path: &Path) -> Result<()> {
    crate::export::picture::write_exr(path, SIZE.0, SIZE.1, &panorama(light, SIZE))
}

fn write_to(pixels: &[Vec3], (width, height): (usize, usize), mut out: BufWriter<&File>) -> Result<()> {
    write!(out, "#?RADIANCE\nSOFTWARE=lumiscan\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n")?;
    for row in pixels.chunks_exact(width) {
        let encoded: Vec<[u8; 4]> = row.iter().map(|p| rgbe(p.to_array())).collect();
        // The newer run-length form: a marker with the width, then the four components one after the other.
        out.write_all(&[2, 2, (width >> 8) as u8, width as u8])?;
        for component in 0..4 {
            let bytes: Vec<u8> = encoded.iter().map(|p| p[component]).collect();
            run_lengths(&bytes, &mut out)?;
        }
    }
    out.flush()
}

/// Shared-exponent encoding of a non-negative colour.
fn rgbe(color: [f32; 3]) -> [u8; 4] {
    let largest = color.iter().fold(0.0f32, |m, c| m.max(*c));
    // Below and above lies nothing that the exponent's byte can say; NaN fails too.
    if !(1e-32..1e38).contains(&largest) {
        return [0; 4];
    }
    let (_, exponent) = libm::frexpf(largest);
    let scale = libm::ldexpf(1.0, 8 - exponent);
    let [r, g, b] = color.map(|c| (c * scale).clamp(0.0, 255.0) as u8);
    [r, g, b, (exponent + 128) as u8]
}

/// Runs of at least four equal bytes as (128 + n, byte), everything else as (n, bytes).
fn run_lengths(bytes: &[u8], out: &mut impl Write) -> Result<()> {
    const SHORTEST: usize = 4;
    const LONGEST: usize = 127;
    let run = |from: usize| bytes[from..].iter().take(LONGEST).take_while(|b| **b == bytes[from]).count();
    let mut at = 0;
    while at < bytes.len() {
        let n = run(at);
        if n >= SHORTEST {
            out.write_all(&[128 + n as u8, bytes[at]])?;
            at += n;
            continue;
        }
        let start = at;
        while at < bytes.len() && at - start < 128 && run(at) < SHORTEST {
            at += 1;
        }
        out.write_all(&[(at - start) as u8])?;
        out.write_all(&bytes[start..at])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn unpack(mut packed: &[u8], length: usize) -> Vec<u8> {
        let mut bytes = Vec::new();
        while bytes.len() < length {
            let n = usize::from(packed[0]);
            if n > 128 {
                bytes.extend(std::iter::repeat_n(packed[1], n - 128));
                packed = &packed[2..];
            } else {
                bytes.extend_from_slice(&packed[1..=n]);
                packed = &packed[n + 1..];
            }
        }
        assert!(packed.is_empty());
        bytes
    }

    proptest! {
        #[test]
        fn run_lengths_unpack(bytes in proptest::collection::vec(0u8..3, 1..600)) {
            let mut packed = Vec::new();
            run_lengths(&bytes, &mut packed).unwrap();
            prop_assert_eq!(unpack(&packed, bytes.len()), bytes);
        }

        #[test]
        fn rgbe_keeps_one_percent(r in 1e-6f32..1e6, g in 0f32..1.0, b in 0f32..1.0) {
            let color = [r, g * r, b * r];
            let [er, eg, eb, e] = rgbe(color);
            for (byte, value) in [er, eg, eb].iter().zip(color) {
                let read = (f32::from(*byte) + 0.5) * libm::ldexpf(1.0, i32::from(e) - 136);
                prop_assert!((read - value).abs() <= 0.005 * r, "{read} {value}");
            }
        }
    }

    #[test]
    fn directions_follow_the_convention() {
        let size = (256, 128);
        assert!(direction(0, 0, size).z > 0.999);
        let y = direction(0, 64, size);
        assert!(y.y > 0.99 && y.x > 0.0, "{y}");
        assert!(direction(64, 64, size).x > 0.99);
    }

    #[test]
    fn extremes_are_black_not_noise() {
        assert_eq!(rgbe([0.0, 0.0, 0.0]), [0; 4]);
        assert_eq!(rgbe([f32::NAN; 3]), [0; 4]);
    }
}
