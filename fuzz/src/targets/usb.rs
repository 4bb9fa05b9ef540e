//! What the Kinect sends: packets of both streams, replies of its camera and of its audio device.

use firmware_config::KinectConfig;
use firmware_config::kinect_models::{BAYER_VGA, DEPTH_11, Model};
use lumiscan::kinect::buffers::Pool;
use lumiscan::kinect::calibration::{Calibration, Registration, ZeroPlane};
use lumiscan::kinect::decoder::Decoder;
use lumiscan::kinect::depth_decoder::DepthDecoder;
use lumiscan::kinect::driver::{Kinect, Led};
use lumiscan::kinect::frame_queue::PacketSink;
use lumiscan::kinect::packet_assembler::Assembler;
use lumiscan::kinect::protocol::StreamParameters;
use lumiscan::kinect::transport::{Bus, Found, Setup, Transport, UsbError};
use std::cell::RefCell;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Bytes of a record that stands for a packet.
const RECORD: usize = 8;

fn calibration() -> Calibration {
    Calibration {
        zero_plane: ZeroPlane { emitter_cm: 7.5, distance: 120.0, pixel_size: 0.1042, const_shift: 200 },
        registration: Registration::from_words([0; 29]),
        start_lines: 0,
    }
}

/// Records of eight bytes: what the header says, length and fill of the payload. A record with the lowest bit set is a packet
/// of its own bytes.
pub fn packets(bytes: &[u8]) {
    thread_local!(static DEPTH: RefCell<DepthDecoder> =
        RefCell::new(DepthDecoder::new(&calibration(), &DEPTH_11, Pool::new(640 * 480, 0, 1))));
    let mut streams = [Assembler::new(&DEPTH_11), Assembler::new(&BAYER_VGA)];
    let mut rest = bytes;
    let mut decoded = false;
    while let Some((record, after)) = rest.split_at_checked(RECORD) {
        rest = after;
        let stream = usize::from(record[0] >> 1 & 1);
        let format = [&DEPTH_11, &BAYER_VGA][stream];
        let packet = if record[0] & 1 == 1 {
            let (own, after) = rest.split_at(rest.len().min(usize::from(record[1])));
            rest = after;
            own.to_vec()
        } else {
            let mut packet = vec![record[7]; 12 + usize::from(u16::from_le_bytes([record[5], record[6]]) % 2000)];
            packet[..12].fill(0);
            packet[..2].copy_from_slice(b"RB");
            packet[3] = format.stream_id | [1, 2, 5, 2][usize::from(record[0] >> 2 & 3)];
            packet[5] = record[1];
            let ticks = u32::from_le_bytes([record[2], record[3], record[4], 0]) << 8;
            packet[8..12].copy_from_slice(&ticks.to_le_bytes());
            packet
        };
        streams[stream].push(&packet, &mut |frame| {
            assert_eq!(frame.bytes.len(), format.frame_bytes());
            // A frame takes as long as a thousand packets: one is enough.
            if stream == 0 && !std::mem::replace(&mut decoded, true) {
                DEPTH.with_borrow_mut(|d| drop(d.decode(&frame.bytes, &frame.missing, 0)));
            }
        });
    }
    for mut stream in streams {
        stream.end();
        let s = stream.stats();
        assert!(s.incomplete_frames <= s.frames, "{s:?}");
    }
}

/// A Kinect whose replies are the input: the device as a whole is opened, asked and closed.
pub fn control(bytes: &[u8]) {
    let [mode, replies @ ..] = bytes else { return };
    // As a recording of packets would have it.
    let mut parameters = StreamParameters::default();
    let mut decoder = Decoder::default();
    let mut rest = replies;
    while let [length, after @ ..] = rest {
        let (data, after) = after.split_at(after.len().min(usize::from(*length)));
        let endpoint = if data.len() % 2 == 0 { 0x00 } else { 0x80 };
        parameters.observe(endpoint, data);
        let _ = decoder.push(endpoint, 0, data, &mut drop);
        rest = after;
    }
    let _ = parameters.calibration();

    let model = [Model::K1414, Model::K1473, Model::K1517][usize::from(mode >> 1) % 3];
    let state = Arc::new(Mutex::new(State { replies: replies.to_vec(), honest: mode & 1 == 1, ..State::default() }));
    let mut bus = FakeBus { model, state };
    if let Ok(mut kinect) = Kinect::open(&mut bus, "", &KinectConfig::default()) {
        kinect.set_led(Led::Ready);
        let _ = (kinect.accelerometer(), kinect.exposure_us(), kinect.accelerometer());
    }
}

#[derive(Default)]
struct State {
    replies: Vec<u8>,
    /// Replies have the header that the driver expects.
    honest: bool,
    /// Words 2..6 of the last command.
    asked: [u8; 4],
    now: Duration,
}

impl State {
    fn reply(&mut self, data: &mut [u8]) -> usize {
        let length = self.replies.first().map_or(0, |n| usize::from(*n) * 2);
        let taken = (1 + length).min(self.replies.len());
        let reply: Vec<u8> = self.replies.drain(..taken).skip(1).collect();
        if self.honest && reply.len() % 2 == 0 {
            let header = [&b"RB"[..], &((reply.len() / 2) as u16).to_le_bytes(), &self.asked].concat();
            return copy(&[header, reply].concat(), data);
        }
        copy(&reply, data)
    }
}

fn copy(from: &[u8], to: &mut [u8]) -> usize {
    let n = from.len().min(to.len());
    to[..n].copy_from_slice(&from[..n]);
    n
}

struct FakeBus {
    model: Model,
    state: Arc<Mutex<State>>,
}

impl Bus for FakeBus {
    fn list(&mut self) -> Result<Vec<Found>, UsbError> {
        let (serial, path) = (String::new(), String::from("1"));
        Ok(vec![Found { model: self.model, serial, bus: 1, path, address: 1, accessible: true }])
    }

    fn is_here(&mut self, _: &Found) -> bool {
        true
    }

    fn open(&mut self, _: &Found) -> Result<Box<dyn Transport>, UsbError> {
        Ok(Box::new(FakeKinect(Arc::clone(&self.state))))
    }
}

struct FakeKinect(Arc<Mutex<State>>);

impl FakeKinect {
    fn with<T>(&self, f: impl FnOnce(&mut State) -> T) -> T {
        f(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Transport for FakeKinect {
    fn control_out(&mut self, _: Setup, data: &[u8]) -> Result<(), UsbError> {
        if let Some(asked) = data.get(4..8).and_then(|a| a.try_into().ok()) {
            self.with(|s| s.asked = asked);
        }
        Ok(())
    }

    fn control_in(&mut self, _: Setup, data: &mut [u8]) -> Result<usize, UsbError> {
        Ok(self.with(|s| s.reply(data)))
    }

    fn bulk_out(&mut self, _: &[u8], _: Duration) -> Result<(), UsbError> {
        Ok(())
    }

    fn bulk_in(&mut self, data: &mut [u8], _: Duration) -> Result<usize, UsbError> {
        Ok(self.with(|s| s.reply(data)))
    }

    fn select_alternate(&mut self, _: u8) -> Result<(), UsbError> {
        Ok(())
    }

    fn start(&mut self, _: &[u8], _: PacketSink) -> Result<(), UsbError> {
        Err(UsbError::NoDevice)
    }

    fn stop(&mut self) {}

    fn waits(&self) -> bool {
        false
    }

    fn now(&self) -> Duration {
        self.with(|s| s.now)
    }

    fn pause(&mut self, time: Duration) {
        self.with(|s| s.now += time);
    }
}
