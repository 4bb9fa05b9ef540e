//! Packed raw depth frames to depth images in millimetres with the colour camera's pixels.

use crate::kinect::buffers::Pool;
use crate::kinect::calibration::Calibration;
use crate::kinect::depth_unpacking::unpack;
use crate::kinect::registration::{HEIGHT, NO_DEPTH, RAW_VALUES, SUBPIXELS, WIDTH, depth_table, registration_table};
use firmware_config::kinect_models::StreamFormat;
use recordings::types::{DepthFrame, TimestampNs};

/// Decodes packed raw frames of one device into depth images registered to the colour camera.
pub struct DepthDecoder {
    format: &'static StreamFormat,
    /// `[raw]` → (mm, 0 = none; shift in 1/256 pixel).
    lookup: Vec<(u16, i32)>,
    table: Vec<[i32; 2]>,
    start_lines: usize,
    raw: Vec<u16>,
    images: Pool<u16>,
}

impl DepthDecoder {
    /// For one device and format; images are made in the buffers of a pool.
    #[must_use]
    pub fn new(calibration: &Calibration, format: &'static StreamFormat, images: Pool<u16>) -> Self {
        Self {
            format,
            lookup: depth_table(calibration, format),
            table: registration_table(&calibration.registration),
            start_lines: usize::from(calibration.start_lines),
            raw: Vec::with_capacity(WIDTH * HEIGHT),
            images,
        }
    }

    /// Decodes and registers a frame, `[y][x]` in millimetres, 0 = no depth. Pixels of the `missing` packets have no depth.
    #[must_use]
    pub fn decode(&mut self, packed: &[u8], missing: &[u16], timestamp_ns: TimestampNs) -> DepthFrame {
        unpack(self.format.bits, packed, &mut self.raw);
        self.raw.resize(WIDTH * HEIGHT, NO_DEPTH);
        for &packet in missing {
            let pixels = self.pixels_of(usize::from(packet));
            self.raw.get_mut(pixels).into_iter().flatten().for_each(|p| *p = NO_DEPTH);
        }
        let mut depth = self.images.take();
        depth.clear();
        depth.resize(WIDTH * HEIGHT, 0);
        for (&raw, &[x, y]) in self.raw.iter().zip(&self.table) {
            let (mm, shift) = self.lookup[usize::from(raw) & (RAW_VALUES - 1)];
            if mm == 0 {
                continue;
            }
            let column = x.saturating_add(shift) / SUBPIXELS;
            let row = (y as usize).wrapping_sub(self.start_lines);
            if (0..WIDTH as i32).contains(&column) && row < HEIGHT {
                let target = &mut depth[row * WIDTH + column as usize];
                if *target == 0 || *target > mm {
                    *target = mm;
                }
            }
        }
        DepthFrame {
            timestamp_ns,
            width: WIDTH as u32,
            height: HEIGHT as u32,
            depth,
            missing_packets: missing.len() as u32,
        }
    }

    /// Pixels with at least one bit in a packet.
    fn pixels_of(&self, packet: usize) -> std::ops::Range<usize> {
        let bits = self.format.bits as usize;
        let start = packet * self.format.payload * 8;
        let end = start + self.format.payload_of(packet) * 8;
        start / bits..end.div_ceil(bits).min(WIDTH * HEIGHT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinect::calibration::Registration;
    use crate::kinect::registration::MAX_MM;
    use crate::kinect::registration::tests::{PLANE, identity_block};
    use crate::simulator::depth_encoder::pack;
    use firmware_config::kinect_models::{DEPTH_10, DEPTH_11};
    use proptest::prelude::*;

    #[test]
    fn pixels_of_a_missing_packet_have_no_value_and_no_others() {
        for format in [&DEPTH_11, &DEPTH_10] {
            let calibration = Calibration { zero_plane: PLANE, registration: identity_block(), start_lines: 0 };
            let mut decoder = DepthDecoder::new(&calibration, format, Pool::default());
            let mut packed = pack(&vec![700; WIDTH * HEIGHT], format.bits);
            let whole = decoder.decode(&packed, &[], 0);
            let start = 100 * format.payload;
            packed[start..start + format.payload].fill(0);
            let holed = decoder.decode(&packed, &[100], 0);
            let pixels =
                (start * 8 / format.bits as usize, ((start + format.payload) * 8).div_ceil(format.bits as usize));
            assert_eq!(holed.missing_packets, 1);
            let gone = whole.depth.iter().zip(&holed.depth).filter(|(a, b)| a != b).count();
            // Near the border of an image some have no place in the colour image anyway.
            assert!((pixels.1 - pixels.0 - 16..=pixels.1 - pixels.0).contains(&gone), "{}: {gone}", format.name);
            assert!(holed.depth.iter().all(|&mm| mm == 0 || mm == 887), "nothing invented");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn whatever_the_block(words in proptest::array::uniform29(any::<i32>()), bytes in proptest::collection::vec(any::<u8>(), 0..500),
                              start_lines: u16, missing in proptest::collection::vec(any::<u16>(), 0..3)) {
            let calibration = Calibration { zero_plane: PLANE, registration: Registration::from_words(words), start_lines };
            let frame = DepthDecoder::new(&calibration, &DEPTH_11, Pool::default()).decode(&bytes, &missing, 0);
            prop_assert!(frame.depth.len() == WIDTH * HEIGHT && frame.depth.iter().all(|&d| usize::from(d) < MAX_MM));
        }
    }
}
