//! The opened simulated Kinect: commands, registers, LED and accelerometer. Input that a real Kinect would not accept is
//! logged as a violation.

use crate::kinect::frame_queue::PacketSink;
use crate::kinect::protocol;
use crate::kinect::transport::{Setup, Transport, UsbError};
use crate::lock::lock;
use crate::simulator::calibration::{PLANE, REGISTRATION_WORDS, calibration, fixed_parameters};
use crate::simulator::depth_encoder::DepthEncoder;
use crate::simulator::plan::SimPlan;
use crate::simulator::random::Random;
use crate::simulator::scenery::Player;
use crate::simulator::shared::Shared;
use crate::simulator::stream::Streamer;
use firmware_config::kinect_models::{
    BAYER_SXGA, BAYER_VGA, DEPTH_10, DEPTH_11, DEPTH_ENDPOINT, Model, Part, VIDEO_ENDPOINT,
};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

struct Reply {
    not_ready: u32,
    bytes: Vec<u8>,
}

/// The simulated device, opened.
pub struct SimKinect {
    plan: Arc<SimPlan>,
    shared: Arc<Shared>,
    replies: VecDeque<Reply>,
    audio: VecDeque<Vec<u8>>,
    controls: u32,
    alternate: bool,
    submitted: Vec<u8>,
    streamer: Option<(JoinHandle<()>, Arc<AtomicBool>)>,
}

impl SimKinect {
    /// A session that follows the plan.
    #[must_use]
    pub fn new(plan: SimPlan, shared: Arc<Shared>) -> Self {
        let stale = |tag| protocol::message(protocol::MAGIC_IN, protocol::WRITE_REGISTER, tag as u16, &[0]);
        Self {
            replies: (0..plan.stale).map(|tag| Reply { not_ready: 0, bytes: stale(tag) }).collect(),
            plan: Arc::new(plan),
            shared,
            audio: VecDeque::new(),
            controls: 0,
            alternate: false,
            submitted: Vec::new(),
            streamer: None,
        }
    }

    fn violation(&self, text: String) {
        lock(&self.shared.log).violations.push(text);
    }

    /// Counts a control transfer; the plan may unplug the device at it.
    fn control(&mut self) -> Result<(), UsbError> {
        self.controls += 1;
        if self.plan.unplug_at_control == Some(self.controls) {
            self.shared.unplug(&self.plan);
        }
        if self.shared.is_plugged() { Ok(()) } else { Err(UsbError::NoDevice) }
    }

    fn command(&mut self, data: &[u8]) {
        let words: Vec<u16> = (0..data.len() / 2).filter_map(|i| protocol::word(data, i)).collect();
        let [_, length, command, tag, payload @ ..] = words.as_slice() else {
            return self.violation(format!("a command of {} bytes", data.len()));
        };
        if data[..2] != protocol::MAGIC_OUT || usize::from(*length) != payload.len() || !data.len().is_multiple_of(2) {
            return self.violation(format!("malformed command {data:02x?}"));
        }
        let Some(reply) = self.answer(*command, payload) else {
            return self.violation(format!("command {command:#x} {payload:x?}"));
        };
        let magic = if self.plan.bad_magic { *b"XX" } else { protocol::MAGIC_IN };
        let bytes = protocol::message(magic, *command, *tag, &reply);
        self.replies.push_back(Reply { not_ready: self.plan.not_ready, bytes });
    }

    fn answer(&mut self, command: u16, payload: &[u16]) -> Option<Vec<u16>> {
        match (command, payload) {
            (protocol::READ_REGISTER, &[register]) => {
                Some(vec![0, lock(&self.shared.registers).get(&register).copied().unwrap_or(0)])
            }
            (protocol::WRITE_REGISTER, &[register, value]) => {
                self.write(register, value);
                Some(vec![0])
            }
            (protocol::FIXED_PARAMETERS, &[0, 0, 0, 0, 0]) => Some(fixed_parameters(self.plan.model)),
            (protocol::ALGORITHM, &[id, 0, 1, 30, 0]) => match id {
                protocol::REGISTRATION => {
                    let words = REGISTRATION_WORDS.iter().flat_map(|w| [*w as u16, (*w >> 16) as u16]);
                    Some([0].into_iter().chain(words).collect())
                }
                protocol::PADDING => Some(vec![0, 0, 0, 0]),
                protocol::CONST_SHIFT => Some(vec![0, PLANE.const_shift]),
                _ => None,
            },
            (protocol::CMOS, &[1, register, _]) if register < 0x8000 => {
                lock(&self.shared.log).exposures += 1;
                Some(vec![1, register, 300])
            }
            _ => None,
        }
    }

    fn write(&mut self, register: u16, value: u16) {
        let endpoint = match register {
            0x05 => VIDEO_ENDPOINT,
            0x06 => DEPTH_ENDPOINT,
            _ => 0,
        };
        if endpoint != 0 && value != 0 && !self.submitted.contains(&endpoint) {
            self.violation(format!("register {register:#x} = {value} before transfers were submitted"));
        }
        lock(&self.shared.log).writes.push((register, value));
        lock(&self.shared.registers).insert(register, value);
    }

    fn audio_command(&mut self, data: &[u8]) {
        let words: Vec<u32> = data.chunks_exact(4).map(|c| u32::from_le_bytes([c[0], c[1], c[2], c[3]])).collect();
        let status = |tag: u32| [0x0a6f_e000, tag, 0u32].iter().flat_map(|w| w.to_le_bytes()).collect();
        match words[..] {
            [0x0602_2009, tag, 0, 0x10, led @ 1..=4] => {
                lock(&self.shared.log).led = led;
                self.audio.push_back(status(tag));
            }
            [0x0602_2009, tag, 0x68, 0x8032] => {
                let mut state = vec![0u8; 104];
                state[20..24].copy_from_slice(&819i32.to_le_bytes());
                self.audio.push_back(state);
                self.audio.push_back(status(tag));
            }
            _ => self.violation(format!("audio command {words:x?}")),
        }
    }

    fn has(&self, part: Part) -> bool {
        !self.plan.no_motor
            && match part {
                Part::Motor => self.plan.model == Model::K1414,
                Part::Audio => self.plan.model != Model::K1414,
                _ => false,
            }
    }
}

impl Transport for SimKinect {
    fn control_out(&mut self, setup: Setup, data: &[u8]) -> Result<(), UsbError> {
        let Setup { part, request, value, limit } = setup;
        self.control()?;
        match (part, request) {
            (Part::Camera, 0) if self.plan.dead => {
                self.shared.pause(limit);
                return Err(UsbError::Timeout);
            }
            (Part::Camera, 0) => self.command(data),
            (Part::Motor, 0x06) if self.has(part) => lock(&self.shared.log).led = u32::from(value),
            (Part::Motor, _) if !self.has(part) => return Err(UsbError::NoDevice),
            _ => {
                self.violation(format!("request {request:#x} to {part:?}"));
                return Err(UsbError::Other("stall".into()));
            }
        }
        Ok(())
    }

    fn control_in(&mut self, setup: Setup, data: &mut [u8]) -> Result<usize, UsbError> {
        self.control()?;
        match (setup.part, setup.request) {
            (Part::Camera, 0) => {
                if self.plan.never_ready {
                    return Ok(if self.controls.is_multiple_of(2) { 0 } else { protocol::REPLY_BYTES });
                }
                let Some(reply) = self.replies.front_mut() else { return Ok(0) };
                if reply.not_ready > 0 {
                    reply.not_ready -= 1;
                    return Ok(if reply.not_ready % 2 == 0 { 0 } else { protocol::REPLY_BYTES });
                }
                let bytes = self.replies.pop_front().map(|r| r.bytes).unwrap_or_default();
                let n = bytes.len().min(data.len());
                data[..n].copy_from_slice(&bytes[..n]);
                Ok(n)
            }
            (Part::Motor, 0x32) if self.has(setup.part) => {
                // At rest and level: 1 g upwards.
                let state = [0, 0, 0, 0, 0x03, 0x33, 0, 0, 0, 0];
                data[..10].copy_from_slice(&state);
                Ok(10)
            }
            _ => Err(UsbError::NoDevice),
        }
    }

    fn bulk_out(&mut self, data: &[u8], _limit: Duration) -> Result<(), UsbError> {
        if !self.has(Part::Audio) {
            return Err(UsbError::NoDevice);
        }
        self.audio_command(data);
        Ok(())
    }

    fn bulk_in(&mut self, data: &mut [u8], _limit: Duration) -> Result<usize, UsbError> {
        let bytes = self.audio.pop_front().ok_or(UsbError::Timeout)?;
        data[..bytes.len()].copy_from_slice(&bytes);
        Ok(bytes.len())
    }

    fn select_alternate(&mut self, setting: u8) -> Result<(), UsbError> {
        self.alternate = setting == 1;
        Ok(())
    }

    fn start(&mut self, endpoints: &[u8], sink: PacketSink) -> Result<(), UsbError> {
        if !self.shared.is_plugged() {
            return Err(UsbError::NoDevice);
        }
        if self.streamer.is_some() || (self.plan.model == Model::K1517 && !self.alternate) {
            self.violation("transfers submitted twice, or on the wrong alternate setting".into());
            return Err(UsbError::Bandwidth);
        }
        // The formats follow from registers that are written later, so the thread waits for both streams to be switched on.
        let stop = Arc::new(AtomicBool::new(false));
        let seed = self.plan.seed.wrapping_add(u64::from(lock(&self.shared.log).opens) << 32);
        let (plan, shared, stopped) = (Arc::clone(&self.plan), Arc::clone(&self.shared), Arc::clone(&stop));
        let body = move || {
            while {
                let on = shared.streams_on();
                !on.0 || !on.1
            } {
                if stopped.load(Ordering::Relaxed) || !shared.is_plugged() {
                    return;
                }
                std::thread::sleep(Duration::from_micros(500));
            }
            let registers = lock(&shared.registers).clone();
            let depth = if registers.get(&0x12) == Some(&2) { &DEPTH_10 } else { &DEPTH_11 };
            let color = if registers.get(&0x0d) == Some(&2) { &BAYER_SXGA } else { &BAYER_VGA };
            match Player::open(&plan, DepthEncoder::new(&calibration(), depth), depth, color) {
                Ok(player) => {
                    let random = Random::new(seed);
                    Streamer { plan, shared, stop: stopped, player, depth, color, sink, random }.run();
                }
                Err(e) => lock(&shared.log).violations.push(e),
            }
        };
        let thread = std::thread::Builder::new().name("simulated-kinect".into()).spawn(body);
        self.streamer = Some((thread.map_err(|e| UsbError::Other(e.to_string()))?, stop));
        self.submitted = endpoints.to_vec();
        Ok(())
    }

    fn stop(&mut self) {
        self.submitted.clear();
        if let Some((thread, stop)) = self.streamer.take() {
            stop.store(true, Ordering::Relaxed);
            if thread.join().is_err() {
                self.violation("its stream thread panicked".into());
            }
        }
    }

    fn waits(&self) -> bool {
        self.plan.fast && !self.plan.drop_when_slow
    }

    fn now(&self) -> Duration {
        self.shared.now()
    }

    fn pause(&mut self, time: Duration) {
        self.shared.pause(time);
    }
}

impl Drop for SimKinect {
    fn drop(&mut self) {
        self.stop();
    }
}
