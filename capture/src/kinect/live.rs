//! A Kinect that streams: packets are taken from the ring, decoded, and handed on; silence is noticed and mended.

use crate::kinect::decoder::{Decoder, DecoderStats};
use crate::kinect::driver::{Kinect, Led};
use crate::kinect::packet_ring::{Arrived, PacketSource, RingStats};
use crate::kinect::protocol::KinectError;
use crate::kinect::transport::UsbError;
use firmware_config::KinectConfig;
use recordings::recording::Event;
use recordings::types::Accelerometer;
use std::time::Duration;

/// Largest packet of any endpoint.
const PACKET_BYTES: usize = 3072;
/// Packets taken before the caller gets a word in: two frames' worth.
const BATCH: usize = 800;
/// Times in a row that silent streams are started anew before the Kinect is given up.
const RESTARTS: u32 = 3;
/// Longest rest when the ring is empty.
const REST: Duration = Duration::from_millis(3);

/// What a look at the ring brought.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Polled {
    /// Packets.
    Some,
    /// Nothing yet.
    Nothing,
    /// The Kinect is gone, and everything it sent has been handed on.
    Gone,
}

/// Counters of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LiveStats {
    /// Before the assembler.
    pub ring: RingStats,
    /// After it.
    pub streams: DecoderStats,
    /// Times the streams were started anew.
    pub restarts: u32,
}

/// A streaming Kinect.
pub struct Live {
    kinect: Kinect,
    source: PacketSource,
    decoder: Decoder,
    buffer: Box<[u8; PACKET_BYTES]>,
    silence: Duration,
    accelerometer_every: Option<Duration>,
    next_accelerometer: Duration,
    /// Acceleration that is said before the next frame.
    unsaid: Option<[f32; 3]>,
    /// The newest that was said.
    acceleration: Option<Accelerometer>,
    read_exposure: bool,
    exposure_us: Option<f64>,
    depth_heard: Duration,
    color_heard: Duration,
    restarts_in_a_row: u32,
    restarts: u32,
    /// Ring counters of streams that were started anew.
    earlier: RingStats,
}

impl Live {
    /// Starts the streams of an opened Kinect.
    ///
    /// # Errors
    /// Unplugged, no bandwidth, or no answer.
    pub fn start(mut kinect: Kinect, config: &KinectConfig) -> Result<Self, KinectError> {
        let accelerometer_every =
            (config.accelerometer_hz > 0).then(|| Duration::from_secs(1) / config.accelerometer_hz);
        let unsaid = accelerometer_every.and_then(|_| kinect.accelerometer());
        let source = kinect.start()?;
        let mut decoder = Decoder::default();
        for packet in kinect.traffic() {
            decoder.push(packet.endpoint, 0, &packet.data, &mut |_| {})?;
        }
        let now = kinect.now();
        Ok(Self {
            source,
            decoder,
            buffer: Box::new([0; PACKET_BYTES]),
            silence: Duration::from_millis(u64::from(config.silence_ms)),
            accelerometer_every,
            next_accelerometer: accelerometer_every.map_or(now, |every| now + every),
            unsaid,
            acceleration: None,
            read_exposure: config.read_exposure,
            exposure_us: None,
            depth_heard: now,
            color_heard: now,
            restarts_in_a_row: 0,
            restarts: 0,
            earlier: RingStats::default(),
            kinect,
        })
    }

    /// The Kinect.
    #[must_use]
    pub fn kinect(&self) -> &Kinect {
        &self.kinect
    }

    /// Shows a state on the LED.
    pub fn set_led(&mut self, led: Led) {
        self.kinect.set_led(led);
    }

    /// Counters.
    #[must_use]
    pub fn stats(&self) -> LiveStats {
        let ring = self.source.stats();
        let add = |a: u64, b: u64| a + b;
        LiveStats {
            ring: RingStats {
                packets: add(self.earlier.packets, ring.packets),
                dropped: add(self.earlier.dropped, ring.dropped),
                bad_status: add(self.earlier.bad_status, ring.bad_status),
            },
            streams: self.decoder.stats(),
            restarts: self.restarts,
        }
    }

    /// True if the device waits for who reads, as only a simulated one does.
    #[must_use]
    pub fn waits(&self) -> bool {
        self.kinect.waits()
    }

    /// The newest acceleration that was handed on.
    #[must_use]
    pub fn acceleration(&self) -> Option<Accelerometer> {
        self.acceleration
    }

    /// Exposure time by the sensor's register, if it is read at all: a hint.
    #[must_use]
    pub fn exposure_us(&self) -> Option<f64> {
        self.exposure_us
    }

    /// True if one stream comes and the other has been silent for long.
    #[must_use]
    pub fn silent_stream(&self) -> Option<&'static str> {
        let now = self.kinect.now();
        let silent = |heard: Duration| now.saturating_sub(heard) > self.silence;
        match (silent(self.depth_heard), silent(self.color_heard)) {
            (true, false) => Some("depth"),
            (false, true) => Some("colour"),
            _ => None,
        }
    }

    /// Takes what is in the ring: `raw` sees every packet as it came, `sink` what becomes of them. Rests a little where
    /// there is nothing.
    ///
    /// # Errors
    /// The streams stay silent although they were started anew.
    pub fn poll(
        &mut self,
        raw: &mut impl FnMut(Arrived, &[u8]),
        sink: &mut impl FnMut(Event),
    ) -> Result<Polled, KinectError> {
        let gone = self.source.gone();
        let mut taken = 0;
        while taken < BATCH
            && let Some(packet) = self.source.pop(self.buffer.as_mut_slice())
        {
            let data = &self.buffer[..packet.len];
            raw(packet, data);
            let (mut depth, mut color) = (false, false);
            let (unsaid, said) = (&mut self.unsaid, &mut self.acceleration);
            self.decoder.push(packet.endpoint, packet.host_ns, data, &mut |event| {
                // Where up is stands before the frames that it is for.
                if let Some(acceleration) = unsaid.take() {
                    let reading = Accelerometer { timestamp_ns: event.timestamp_ns(), acceleration };
                    sink(Event::Accelerometer(*said.insert(reading)));
                }
                depth |= matches!(event, Event::Depth(_));
                color |= matches!(event, Event::Color(_));
                sink(event);
            })?;
            let now = self.kinect.now();
            if depth {
                (self.depth_heard, self.restarts_in_a_row) = (now, 0);
            }
            if color {
                self.color_heard = now;
            }
            taken += 1;
        }
        if taken == 0 && gone {
            self.decoder.end();
            return Ok(Polled::Gone);
        }
        // Packets that never make a frame are silence, too.
        if self.kinect.now().saturating_sub(self.depth_heard.max(self.color_heard)) > self.silence {
            self.restart()?;
            return Ok(Polled::Nothing);
        }
        if taken > 0 {
            self.read_sensors();
            return Ok(Polled::Some);
        }
        std::thread::sleep(REST);
        Ok(Polled::Nothing)
    }

    fn read_sensors(&mut self) {
        let now = self.kinect.now();
        if let Some(every) = self.accelerometer_every
            && now >= self.next_accelerometer
        {
            self.next_accelerometer = now + every;
            self.unsaid = self.kinect.accelerometer();
        }
        if self.read_exposure
            && let Some(us) = self.kinect.exposure_us()
        {
            self.exposure_us = Some(us);
        }
    }

    fn restart(&mut self) -> Result<(), KinectError> {
        self.restarts_in_a_row += 1;
        self.restarts += 1;
        if self.restarts_in_a_row > RESTARTS {
            return Err(UsbError::Timeout.into());
        }
        tracing::warn!("the Kinect is silent; its streams are started anew");
        self.kinect.stop();
        self.decoder.end();
        self.earlier = self.stats().ring;
        self.source = self.kinect.start()?;
        let now = self.kinect.now();
        (self.depth_heard, self.color_heard) = (now, now);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
