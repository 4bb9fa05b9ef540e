//! The isochronous streams of the simulated Kinect: frames cut into packets, with the faults of the plan.

use crate::kinect::frame_queue::PacketSink;
use crate::lock::lock;
use crate::simulator::plan::SimPlan;
use crate::simulator::random::Random;
use crate::simulator::scenery::Player;
use crate::simulator::shared::Shared;
use firmware_config::kinect_models::StreamFormat;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Time between frames.
const PERIOD: Duration = Duration::from_nanos(33_333_333);
/// Ticks of the 60 MHz clock between frames.
const PERIOD_TICKS: u32 = 2_000_000;
/// Packets between two checks of the clock.
const BATCH: usize = 16;

/// Runs until `stop`: the body of the device's stream thread.
pub struct Streamer {
    pub plan: Arc<SimPlan>,
    pub shared: Arc<Shared>,
    pub stop: Arc<AtomicBool>,
    pub player: Player,
    pub depth: &'static StreamFormat,
    pub color: &'static StreamFormat,
    pub sink: PacketSink,
    pub random: Random,
}

/// One stream's state on the wire.
struct Wire {
    format: &'static StreamFormat,
    sequence: u8,
    burst_left: u32,
    /// A packet that is to be swapped with the next.
    held: Option<Vec<u8>>,
}

impl Streamer {
    pub fn run(mut self) {
        let mut wires = [self.depth, self.color].map(|format| Wire { format, sequence: 0, burst_left: 0, held: None });
        let began = self.shared.now();
        let mut sent = 0u64;
        for slot in 0u64.. {
            if self.plan.unplug_at_frame.is_some_and(|f| sent >= f) && self.shared.unplug(&self.plan) {
                self.sink.set_gone();
                return;
            }
            let over = lock(&self.shared.log).over || (self.plan.frames > 0 && sent >= self.plan.frames);
            if over {
                lock(&self.shared.log).over = true;
            }
            let due = began + PERIOD * u32::try_from(slot).unwrap_or(u32::MAX);
            if !self.shared.wait_until(due, &self.stop) {
                return;
            }
            let stalled = self.plan.stall_every > 0
                && slot % (self.plan.stall_every + self.plan.stall_frames) >= self.plan.stall_every;
            if over || stalled {
                continue;
            }
            let (depth_on, color_on) = self.shared.streams_on();
            if !depth_on && !color_on {
                continue;
            }
            let (depth, color) = self.player.frame(sent);
            let depth = depth.filter(|_| depth_on && !self.plan.no_depth);
            // Large colour frames come with every third depth frame.
            let every = (30 / self.color.fps).max(1);
            let color = color.filter(|_| color_on && !self.plan.no_color && slot % u64::from(every) == 0);
            let ticks = self.plan.clock_start.wrapping_add((slot as u32).wrapping_mul(PERIOD_TICKS));
            if !self.send(&mut wires, [depth.as_deref(), color.as_deref()], ticks, due) {
                return;
            }
            sent += 1;
        }
    }

    /// Sends a frame of each stream, packet by packet in turns; false if the thread is to stop.
    fn send(&mut self, wires: &mut [Wire; 2], frames: [Option<&[u8]>; 2], ticks: u32, due: Duration) -> bool {
        let longest = wires.iter().map(|w| w.format.packets()).max().unwrap_or(0);
        for (wire, frame) in wires.iter().zip(&frames) {
            if frame.is_some() {
                self.shared.counts(|log| log.stream(wire.format.endpoint).frames += 1);
            }
        }
        for step in 0..longest {
            let time = due + PERIOD * step as u32 / longest as u32;
            if step % BATCH == 0 && !self.shared.wait_until(time, &self.stop) {
                return false;
            }
            for (wire, frame) in wires.iter_mut().zip(&frames) {
                let Some(frame) = frame else { continue };
                let n = wire.format.packets();
                // Spread evenly over the frame's time.
                for index in step * n / longest..(step + 1) * n / longest {
                    let packet = wire.packet(frame, index, ticks);
                    self.deliver(wire, packet, time);
                }
            }
        }
        true
    }

    fn deliver(&mut self, wire: &mut Wire, mut packet: Vec<u8>, time: Duration) {
        let (plan, random) = (&self.plan, &mut self.random);
        let endpoint = wire.format.endpoint;
        if wire.burst_left == 0 && random.chance(plan.burst) {
            wire.burst_left = plan.burst_packets;
        }
        let flagged = random.chance(plan.bad_status);
        let lost = wire.burst_left > 0 || random.chance(plan.loss) || flagged;
        wire.burst_left = wire.burst_left.saturating_sub(1);
        let (cut, garbled) = (random.chance(plan.truncate), random.chance(plan.garbage));
        let swapped = random.chance(plan.reorder);
        self.shared.counts(|log| {
            let stream = log.stream(endpoint);
            stream.packets += 1;
            stream.lost += u64::from(lost);
            stream.spoilt += u64::from(!lost && (cut || garbled));
        });
        if flagged {
            self.sink.flag(1);
        }
        if lost {
            return;
        }
        if cut {
            packet.truncate(1 + random.below(packet.len() - 1));
        }
        if garbled {
            packet.iter_mut().take(4).for_each(|b| *b = random.bits() as u8 | 0x80);
        }
        match wire.held.take() {
            None if swapped => wire.held = Some(packet),
            held => {
                self.push(endpoint, &packet, time);
                if let Some(held) = held {
                    self.push(endpoint, &held, time);
                }
            }
        }
    }

    fn push(&mut self, endpoint: u8, packet: &[u8], time: Duration) {
        // On the simulated clock the device waits for the driver; in real time it does not.
        while self.plan.fast && !self.sink.has_room() && !self.stop.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_micros(200));
        }
        self.sink.push(endpoint, time.as_nanos() as i64, std::iter::once(packet));
    }
}

impl Wire {
    fn packet(&mut self, frame: &[u8], index: usize, ticks: u32) -> Vec<u8> {
        let format = self.format;
        let start = index * format.payload;
        let payload = &frame[start..start + format.payload_of(index)];
        let last = index + 1 == format.packets();
        let place = if index == 0 {
            1
        } else if last {
            5
        } else {
            2
        };
        let length = (12 + payload.len()) as u16;
        let mut packet = Vec::with_capacity(usize::from(length));
        packet.extend_from_slice(&[b'R', b'B', 0, format.stream_id | place, 0, self.sequence]);
        packet.extend_from_slice(&length.to_be_bytes());
        packet.extend_from_slice(&(if index == 0 { 0 } else { ticks }).to_le_bytes());
        packet.extend_from_slice(payload);
        self.sequence = self.sequence.wrapping_add(1);
        packet
    }
}
