//! Kinect V1 model tables: USB identities, stream formats, registers. Facts about the hardware, not settings.

/// Microsoft.
pub const VENDOR: u16 = 0x045e;

/// A camera that can be driven.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Model {
    /// Xbox 360, first edition: LED, tilt and accelerometer on a motor device of its own.
    K1414,
    /// Xbox 360, later edition: LED, tilt and accelerometer behind the audio device, once that has firmware.
    K1473,
    /// Kinect for Windows V1: streams on alternate setting 1.
    K1517,
}

impl Model {
    /// The model of a camera, from its product id and `bcdDevice` (0x010b means 1414, any other value the 1473 family).
    #[must_use]
    pub fn of_camera(product: u16, device_release: u16) -> Option<Self> {
        match (product, device_release) {
            (0x02ae, 0x010b) => Some(Self::K1414),
            (0x02ae, _) => Some(Self::K1473),
            (0x02bf, _) => Some(Self::K1517),
            _ => None,
        }
    }

    /// Common name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::K1414 => "Kinect V1 (1414)",
            Self::K1473 => "Kinect V1 (1473)",
            Self::K1517 => "Kinect for Windows V1 (1517)",
        }
    }

    /// Alternate setting of interface 0 that streams, where it is not the only one.
    #[must_use]
    pub fn alternate_setting(self) -> Option<u8> {
        (self == Self::K1517).then_some(1)
    }

    /// Bytes of the reply to the fixed-parameters command.
    #[must_use]
    pub fn fixed_parameter_bytes(self) -> usize {
        if self == Self::K1414 { 322 } else { 334 }
    }
}

/// Role of a USB device of the vendor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Depth and colour.
    Camera,
    /// LED, tilt and accelerometer of a 1414.
    Motor,
    /// Microphones; LED, tilt and accelerometer of the other models.
    Audio,
    /// A Kinect V2, which has another protocol.
    KinectV2,
}

/// Role of a device, from its vendor and product id; `None` for others, such as hubs (045e:02c2, 0409:005a).
#[must_use]
pub fn part_of(vendor: u16, product: u16) -> Option<Part> {
    match (vendor, product) {
        (VENDOR, 0x02ae | 0x02bf) => Some(Part::Camera),
        (VENDOR, 0x02b0) => Some(Part::Motor),
        (VENDOR, 0x02ad | 0x02be | 0x02c3 | 0x02bb) => Some(Part::Audio),
        (VENDOR, 0x02d9 | 0x02d8 | 0x02c4) => Some(Part::KinectV2),
        _ => None,
    }
}

/// Endpoint of colour and infrared.
pub const VIDEO_ENDPOINT: u8 = 0x81;
/// Endpoint of depth.
pub const DEPTH_ENDPOINT: u8 = 0x82;
/// Bytes of a stream packet's header.
pub const PACKET_HEADER: usize = 12;
/// Ticks per second of the time stamps in the packet headers.
pub const CLOCK_HZ: u32 = 60_000_000;
/// Largest isochronous packet where the system does not report it, bytes.
pub const MAX_ISO_PACKET: usize = 1920;
/// Transfers in flight per endpoint.
pub const TRANSFERS: usize = 16;
/// Packets per transfer (a multiple of 8): 16 × 16 packets of 125 µs buffer 32 ms.
pub const PACKETS_PER_TRANSFER: usize = 16;

/// One stream in one format: its packets and the registers that start it.
#[derive(Debug, PartialEq, Eq)]
pub struct StreamFormat {
    /// Common name.
    pub name: &'static str,
    /// Endpoint address.
    pub endpoint: u8,
    /// High nibble of the packets' flags.
    pub stream_id: u8,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bits per pixel.
    pub bits: u32,
    /// Payload bytes of every packet but the last of a frame.
    pub payload: usize,
    /// Frames per second.
    pub fps: u32,
    /// Registers to write, in this order, to start the stream; isochronous transfers are submitted before. Each stream is
    /// stopped first: a killed session may have left it running in another mode.
    pub start: &'static [(u16, u16)],
    /// Registers to write to stop it.
    pub stop: &'static [(u16, u16)],
}

impl StreamFormat {
    /// Bytes per frame.
    #[must_use]
    pub const fn frame_bytes(&self) -> usize {
        (self.width * self.height * self.bits / 8) as usize
    }

    /// Packets per frame.
    #[must_use]
    pub const fn packets(&self) -> usize {
        self.frame_bytes().div_ceil(self.payload)
    }

    /// Payload bytes of packet `index` of a frame.
    #[must_use]
    pub const fn payload_of(&self, index: usize) -> usize {
        let left = self.frame_bytes().saturating_sub(index * self.payload);
        if left < self.payload { left } else { self.payload }
    }

    /// Ticks of the 60 MHz clock between two frames.
    #[must_use]
    pub const fn period_ticks(&self) -> u32 {
        CLOCK_HZ / self.fps
    }
}

/// Depth, 640×480, 11 bit.
pub static DEPTH_11: StreamFormat = StreamFormat {
    name: "depth 11 bit",
    endpoint: DEPTH_ENDPOINT,
    stream_id: 0x70,
    width: 640,
    height: 480,
    bits: 11,
    payload: 1748,
    fps: 30,
    start: &[(0x105, 0), (0x06, 0), (0x12, 3), (0x13, 1), (0x14, 0x1e), (0x06, 2), (0x17, 0)],
    stop: &[(0x06, 0)],
};

/// Depth, 640×480, 10 bit.
pub static DEPTH_10: StreamFormat = StreamFormat {
    name: "depth 10 bit",
    endpoint: DEPTH_ENDPOINT,
    stream_id: 0x70,
    width: 640,
    height: 480,
    bits: 10,
    payload: 1748,
    fps: 30,
    start: &[(0x105, 0), (0x06, 0), (0x12, 2), (0x13, 1), (0x14, 0x1e), (0x06, 2), (0x17, 0)],
    stop: &[(0x06, 0)],
};

/// Colour, 640×480 Bayer mosaic.
pub static BAYER_VGA: StreamFormat = StreamFormat {
    name: "colour 640x480",
    endpoint: VIDEO_ENDPOINT,
    stream_id: 0x80,
    width: 640,
    height: 480,
    bits: 8,
    payload: 1908,
    fps: 30,
    start: &[(0x05, 0), (0x0c, 0), (0x0d, 1), (0x0e, 0x1e), (0x05, 1), (0x47, 0)],
    stop: &[(0x05, 0)],
};

/// Colour, 1280×1024 Bayer mosaic; requested at 15 frames per second, delivered at about 10.
pub static BAYER_SXGA: StreamFormat = StreamFormat {
    name: "colour 1280x1024",
    endpoint: VIDEO_ENDPOINT,
    stream_id: 0x80,
    width: 1280,
    height: 1024,
    bits: 8,
    payload: 1908,
    fps: 10,
    start: &[(0x05, 0), (0x0c, 0), (0x0d, 2), (0x0e, 0x0f), (0x05, 1), (0x47, 0)],
    stop: &[(0x05, 0)],
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_and_packets_are_those_of_the_hardware() {
        for (format, bytes, packets, last) in [
            (&DEPTH_11, 422_400, 242, 1132),
            (&DEPTH_10, 384_000, 220, 1188),
            (&BAYER_VGA, 307_200, 162, 12),
            (&BAYER_SXGA, 1_310_720, 687, 1832),
        ] {
            let figures = (format.frame_bytes(), format.packets(), format.payload_of(format.packets() - 1));
            assert_eq!(figures, (bytes, packets, last), "{}", format.name);
            assert_eq!(format.payload_of(0) + PACKET_HEADER, if format.stream_id == 0x70 { 1760 } else { 1920 });
        }
    }

    #[test]
    fn models_by_their_ids() {
        assert_eq!(Model::of_camera(0x02ae, 0x010b), Some(Model::K1414));
        assert_eq!(Model::of_camera(0x02ae, 0x0111), Some(Model::K1473));
        assert_eq!(Model::of_camera(0x02bf, 0x010b), Some(Model::K1517));
        assert_eq!(Model::of_camera(0x02b0, 0x010b), None);
        assert_eq!(part_of(VENDOR, 0x02c2), None);
        assert_eq!(part_of(0x0409, 0x02ae), None);
    }
}
