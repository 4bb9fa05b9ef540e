//! Depth pixels: unpacking, raw values to millimetres, and registration to the colour camera, from the device's own
//! calibration blocks. The arithmetic is that of libfreenect's registration.c, value for value.

use firmware_config::kinect_models::StreamFormat;
use recordings::types::{DepthFrame, TimestampNs};

/// Pixels per row of both cameras.
const WIDTH: usize = 640;
/// Rows.
const HEIGHT: usize = 480;
/// Raw values.
const RAW_VALUES: usize = 1 << 11;
/// Depths of this many millimetres and more are no values.
const MAX_MM: usize = 10_000;
/// Horizontal positions are in 1/256 pixel.
const SUBPIXELS: i32 = 256;
/// OpenNI's constant, which stands in for the device's own distance between infrared and colour camera, in cm.
const COLOR_BASELINE_CM: f32 = 2.4;

/// Zero-plane geometry (fixed parameters) and the raw offset: what turns raw values into millimetres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ZeroPlane {
    /// Distance from the emitter to the infrared camera, cm.
    pub emitter_cm: f32,
    /// Distance of the reference plane, cm.
    pub distance: f32,
    /// Size of a pixel at the reference plane, cm.
    pub pixel_size: f32,
    /// Constant shift, raw units × 4.
    pub const_shift: u16,
}

impl ZeroPlane {
    /// False for what no Kinect has.
    #[must_use]
    pub fn is_plausible(&self) -> bool {
        (1.0..30.0).contains(&self.emitter_cm)
            && (20.0..1000.0).contains(&self.distance)
            && (0.01..1.0).contains(&self.pixel_size)
            && self.const_shift < 512
    }
}

/// The 29 values of the registration block, in wire order.
pub const REGISTRATION_VALUES: usize = 29;

/// The coefficients of the registration block that are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Registration {
    words: [i32; REGISTRATION_VALUES],
}

impl Registration {
    /// From the 118-byte reply: status word, then 29 little-endian i32.
    #[must_use]
    pub fn from_reply(reply: &[u8]) -> Option<Self> {
        let data = reply.get(2..2 + 4 * REGISTRATION_VALUES)?;
        let mut words = [0; REGISTRATION_VALUES];
        for (word, bytes) in words.iter_mut().zip(data.chunks_exact(4)) {
            *word = i32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        }
        Some(Self { words })
    }

    /// From the values in wire order.
    #[must_use]
    pub fn from_words(words: [i32; REGISTRATION_VALUES]) -> Self {
        Self { words }
    }
}

/// Everything the device says of its own geometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    /// Raw to millimetres.
    pub zero_plane: ZeroPlane,
    /// Depth to colour.
    pub registration: Registration,
    /// Rows above the image that the table counts.
    pub start_lines: u16,
}

/// Depth in millimetres of each raw value: negative behind the formula's pole.
fn raw_to_mm(plane: &ZeroPlane) -> Vec<f64> {
    let (emitter, distance) = (f64::from(plane.emitter_cm), f64::from(plane.distance));
    (0..RAW_VALUES)
        .map(|raw| {
            let reference = (raw as f64 - 4.0 * f64::from(plane.const_shift)) / 4.0 - 0.375;
            let metric = reference * f64::from(plane.pixel_size);
            10.0 * (metric * distance / (emitter - metric) + distance)
        })
        .collect()
}

/// Horizontal shift in 1/256 pixel between the cameras at each depth in millimetres.
fn shift_table(plane: &ZeroPlane) -> Vec<i32> {
    let per_mm = 1.0 / (f64::from(plane.pixel_size) * 2.0 * 10.0);
    let baseline = f64::from(COLOR_BASELINE_CM) * per_mm * 10.0;
    let reference = f64::from(plane.distance) * per_mm * 10.0;
    (0..MAX_MM)
        .map(|mm| {
            let z = mm as f64 * per_mm;
            (f64::from(SUBPIXELS) * (baseline * (z - reference) / z + 0.375)) as i32
        })
        .collect()
}

/// Where each depth pixel falls in the colour image, at infinity: `[y * 640 + x]` → (x in 1/256 pixel, y).
fn registration_table(r: &Registration) -> Vec<[i32; 2]> {
    let w = |i: usize| i64::from(r.words[i]);
    let (ax, bx, cx, dx) = (w(1), w(2), w(3), w(4));
    let (ay, by, cy, dy) = (w(6), w(7), w(8), w(9));
    let first = |v: i64| sign_extended(v, 19) << 9;
    let second = |v: i64| sign_extended(v, 21) << 8;
    let third = |v: i64| sign_extended(v, 24) << 8;
    let (mut d_x, mut d_y) = (first(w(5)), first(w(10)));
    let (mut dx_dx, mut dx_dy, mut dy_dx, mut dy_dy) = (second(w(17)), second(w(18)), second(w(19)), second(w(20)));
    let (mut dxdx_dx, mut dydx_dx) = (third(w(21)), third(w(22)));
    let (mut dxdx_dy, mut dydx_dy) = (third(w(23)), third(w(24)));
    let (mut dydy_dx, mut dydy_dy) = (third(w(26)), third(w(28)));
    // Sums stay far below 2⁶³ for any block: each term is below 2⁴⁰, and there are 1120 steps of three orders.
    let mut table = Vec::with_capacity(WIDTH * HEIGHT);
    for y in 0..HEIGHT {
        dxdx_dx += cx;
        dx_dx += dydx_dx >> 8;
        dydx_dx += dx;
        d_x += dy_dx >> 6;
        dy_dx += dydy_dx >> 8;
        dydy_dx += bx;
        dxdx_dy += cy;
        dx_dy += dydx_dy >> 8;
        dydx_dy += dy;
        d_y += dy_dy >> 6;
        dy_dy += dydy_dy >> 8;
        dydy_dy += by;
        let (mut x_1, mut x_2, mut x_3) = (d_x, dx_dx, dxdx_dx);
        let (mut y_1, mut y_2, mut y_3) = (d_y, dx_dy, dxdx_dy);
        for x in 0..WIDTH {
            let new_x = x as f64 + x_1 as f64 / 131_072.0 + 1.0;
            let new_y = y as f64 + y_1 as f64 / 131_072.0 + 1.0;
            let inside = new_x >= 0.0 && new_y >= 0.0 && new_x < WIDTH as f64 && new_y < HEIGHT as f64;
            let place = if inside { new_x } else { 2.0 * WIDTH as f64 };
            table.push([(place * f64::from(SUBPIXELS)) as i32, new_y as i32]);
            x_1 += x_2 >> 6;
            x_2 += x_3 >> 8;
            x_3 += ax;
            y_1 += y_2 >> 6;
            y_2 += y_3 >> 8;
            y_3 += ay;
        }
    }
    table
}

/// The lowest `bits` bits of `v` as a two's complement number.
fn sign_extended(v: i64, bits: u32) -> i64 {
    (v << (64 - bits)) >> (64 - bits)
}

/// Unpacks pixels of `BITS` bits, most significant bit first, without padding.
fn unpack<const BITS: u32>(packed: &[u8], raw: &mut Vec<u16>) {
    raw.clear();
    // Eight pixels fill `BITS` bytes.
    for group in packed.chunks_exact(BITS as usize) {
        let mut window = [0u8; 16];
        window[16 - BITS as usize..].copy_from_slice(group);
        let bits = u128::from_be_bytes(window);
        for pixel in 0..8 {
            raw.push((bits >> (BITS * (7 - pixel))) as u16 & ((1 << BITS) - 1));
        }
    }
}

/// Turns packed raw frames into depth images of the colour camera.
pub struct DepthDecoder {
    format: &'static StreamFormat,
    /// Raw value to millimetres (0 = none) and the shift at that depth.
    lookup: Vec<(u16, i32)>,
    table: Vec<[i32; 2]>,
    start_lines: usize,
    raw: Vec<u16>,
}

impl DepthDecoder {
    /// For one device and format.
    #[must_use]
    pub fn new(calibration: &Calibration, format: &'static StreamFormat) -> Self {
        let mut mm: Vec<u16> = raw_to_mm(&calibration.zero_plane)
            .iter()
            .map(|&mm| if mm > 0.0 && mm < MAX_MM as f64 { mm as u16 } else { 0 })
            .collect();
        mm[RAW_VALUES - 1] = 0;
        if format.bits == 10 {
            mm[1023] = 0;
        }
        let shift = shift_table(&calibration.zero_plane);
        let lookup = mm.iter().map(|&mm| (mm, shift[usize::from(mm)])).collect();
        Self {
            format,
            lookup,
            table: registration_table(&calibration.registration),
            start_lines: usize::from(calibration.start_lines),
            raw: Vec::with_capacity(WIDTH * HEIGHT),
        }
    }

    /// Decodes and registers a frame; `missing` names packets that are not there, whose pixels have no value.
    #[must_use]
    pub fn decode(&mut self, packed: &[u8], missing: &[u16], timestamp_ns: TimestampNs) -> DepthFrame {
        match self.format.bits {
            10 => unpack::<10>(packed, &mut self.raw),
            _ => unpack::<11>(packed, &mut self.raw),
        }
        self.raw.resize(WIDTH * HEIGHT, RAW_VALUES as u16 - 1);
        for &packet in missing {
            let pixels = self.pixels_of(usize::from(packet));
            self.raw.get_mut(pixels).into_iter().flatten().for_each(|p| *p = RAW_VALUES as u16 - 1);
        }
        let mut depth = vec![0u16; WIDTH * HEIGHT];
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

    /// Pixels of which at least one bit is in a packet.
    fn pixels_of(&self, packet: usize) -> std::ops::Range<usize> {
        let bits = self.format.bits as usize;
        let start = packet * self.format.payload * 8;
        let end = start + self.format.payload_of(packet) * 8;
        start / bits..end.div_ceil(bits).min(WIDTH * HEIGHT)
    }
}

/// The inverse, for a simulated device.
pub mod encode {
    use super::DepthDecoder;
    use super::HEIGHT;
    use super::RAW_VALUES;
    use super::SUBPIXELS;
    use super::WIDTH;

    impl DepthDecoder {
        /// A packed raw frame that this decoder turns back into `depth` (mm, 640×480), as far as raw values are that
        /// fine and no surface hides another from the infrared camera.
        #[must_use]
        pub fn encode(&self, depth: &[u16]) -> Vec<u8> {
            let mut raw = vec![RAW_VALUES as u16 - 1; WIDTH * HEIGHT];
            let raw_of = self.nearest_raw();
            for (i, &mm) in depth.iter().enumerate().take(WIDTH * HEIGHT) {
                let Some(&value) = raw_of.get(usize::from(mm)).filter(|r| **r != RAW_VALUES as u16 - 1) else {
                    continue;
                };
                let (_, shift) = self.lookup[usize::from(value)];
                let (row, column) = (i / WIDTH, (i % WIDTH) as i32);
                // The table of a simulated device is the identity in both directions.
                let source =
                    (column * SUBPIXELS).saturating_sub(shift).saturating_add(SUBPIXELS - 1).div_euclid(SUBPIXELS);
                if (0..WIDTH as i32).contains(&source) {
                    let target = &mut raw[row * WIDTH + source as usize];
                    // Smaller raw values are nearer.
                    *target = (*target).min(value);
                }
            }
            pack(&raw, self.format.bits)
        }

        /// `[mm]` → raw value of the nearest depth; 2047 where there is none within range.
        fn nearest_raw(&self) -> Vec<u16> {
            let none = RAW_VALUES as u16 - 1;
            let values: Vec<(u16, u16)> =
                (0..none).map(|r| (self.lookup[usize::from(r)].0, r)).filter(|(mm, _)| *mm > 0).collect();
            let mut table = vec![none; super::MAX_MM];
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
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use firmware_config::kinect_models::{DEPTH_10, DEPTH_11};
    use proptest::prelude::*;

    pub(crate) const PLANE: ZeroPlane =
        ZeroPlane { emitter_cm: 7.5, distance: 120.0, pixel_size: 0.1042, const_shift: 200 };

    /// A unit's registration block; what is unused is 0.
    pub(crate) fn real_block() -> Registration {
        let mut words = [0; REGISTRATION_VALUES];
        for (i, v) in [
            (1, 1681),
            (2, -5),
            (3, 1),
            (4, 468),
            (5, 3145),
            (6, -8),
            (7, 2647),
            (8, 599),
            (9, 11),
            (10, 6771),
            (17, 2_095_911),
            (18, 682),
            (19, 651),
            (20, 2_096_067),
            (21, 134_215_532),
            (22, 134_217_276),
            (23, 134_217_118),
            (24, 134_216_919),
            (26, 134_217_176),
            (28, 134_215_010),
        ] {
            words[i] = v;
        }
        Registration { words }
    }

    #[test]
    fn equals_libfreenect_value_for_value() {
        let Some(shared) = std::env::var_os("LUMISCAN_SHARED") else {
            println!("skipped: LUMISCAN_SHARED is not set (folder with kinect/registration.txt)");
            return;
        };
        let text = std::fs::read_to_string(std::path::Path::new(&shared).join("kinect/registration.txt")).unwrap();
        let (mm, shift, table) = (raw_to_mm(&PLANE), shift_table(&PLANE), registration_table(&real_block()));
        let mut compared = [0; 3];
        for line in text.lines().filter(|l| !l.starts_with('#')) {
            let words: Vec<&str> = line.split_whitespace().collect();
            let n: Vec<i64> = words[1..].iter().map(|w| w.parse().unwrap()).collect();
            match words[0] {
                // libfreenect stores 16 bits; the last value is none.
                "mm" if n[0] == 2047 => assert_eq!(n[1], 0),
                "mm" => assert_eq!(i64::from(mm[n[0] as usize] as i64 as u16), n[1], "{line}"),
                "shift" => assert_eq!(i64::from(shift[n[0] as usize]), n[1], "{line}"),
                "reg" => {
                    let [x, y] = table[n[1] as usize * WIDTH + n[0] as usize];
                    assert_eq!([i64::from(x), i64::from(y)], [n[2], n[3]], "{line}");
                }
                other => panic!("{other}"),
            }
            compared[["mm", "shift", "reg"].iter().position(|k| *k == words[0]).unwrap()] += 1;
        }
        assert_eq!(compared, [2048, 200, 80]);
    }

    #[test]
    fn beyond_ten_metres_and_behind_the_pole_there_is_no_value() {
        let calibration = Calibration { zero_plane: PLANE, registration: real_block(), start_lines: 0 };
        let decoder = DepthDecoder::new(&calibration, &DEPTH_11);
        let mm: Vec<u16> = decoder.lookup.iter().map(|(mm, _)| *mm).collect();
        assert_eq!(
            (mm[0], mm[300], mm[500], mm[700], mm[900], mm[1000], mm[1050]),
            (317, 437, 586, 887, 1824, 3864, 8767)
        );
        assert_eq!((mm[1054], mm[1055], mm[2047]), (9757, 0, 0));
        assert!(mm[1055..].iter().all(|&v| v == 0));
    }

    #[test]
    fn packed_pixels_of_known_bits() {
        let mut raw = Vec::new();
        unpack::<11>(&[0b1000_0000, 0b0010_0000, 0b0000_1000, 0, 0, 0, 0, 0, 0, 0b0000_0111, 0xff], &mut raw);
        assert_eq!(raw, [1025, 2, 0, 0, 0, 0, 0, 2047]);
        unpack::<10>(&[0x80, 0x20, 0x0c, 0x03, 0xff, 0, 0, 0, 0, 1], &mut raw);
        assert_eq!(raw, [512, 512, 768, 1023, 0, 0, 0, 1]);
    }

    #[test]
    fn pixels_of_a_missing_packet_have_no_value_and_no_others() {
        for format in [&DEPTH_11, &DEPTH_10] {
            let calibration = Calibration { zero_plane: PLANE, registration: identity_block(), start_lines: 0 };
            let mut decoder = DepthDecoder::new(&calibration, format);
            let mut packed = encode::pack(&vec![700; WIDTH * HEIGHT], format.bits);
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

    /// A registration that leaves every pixel where it is.
    pub(crate) fn identity_block() -> Registration {
        let mut words = [0; REGISTRATION_VALUES];
        (words[5], words[10]) = (-256, -256);
        Registration { words }
    }

    #[test]
    fn encoding_is_undone_by_decoding() {
        let calibration = Calibration { zero_plane: PLANE, registration: identity_block(), start_lines: 0 };
        let mut decoder = DepthDecoder::new(&calibration, &DEPTH_11);
        let depth: Vec<u16> =
            (0..WIDTH * HEIGHT).map(|i| if i % 97 == 0 { 0 } else { 900 + (i / WIDTH) as u16 }).collect();
        let packed = decoder.encode(&depth);
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

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn unpacking_undoes_packing(raw in proptest::collection::vec(0u16..1024, 8..200)) {
            let raw = &raw[..raw.len() / 8 * 8];
            let mut out = Vec::new();
            unpack::<10>(&encode::pack(raw, 10), &mut out);
            prop_assert_eq!(&out, raw);
            let wide: Vec<u16> = raw.iter().map(|r| r * 2 + 1).collect();
            unpack::<11>(&encode::pack(&wide, 11), &mut out);
            prop_assert_eq!(&out, &wide);
        }

        #[test]
        fn whatever_the_block(words in proptest::array::uniform29(any::<i32>()), bytes in proptest::collection::vec(any::<u8>(), 0..500),
                              start_lines: u16, missing in proptest::collection::vec(any::<u16>(), 0..3)) {
            let calibration = Calibration { zero_plane: PLANE, registration: Registration { words }, start_lines };
            let frame = DepthDecoder::new(&calibration, &DEPTH_11).decode(&bytes, &missing, 0);
            prop_assert!(frame.depth.len() == WIDTH * HEIGHT && frame.depth.iter().all(|&d| usize::from(d) < MAX_MM));
        }
    }
}
