//! The geometry that a Kinect reports of itself.

/// Zero-plane geometry (fixed parameters) and raw offset, which turn raw values into millimetres.
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
    /// False for values that no Kinect has.
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

/// The registration block.
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

    /// The values in wire order.
    #[must_use]
    pub fn words(&self) -> &[i32; REGISTRATION_VALUES] {
        &self.words
    }

    /// From the values in wire order.
    #[must_use]
    pub fn from_words(words: [i32; REGISTRATION_VALUES]) -> Self {
        Self { words }
    }
}

/// A device's geometry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    /// Raw to millimetres.
    pub zero_plane: ZeroPlane,
    /// Depth to colour.
    pub registration: Registration,
    /// Rows above the image in the registration table.
    pub start_lines: u16,
}
