//! Depth images to packed raw frames: the inverse of [`crate::kinect::depth_decoder`], for a device whose registration
//! leaves every pixel where it is.

use crate::kinect::calibration::Calibration;
use crate::kinect::registration::{HEIGHT, MAX_MM, NO_DEPTH, SUBPIXELS, WIDTH, depth_table};
use firmware_config::kinect_models::StreamFormat;

/// Turns depth images into packed raw frames.
pub struct DepthEncoder {
    bits: u32,
    /// `[raw]` → (mm, shift in 1/256 pixel).
    lookup: Vec<(u16, i32)>,
    /// `[mm]` → raw value of the nearest depth.
    raw_of: Vec<u16>,
}

impl DepthEncoder {
    /// For one device and format.
    #[must_use]
    pub fn new(calibration: &Calibration, format: &StreamFormat) -> Self {
        let lookup = depth_table(calibration, format);
        Self { bits: format.bits, raw_of: nearest_raw(&lookup), lookup }
    }

    /// A packed raw frame that a decoder of the same calibration turns back into `depth` (`[y][x]`, mm, 640×480), as far
    /// as raw values resolve it and no surface hides another from the infrared camera.
    #[must_use]
    pub fn encode(&self, depth: &[u16]) -> Vec<u8> {
        let mut raw = vec![NO_DEPTH; WIDTH * HEIGHT];
        for (i, &mm) in depth.iter().enumerate().take(WIDTH * HEIGHT) {
            let Some(&value) = self.raw_of.get(usize::from(mm)).filter(|r| **r != NO_DEPTH) else { continue };
            let (_, shift) = self.lookup[usize::from(value)];
            let (row, column) = (i / WIDTH, (i % WIDTH) as i32);
            let source = (column * SUBPIXELS).saturating_sub(shift).saturating_add(SUBPIXELS - 1).div_euclid(SUBPIXELS);
            if (0..WIDTH as i32).contains(&source) {
                let target = &mut raw[row * WIDTH + source as usize];
                // Smaller raw values are nearer.
                *target = (*target).min(value);
            }
        }
        pack(&raw, self.bits)
    }
}

/// `[mm]` → raw value of the nearest depth; [`NO_DEPTH`] where none is within a tenth.
fn nearest_raw(lookup: &[(u16, i32)]) -> Vec<u16> {
    let values: Vec<(u16, u16)> =
        (0..NO_DEPTH).map(|r| (lookup[usize::from(r)].0, r)).filter(|(mm, _)| *mm > 0).collect();
    let mut table = vec![NO_DEPTH; MAX_MM];
    for (mm, slot) in table.iter_mut().enumerate().skip(1) {
        let next = values.partition_point(|(v, _)| usize::from(*v) < mm);
        let candidates = [next.checked_sub(1), Some(next)].into_iter().flatten().filter_map(|i| values.get(i));
        if let Some((v, raw)) = candidates.min_by_key(|(v, _)| usize::from(*v).abs_diff(mm))
            && usize::from(*v).abs_diff(mm) * 10 < mm
        {
            *slot = *raw;
        }
    }
    table
}

/// Packs pixels of `bits` bits, most significant bit first.
#[must_use]
pub fn pack(raw: &[u16], bits: u32) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(raw.len() * bits as usize / 8);
    let (mut window, mut held) = (0u32, 0);
    for &value in raw {
        window = window << bits | u32::from(value) & ((1 << bits) - 1);
        held += bits;
        while held >= 8 {
            held -= 8;
            bytes.push((window >> held) as u8);
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinect::buffers::Pool;
    use crate::kinect::depth_decoder::DepthDecoder;
    use crate::simulator::calibration::calibration;
    use firmware_config::kinect_models::DEPTH_11;

    #[test]
    fn encoding_is_undone_by_decoding() {
        let encoder = DepthEncoder::new(&calibration(), &DEPTH_11);
        let mut decoder = DepthDecoder::new(&calibration(), &DEPTH_11, Pool::default());
        let depth: Vec<u16> =
            (0..WIDTH * HEIGHT).map(|i| if i % 97 == 0 { 0 } else { 900 + (i / WIDTH) as u16 }).collect();
        let packed = encoder.encode(&depth);
        let again = decoder.decode(&packed, &[], 5);
        let mut compared = 0;
        for (i, (&a, &b)) in depth.iter().zip(&again.depth).enumerate() {
            // Columns at the border come from outside the infrared image.
            if (30..610).contains(&(i % WIDTH)) {
                assert!(a.abs_diff(b) <= 3 && (a == 0) == (b == 0), "pixel {i}: {a} became {b}");
                compared += 1;
            }
        }
        assert_eq!(compared, 580 * HEIGHT);
    }
}
