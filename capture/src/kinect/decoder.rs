//! Everything after USB: packets in, frames out. A live Kinect and a recording of packets go through the same code, so
//! that a recording replays bit for bit.

use crate::kinect::clock::DeviceClock;
use crate::kinect::depth_decoder::DepthDecoder;
use crate::kinect::packet_assembler::{Assembled, Assembler, PacketStats};
use crate::kinect::protocol::{CONTROL_IN, CONTROL_OUT, KinectError, Said};
use firmware_config::kinect_models::{BAYER_SXGA, BAYER_VGA, DEPTH_10, DEPTH_11, StreamFormat};
use recordings::recording::Event;
use recordings::types::{ColorEncoding, ColorFrame};

/// What came of both streams.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DecoderStats {
    /// Depth.
    pub depth: PacketStats,
    /// Colour.
    pub color: PacketStats,
    /// Packets of no known endpoint.
    pub strays: u64,
}

/// Turns packets into frames.
#[derive(Default)]
pub struct Decoder {
    said: Said,
    clock: DeviceClock,
    streams: Option<Streams>,
    strays: u64,
}

struct Streams {
    depth: Assembler,
    decoder: DepthDecoder,
    color: Assembler,
    color_format: &'static StreamFormat,
}

impl Decoder {
    /// Takes a packet: control traffic first, which says how the streams are to be read, then theirs.
    ///
    /// # Errors
    /// A stream packet came, but the calibration before it is missing or makes no sense.
    pub fn push(
        &mut self,
        endpoint: u8,
        host_ns: i64,
        data: &[u8],
        sink: &mut impl FnMut(Event),
    ) -> Result<(), KinectError> {
        if matches!(endpoint, CONTROL_OUT | CONTROL_IN) {
            self.said.hear(endpoint, data);
            return Ok(());
        }
        let streams = match &mut self.streams {
            Some(streams) => streams,
            none => none.insert(Streams::new(&self.said)?),
        };
        let clock = &mut self.clock;
        if endpoint == DEPTH_11.endpoint {
            let decoder = &mut streams.decoder;
            streams.depth.push(data, &mut |f: Assembled| {
                sink(Event::Depth(decoder.decode(&f.bytes, &f.missing, clock.unwrap(f.ticks, host_ns))));
            });
        } else if endpoint == BAYER_VGA.endpoint {
            let format = streams.color_format;
            streams.color.push(data, &mut |f: Assembled| {
                sink(Event::Color(ColorFrame {
                    timestamp_ns: clock.unwrap(f.ticks, host_ns),
                    width: format.width,
                    height: format.height,
                    encoding: ColorEncoding::BayerGrbg,
                    missing_packets: f.missing.len() as u32,
                    bytes: f.bytes,
                }));
            });
        } else {
            self.strays += 1;
        }
        Ok(())
    }

    /// The streams ended: half frames are given up and counted.
    pub fn end(&mut self) {
        if let Some(streams) = &mut self.streams {
            streams.depth.end();
            streams.color.end();
        }
    }

    /// Counters.
    #[must_use]
    pub fn stats(&self) -> DecoderStats {
        let (depth, color) =
            self.streams.as_ref().map_or_else(Default::default, |s| (s.depth.stats(), s.color.stats()));
        DecoderStats { depth, color, strays: self.strays }
    }
}

impl Streams {
    fn new(said: &Said) -> Result<Self, KinectError> {
        let calibration = said.calibration()?;
        let depth_format = if said.is_depth_10() { &DEPTH_10 } else { &DEPTH_11 };
        let color_format = if said.is_color_sxga() { &BAYER_SXGA } else { &BAYER_VGA };
        Ok(Self {
            depth: Assembler::new(depth_format),
            decoder: DepthDecoder::new(&calibration, depth_format),
            color: Assembler::new(color_format),
            color_format,
        })
    }
}
