//! Raw depth to millimetres, and the registration of depth to the colour camera, from the device's own calibration. The
//! arithmetic is that of libfreenect's registration.c, value for value.

use crate::kinect::calibration::{Calibration, Registration, ZeroPlane};
use firmware_config::kinect_models::StreamFormat;

/// Pixels per row of both cameras.
pub const WIDTH: usize = 640;
/// Rows.
pub const HEIGHT: usize = 480;
/// Raw values: 11 bits.
pub const RAW_VALUES: usize = 1 << 11;
/// The raw value that stands for "no depth".
pub const NO_DEPTH: u16 = RAW_VALUES as u16 - 1;
/// Depths of this many millimetres and more count as no depth.
pub const MAX_MM: usize = 10_000;
/// Horizontal positions are in 1/256 pixel.
pub const SUBPIXELS: i32 = 256;
/// OpenNI's constant, used in place of the device's own distance between infrared and colour camera, in cm.
const COLOR_BASELINE_CM: f32 = 2.4;

/// `[raw]` → (depth in mm, 0 = none; horizontal shift between the cameras at that depth in 1/256 pixel).
#[must_use]
pub fn depth_table(calibration: &Calibration, format: &StreamFormat) -> Vec<(u16, i32)> {
    let mut mm: Vec<u16> = raw_to_mm(&calibration.zero_plane)
        .iter()
        .map(|&mm| if mm > 0.0 && mm < MAX_MM as f64 { mm as u16 } else { 0 })
        .collect();
    mm[usize::from(NO_DEPTH)] = 0;
    if format.bits == 10 {
        mm[1023] = 0;
    }
    let shift = shift_table(&calibration.zero_plane);
    mm.iter().map(|&mm| (mm, shift[usize::from(mm)])).collect()
}

/// `[raw]` → depth in millimetres; negative beyond the pole of the formula.
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

/// `[mm]` → horizontal shift between the cameras in 1/256 pixel.
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
#[must_use]
pub fn registration_table(r: &Registration) -> Vec<[i32; 2]> {
    let w = |i: usize| i64::from(r.words()[i]);
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

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::kinect::calibration::REGISTRATION_VALUES;
    use firmware_config::kinect_models::DEPTH_11;

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
        Registration::from_words(words)
    }

    /// A registration that leaves every pixel where it is.
    pub(crate) fn identity_block() -> Registration {
        let mut words = [0; REGISTRATION_VALUES];
        (words[5], words[10]) = (-256, -256);
        Registration::from_words(words)
    }

    #[test]
    #[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: kinect/registration.txt")]
    fn equals_libfreenect_value_for_value() {
        let shared = ::tests::shared();
        let text = std::fs::read_to_string(shared.join("kinect/registration.txt")).unwrap();
        let (mm, shift, table) = (raw_to_mm(&PLANE), shift_table(&PLANE), registration_table(&real_block()));
        let mut compared = [0; 3];
        for line in text.lines().filter(|l| !l.starts_with('#')) {
            let words: Vec<&str> = line.split_whitespace().collect();
            let n: Vec<i64> = words[1..].iter().map(|w| w.parse().unwrap()).collect();
            match words[0] {
                // libfreenect stores 16 bits; the last value means no depth.
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
        let table = depth_table(&calibration, &DEPTH_11);
        let mm: Vec<u16> = table.iter().map(|(mm, _)| *mm).collect();
        assert_eq!(
            (mm[0], mm[300], mm[500], mm[700], mm[900], mm[1000], mm[1050]),
            (317, 437, 586, 887, 1824, 3864, 8767)
        );
        assert_eq!((mm[1054], mm[1055], mm[2047]), (9757, 0, 0));
        assert!(mm[1055..].iter().all(|&v| v == 0));
    }
}
