//! The geometry that the simulated Kinect reports of itself.

use crate::kinect::calibration::{Calibration, REGISTRATION_VALUES, Registration, ZeroPlane};
use firmware_config::kinect_models::Model;

/// A typical unit.
pub const PLANE: ZeroPlane = ZeroPlane { emitter_cm: 7.5, distance: 120.0, pixel_size: 0.1042, const_shift: 200 };

/// What it says of its own geometry.
pub fn calibration() -> Calibration {
    Calibration { zero_plane: PLANE, registration: Registration::from_words(REGISTRATION_WORDS), start_lines: 0 }
}

/// Moves every pixel back by the one that the tables are ahead, so that only the shift by depth is left: what the
/// colour camera shall see can be put into the depth camera exactly.
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
