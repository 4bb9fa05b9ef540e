//! USB packets to frames: assembly, decoding and time stamps. A live Kinect and a recording of packets use the same code, so
//! a recording replays bit for bit.

use crate::kinect::buffers::{Buffers, Pool};
use crate::kinect::clock::DeviceClock;
use crate::kinect::depth_decoder::DepthDecoder;
use crate::kinect::frame_queue::StreamKind;
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
}

/// Turns packets into frames.
#[derive(Default)]
pub struct Decoder {
    parameters: StreamParameters,
    streams: Option<Streams>,
}

struct Streams {
    depth: Assembler,
    color: Assembler,
    frames: FrameDecoder,
}

/// Turns assembled frames into images with time stamps.
pub struct FrameDecoder {
    clock: DeviceClock,
    depth: DepthDecoder,
    color_format: &'static StreamFormat,
    buffers: Buffers,
}

impl FrameDecoder {
    /// For streams that were started with these parameters. Frames are decoded into `buffers`, and what is done with goes back
    /// there.
    ///
    /// # Errors
    /// The calibration is missing or implausible.
    pub fn new(parameters: &StreamParameters, buffers: Buffers) -> Result<Self, KinectError> {
        let calibration = parameters.calibration()?;
        let (depth_format, color_format) = formats(parameters);
        let depth = DepthDecoder::new(&calibration, depth_format, buffers.depth.clone());
        Ok(Self { clock: DeviceClock::default(), depth, color_format, buffers })
    }

    /// Decodes a frame; `host_ns` is the time of arrival of its last packet.
    pub fn decode(&mut self, stream: StreamKind, host_ns: i64, frame: Assembled) -> Event {
        let time = self.clock.unwrap(frame.ticks, host_ns);
        match stream {
            StreamKind::Depth => {
                let decoded = self.depth.decode(&frame.bytes, &frame.missing, time);
                self.buffers.packed.give(frame.bytes);
                Event::Depth(decoded)
            }
            StreamKind::Color => Event::Color(ColorFrame {
                timestamp_ns: time,
                width: self.color_format.width,
                height: self.color_format.height,
                encoding: ColorEncoding::BayerGrbg,
                missing_packets: frame.missing.len() as u32,
                bytes: frame.bytes,
            }),
        }
    }
}

/// Formats of depth and colour.
fn formats(parameters: &StreamParameters) -> (&'static StreamFormat, &'static StreamFormat) {
    let depth = if parameters.is_depth_10() { &DEPTH_10 } else { &DEPTH_11 };
    let color = if parameters.is_color_sxga() { &BAYER_SXGA } else { &BAYER_VGA };
    (depth, color)
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
        let Streams { depth, color, frames } = streams;
        if endpoint == DEPTH_11.endpoint {
            depth.push(data, &mut |f| sink(frames.decode(StreamKind::Depth, host_ns, f)));
        } else if endpoint == BAYER_VGA.endpoint {
            color.push(data, &mut |f| sink(frames.decode(StreamKind::Color, host_ns, f)));
        }
        Ok(())
    }

    /// Counters.
    #[must_use]
    pub fn stats(&self) -> DecoderStats {
        let (depth, color) =
            self.streams.as_ref().map_or_else(Default::default, |s| (s.depth.stats(), s.color.stats()));
        DecoderStats { depth, color }
    }
}

impl Streams {
    fn new(parameters: &StreamParameters) -> Result<Self, KinectError> {
        let (depth, color) = formats(parameters);
        let packed = Pool::new(depth.frame_bytes(), 0, 1);
        let frames = FrameDecoder::new(parameters, Buffers { packed: packed.clone(), ..Buffers::default() })?;
        Ok(Self { depth: Assembler::pooled(depth, packed), color: Assembler::new(color), frames })
    }
}
