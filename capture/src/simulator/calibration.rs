//! The geometry that the simulated Kinect reports of itself.

use crate::kinect::calibration::{Calibration, REGISTRATION_VALUES, Registration, ZeroPlane};
use firmware_config::kinect_models::Model;

/// Geometry of a typical unit.
pub const PLANE: ZeroPlane = ZeroPlane { emitter_cm: 7.5, distance: 120.0, pixel_size: 0.1042, const_shift: 200 };

/// The calibration that it reports.
#[must_use]
pub fn calibration() -> Calibration {
    Calibration { zero_plane: PLANE, registration: Registration::from_words(REGISTRATION_WORDS), start_lines: 0 }
}

/// The tables add one pixel, which this block subtracts, so that only the shift by depth remains: a depth image of the colour
/// camera can be encoded exactly.
pub const REGISTRATION_WORDS: [i32; REGISTRATION_VALUES] = {
    let mut words = [0; REGISTRATION_VALUES];
    words[5] = -256;
    words[10] = -256;
    words
};

/// The reply to the command for fixed parameters, in words.
pub fn fixed_parameters(model: Model) -> Vec<u16> {
    let mut bytes = vec![0u8; model.fixed_parameter_bytes()];
    for (i, value) in [PLANE.emitter_cm, 2.3, PLANE.distance, PLANE.pixel_size].iter().enumerate() {
        bytes[94 + 4 * i..98 + 4 * i].copy_from_slice(&value.to_le_bytes());
    }
    bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect()
}
