//! Checks a recording of the test pattern of the simulated Kinect 1414 (`tests/uml.sh`): every pixel that arrived, and the
//! time stamps.
//!
//!     cargo run -p tests --example usb_pattern -- RECORDING
//!
//! Prints the frames of each stream, and how many of them are whole; ends with 1 if a pixel is wrong.

use firmware_config::kinect_models::{BAYER_VGA, DEPTH_11, PACKET_HEADER, StreamFormat};
use recordings::recording::{Event, RecordingReader};
use std::path::Path;

type Outcome = Result<(), Box<dyn std::error::Error>>;

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
/// Depth frames `n` and `n + DEPTH_PERIOD` are equal, but for the pixel that holds `n`.
const DEPTH_PERIOD: usize = 120;

/// Raw 11-bit disparity of depth frame `n`, packed; pixel 0 holds `n`, the last columns no depth.
fn depth_frame(n: usize) -> Vec<u8> {
    let raw = (0..WIDTH * HEIGHT).map(|i| match (i % WIDTH, i / WIDTH) {
        (0, 0) => n & 0x3ff,
        (632.., _) => 2047,
        (x, y) => 400 + (x * 3 + y * 2 + n * 5) % 600,
    });
    let (mut bytes, mut bits, mut held) = (Vec::with_capacity(DEPTH_11.frame_bytes()), 0u32, 0);
    for value in raw {
        bits = bits << 11 | value as u32;
        held += 11;
        while held >= 8 {
            held -= 8;
            bytes.push((bits >> held) as u8);
        }
    }
    bytes
}

/// The mosaic of colour frame `n`, which its first two pixels hold.
fn color_frame(n: usize) -> Vec<u8> {
    let mut bytes: Vec<u8> = (0..WIDTH * HEIGHT).map(|i| (i % WIDTH * 7 + i / WIDTH * 13 + n * 3) as u8).collect();
    bytes[..2].copy_from_slice(&(n as u16).to_le_bytes());
    bytes
}

/// Packets of one stream, each beside what it should hold.
struct PacketCheck {
    format: &'static StreamFormat,
    expected: fn(usize) -> Vec<u8>,
    number_of: fn(&[u8]) -> usize,
    frame: Option<(usize, Vec<u8>)>,
    index: usize,
    sequence: u8,
    received: usize,
    frames: usize,
    whole: usize,
}

impl PacketCheck {
    fn new(format: &'static StreamFormat, expected: fn(usize) -> Vec<u8>, number_of: fn(&[u8]) -> usize) -> Self {
        Self { format, expected, number_of, frame: None, index: 0, sequence: 0, received: 0, frames: 0, whole: 0 }
    }

    fn take(&mut self, packet: &[u8]) -> Outcome {
        let (header, payload) = packet.split_at_checked(PACKET_HEADER).ok_or("a short packet")?;
        let steps = usize::from(header[5].wrapping_sub(self.sequence));
        self.sequence = header[5];
        let packets = self.format.packets();
        match (header[3] & 0x0f, &self.frame) {
            (1, _) => self.begin((self.number_of)(payload), 0),
            (_, None) => return Ok(()),
            // The first packet of the frame is missing.
            (_, Some((n, _))) if self.index + steps >= packets => self.begin(n + 1, self.index + steps - packets),
            _ => self.index += steps,
        }
        self.received += 1;
        self.whole += usize::from(self.received == packets);
        let start = self.index * self.format.payload;
        let Some((n, frame)) = &self.frame else { return Ok(()) };
        let here = frame.get(start..start + payload.len());
        if here != Some(payload) {
            return Err(format!("{} frame {n}: packet {} is wrong", self.format.name, self.index).into());
        }
        Ok(())
    }

    fn begin(&mut self, number: usize, index: usize) {
        self.frame = Some((number, (self.expected)(number)));
        (self.index, self.received) = (index, 0);
        self.frames += 1;
    }
}

/// Frames: colour beside the pattern; depth, which is in millimetres and registered, beside the frame of a period before.
#[derive(Default)]
struct FrameCheck {
    depth: Vec<(i64, Option<Vec<u16>>)>,
    color: usize,
    whole_color: usize,
}

impl FrameCheck {
    fn take(&mut self, event: Event) -> Outcome {
        match event {
            Event::Color(c) => {
                self.color += 1;
                if c.missing_packets > 0 {
                    return Ok(());
                }
                self.whole_color += 1;
                let n = usize::from(u16::from_le_bytes([c.bytes[0], c.bytes[1]]));
                if c.bytes != color_frame(n) {
                    return Err(format!("colour frame {n} is wrong").into());
                }
            }
            Event::Depth(d) => {
                let whole = d.missing_packets == 0;
                let first = self.depth.first().map_or(d.timestamp_ns, |(t, _)| *t);
                let number = |t: i64| ((t - first) as f64 * 30e-9).round() as usize;
                let before = self.depth.iter().find(|(t, _)| number(*t) + DEPTH_PERIOD == number(d.timestamp_ns));
                if let (true, Some((_, Some(before)))) = (whole, before) {
                    // Pixel 0 holds the number of the frame; where it falls, another may show.
                    let unlike = before.iter().zip(&d.depth).filter(|(a, b)| a != b).count();
                    if unlike > 2 {
                        return Err(format!("depth at {} ns: {unlike} pixels are wrong", d.timestamp_ns).into());
                    }
                }
                let seen = d.depth.iter().filter(|mm| **mm > 0).count();
                if whole && seen < WIDTH * HEIGHT / 2 {
                    return Err(format!("depth at {} ns: {seen} pixels", d.timestamp_ns).into());
                }
                self.depth.push((d.timestamp_ns, whole.then_some(d.depth)));
            }
            _ => {}
        }
        Ok(())
    }
}

fn main() -> Outcome {
    let path = std::env::args().nth(1).ok_or("give a recording")?;
    let mut reader = RecordingReader::open(Path::new(&path))?;
    let mut depth = PacketCheck::new(&DEPTH_11, depth_frame, |p| usize::from(p[0]) << 3 | usize::from(p[1]) >> 5);
    let mut color = PacketCheck::new(&BAYER_VGA, color_frame, |p| usize::from(u16::from_le_bytes([p[0], p[1]])));
    let mut frames = FrameCheck::default();
    while let Some(event) = reader.next_event()? {
        match event {
            Event::Packet(p) if p.endpoint == DEPTH_11.endpoint => depth.take(&p.data)?,
            Event::Packet(p) if p.endpoint == BAYER_VGA.endpoint => color.take(&p.data)?,
            other => frames.take(other)?,
        }
    }
    let whole = frames.depth.iter().filter(|(_, d)| d.is_some()).count();
    let (depth, color) = if depth.frames > 0 {
        ((depth.whole, depth.frames), (color.whole, color.frames))
    } else {
        ((whole, frames.depth.len()), (frames.whole_color, frames.color))
    };
    if depth.0 == 0 || color.0 == 0 {
        return Err(format!("no whole frame: depth {depth:?}, color {color:?}").into());
    }
    println!("depth: {} frames, {} whole; colour: {} frames, {} whole", depth.1, depth.0, color.1, color.0);
    Ok(())
}
