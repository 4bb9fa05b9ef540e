//! A streaming session: takes packets from the ring, decodes them, delivers frames, and restarts silent streams.

use crate::kinect::decoder::{Decoder, DecoderStats};
use crate::kinect::driver::{Kinect, Led};
use crate::kinect::packet_ring::{Arrived, PacketSource, RingStats};
use crate::kinect::protocol::KinectError;
use crate::kinect::transport::UsbError;
use firmware_config::KinectConfig;
use recordings::recording::Event;
use recordings::types::Accelerometer;
use std::fmt::{Display, Formatter};
use std::time::Duration;

/// Largest packet of any endpoint.
const PACKET_BYTES: usize = 3072;
/// Packets per call of [`Live::poll`]: about two frames.
const BATCH: usize = 800;
/// Pause when the ring is empty.
const EMPTY_PAUSE: Duration = Duration::from_millis(3);

/// Outcome of [`Live::poll`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Polled {
    /// Packets.
    Some,
    /// Nothing yet.
    Nothing,
    /// The Kinect is unplugged, and everything it sent has been delivered.
    Gone,
}

/// One of the two streams.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StreamKind {
    /// Depth.
    Depth,
    /// Colour.
    Color,
}

impl Display for StreamKind {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Depth => "depth",
            Self::Color => "colour",
        })
    }
}

/// Counters of a session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LiveStats {
    /// Counters before the assembler.
    pub ring: RingStats,
    /// Counters of assembly.
    pub streams: DecoderStats,
    /// Times the streams were restarted.
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
    /// A reading that is delivered before the next frame.
    pending_acceleration: Option<[f32; 3]>,
    /// The newest reading that was delivered.
    acceleration: Option<Accelerometer>,
    read_exposure: bool,
    exposure_us: Option<f64>,
    depth_seen: Duration,
    color_seen: Duration,
    max_restarts: u32,
    restarts_in_a_row: u32,
    restarts: u32,
    /// Ring counters before the last restart.
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
        let pending_acceleration = accelerometer_every.and_then(|_| kinect.accelerometer());
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
            pending_acceleration,
            acceleration: None,
            read_exposure: config.read_exposure,
            exposure_us: None,
            depth_seen: now,
            color_seen: now,
            max_restarts: config.tuning.session.max_restarts,
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
        LiveStats {
            ring: RingStats {
                packets: self.earlier.packets + ring.packets,
                dropped: self.earlier.dropped + ring.dropped,
                bad_status: self.earlier.bad_status + ring.bad_status,
            },
            streams: self.decoder.stats(),
            restarts: self.restarts,
        }
    }

    /// True if the device waits for the reader, as only a simulated one does.
    #[must_use]
    pub fn waits(&self) -> bool {
        self.kinect.waits()
    }

    /// The newest acceleration that was delivered.
    #[must_use]
    pub fn acceleration(&self) -> Option<Accelerometer> {
        self.acceleration
    }

    /// Exposure time in microseconds according to the sensor's register, if it is read; not calibrated.
    #[must_use]
    pub fn exposure_us(&self) -> Option<f64> {
        self.exposure_us
    }

    /// The stream that has been silent for long while the other one comes.
    #[must_use]
    pub fn silent_stream(&self) -> Option<StreamKind> {
        let now = self.kinect.now();
        let silent = |seen: Duration| now.saturating_sub(seen) > self.silence;
        match (silent(self.depth_seen), silent(self.color_seen)) {
            (true, false) => Some(StreamKind::Depth),
            (false, true) => Some(StreamKind::Color),
            _ => None,
        }
    }

    /// Decodes what is in the ring: `raw` receives every packet unchanged, `sink` the frames and readings. Sleeps [`EMPTY_PAUSE`]
    /// if the ring is empty.
    ///
    /// # Errors
    /// The streams stay silent after the permitted number of restarts.
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
            let (pending, newest) = (&mut self.pending_acceleration, &mut self.acceleration);
            self.decoder.push(packet.endpoint, packet.host_ns, data, &mut |event| {
                // A reading comes before the frames that it applies to.
                if let Some(acceleration) = pending.take() {
                    let reading = Accelerometer { timestamp_ns: event.timestamp_ns(), acceleration };
                    sink(Event::Accelerometer(*newest.insert(reading)));
                }
                depth |= matches!(event, Event::Depth(_));
                color |= matches!(event, Event::Color(_));
                sink(event);
            })?;
            let now = self.kinect.now();
            if depth {
                (self.depth_seen, self.restarts_in_a_row) = (now, 0);
            }
            if color {
                self.color_seen = now;
            }
            taken += 1;
        }
        if taken == 0 && gone {
            self.decoder.end();
            return Ok(Polled::Gone);
        }
        // Packets without frames count as silence.
        if self.kinect.now().saturating_sub(self.depth_seen.max(self.color_seen)) > self.silence {
            self.restart()?;
            return Ok(Polled::Nothing);
        }
        if taken > 0 {
            self.read_sensors();
            return Ok(Polled::Some);
        }
        std::thread::sleep(EMPTY_PAUSE);
        Ok(Polled::Nothing)
    }

    fn read_sensors(&mut self) {
        let now = self.kinect.now();
        if let Some(every) = self.accelerometer_every
            && now >= self.next_accelerometer
        {
            self.next_accelerometer = now + every;
            self.pending_acceleration = self.kinect.accelerometer();
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
        if self.restarts_in_a_row > self.max_restarts {
            return Err(UsbError::Timeout.into());
        }
        tracing::warn!("the Kinect is silent; restarting its streams");
        self.kinect.stop();
        self.decoder.end();
        self.earlier = self.stats().ring;
        self.source = self.kinect.start()?;
        let now = self.kinect.now();
        (self.depth_seen, self.color_seen) = (now, now);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
