//! USB packets to frames: assembly, decoding and time stamps. A live Kinect and a recording of packets use the same code, so
//! a recording replays bit for bit.

use crate::kinect::clock::DeviceClock;
use crate::kinect::depth_decoder::DepthDecoder;
use crate::kinect::packet_assembler::{Assembled, Assembler, PacketStats};
use crate::kinect::protocol::{CONTROL_IN, CONTROL_OUT, KinectError, StreamParameters};
use firmware_config::kinect_models::{BAYER_SXGA, BAYER_VGA, DEPTH_10, DEPTH_11, StreamFormat};
use recordings::recording::Event;
use recordings::types::{ColorEncoding, ColorFrame};

/// Counters of both streams.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DecoderStats {
    /// Depth.
    pub depth: PacketStats,
    /// Colour.
    pub color: PacketStats,
    /// Packets of unknown endpoints.
    pub strays: u64,
}

/// Turns packets into frames.
#[derive(Default)]
pub struct Decoder {
    parameters: StreamParameters,
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
    /// Takes a packet: first the control traffic, which defines the streams' formats and calibration, then the streams.
    ///
    /// # Errors
    /// A stream packet arrived, but the calibration before it is missing or implausible.
    pub fn push(
        &mut self,
        endpoint: u8,
        host_ns: i64,
        data: &[u8],
        sink: &mut impl FnMut(Event),
    ) -> Result<(), KinectError> {
        if matches!(endpoint, CONTROL_OUT | CONTROL_IN) {
            self.parameters.observe(endpoint, data);
            return Ok(());
        }
        let streams = match &mut self.streams {
            Some(streams) => streams,
            none => none.insert(Streams::new(&self.parameters)?),
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

    /// Ends the streams: incomplete last frames are counted as lost.
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
    fn new(parameters: &StreamParameters) -> Result<Self, KinectError> {
        let calibration = parameters.calibration()?;
        let depth_format = if parameters.is_depth_10() { &DEPTH_10 } else { &DEPTH_11 };
        let color_format = if parameters.is_color_sxga() { &BAYER_SXGA } else { &BAYER_VGA };
        Ok(Self {
            depth: Assembler::new(depth_format),
            decoder: DepthDecoder::new(&calibration, depth_format),
            color: Assembler::new(color_format),
            color_format,
        })
    }
}
