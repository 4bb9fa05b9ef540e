//! A streaming session: takes frames from the queue, decodes them, delivers them, and restarts silent streams.

use crate::kinect::buffers::Buffers;
use crate::kinect::decoder::{DecoderStats, FrameDecoder};
use crate::kinect::driver::{Kinect, Led};
use crate::kinect::frame_queue::{Arrived, FrameSource, QueueStats, StreamKind, Wanted, frame_queue, packets_of};
use crate::kinect::protocol::{KinectError, StreamParameters};
use crate::kinect::transport::UsbError;
use firmware_config::KinectConfig;
use recordings::recording::Event;
use recordings::types::Accelerometer;
use std::fmt::{Display, Formatter};
use std::time::Duration;

/// Frames per call of [`Live::poll`]: one of each stream.
const BATCH: usize = 2;
/// Longest wait for a frame.
const EMPTY_PAUSE: Duration = Duration::from_millis(20);

/// Outcome of [`Live::poll`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Polled {
    /// Frames or packets.
    Some,
    /// Nothing yet.
    Nothing,
    /// The Kinect is unplugged, and everything it sent has been delivered.
    Gone,
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
    /// Counters of the queue between the USB callback and the reader.
    pub queue: QueueStats,
    /// Counters of assembly.
    pub streams: DecoderStats,
    /// Times the streams were restarted.
    pub restarts: u32,
}

/// A streaming Kinect.
pub struct Live {
    kinect: Kinect,
    source: FrameSource,
    decoder: FrameDecoder,
    buffers: Buffers,
    /// Packets that the last call of [`Live::poll`] took.
    batch: Option<Vec<u8>>,
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
}

impl Live {
    /// Starts the streams of an opened Kinect.
    ///
    /// # Errors
    /// Unplugged, no bandwidth, or no answer.
    pub fn start(mut kinect: Kinect, wanted: Wanted, config: &KinectConfig) -> Result<Self, KinectError> {
        let accelerometer_every =
            (config.accelerometer_hz > 0).then(|| Duration::from_secs(1) / config.accelerometer_hz);
        let pending_acceleration = accelerometer_every.and_then(|_| kinect.accelerometer());
        let (mut source, buffers) = frame_queue(kinect.depth_format(), kinect.color_format(), wanted);
        kinect.start(&mut source)?;
        let mut parameters = StreamParameters::default();
        kinect.traffic().iter().for_each(|packet| parameters.observe(packet.endpoint, &packet.data));
        let decoder = FrameDecoder::new(&parameters, buffers.clone())?;
        let now = kinect.now();
        Ok(Self {
            source,
            decoder,
            buffers,
            batch: None,
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
        let (queue, [depth, color]) = self.source.stats();
        LiveStats { queue, streams: DecoderStats { depth, color }, restarts: self.restarts }
    }

    /// Where the buffers of its frames go when they are done with.
    #[must_use]
    pub fn buffers(&self) -> &Buffers {
        &self.buffers
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

    /// Decodes what waits in the queue: `sink` receives the frames and readings; the packets are in [`Live::packets`]. Waits at
    /// most [`EMPTY_PAUSE`].
    ///
    /// # Errors
    /// The streams stay silent after the permitted number of restarts.
    pub fn poll(&mut self, sink: &mut impl FnMut(Event)) -> Result<Polled, KinectError> {
        self.source.wait(EMPTY_PAUSE);
        let gone = self.source.gone();
        if let Some(batch) = self.batch.take() {
            self.source.give(batch);
        }
        // Before the frames: a frame's packets come with it or after it.
        self.batch = self.source.packets();
        let mut taken = usize::from(self.batch.is_some());
        for _ in 0..BATCH {
            let Some(arrived) = self.source.frame() else { break };
            let event = self.decoder.decode(arrived.stream, arrived.host_ns, arrived.frame);
            // A reading comes before the frames that it applies to.
            if let Some(acceleration) = self.pending_acceleration.take() {
                let reading = Accelerometer { timestamp_ns: event.timestamp_ns(), acceleration };
                sink(Event::Accelerometer(*self.acceleration.insert(reading)));
            }
            sink(event);
            let now = self.kinect.now();
            match arrived.stream {
                StreamKind::Depth => (self.depth_seen, self.restarts_in_a_row) = (now, 0),
                StreamKind::Color => self.color_seen = now,
            }
            taken += 1;
        }
        if taken == 0 && gone {
            self.source.end();
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
        Ok(Polled::Nothing)
    }

    /// The packets that the last call of [`Live::poll`] took, where they are wanted. A reading of that call applies to them.
    pub fn packets(&self) -> impl Iterator<Item = Arrived<'_>> {
        packets_of(self.batch.as_deref().unwrap_or_default())
    }

    fn read_sensors(&mut self) {
        let now = self.kinect.now();
        if let Some(every) = self.accelerometer_every
            && now >= self.next_accelerometer
        {
            // From when it was due: otherwise every delay would lower the rate. What was missed is not made up for.
            let next = self.next_accelerometer + every;
            self.next_accelerometer = if next > now { next } else { now + every };
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
        self.source.end();
        self.kinect.start(&mut self.source)?;
        let now = self.kinect.now();
        (self.depth_seen, self.color_seen) = (now, now);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
