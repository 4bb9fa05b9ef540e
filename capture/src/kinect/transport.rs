//! The boundary between the driver and what carries it: a real USB stack ([`crate::kinect::usb`]) or a simulated Kinect
//! ([`crate::simulator`]). Below it transfers, above it the protocol.

use firmware_config::kinect_models::{Model, Part};
use ringbuf::HeapRb;
use ringbuf::traits::{Consumer, Observer, Producer, Split};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

/// What went wrong below the boundary, by what the caller can do about it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum UsbError {
    /// There is no such device, or no longer.
    #[error("no Kinect is plugged in; plug one in, and its power supply")]
    NoDevice,
    /// Only the motor shows, which lives on USB power alone.
    #[error("only the Kinect's motor shows on USB: its 12 V power supply is missing; plug it in")]
    NoPower,
    /// A Kinect V2 is plugged in, and no other.
    #[error("this is a Kinect V2, which is not supported; plug in a Kinect V1")]
    KinectV2,
    /// The system does not let this user open it.
    #[error(
        "the Kinect may not be opened by this user; install the udev rule and join group `lumiscan` (see capture/README.md)"
    )]
    Access,
    /// Another program holds it.
    #[error("another program uses the Kinect; end it")]
    Busy,
    /// No answer in time.
    #[error("the Kinect did not answer in time; unplug it and plug it in again")]
    Timeout,
    /// The bus has no room for its streams.
    #[error(
        "the kernel takes no stream of the Kinect: no bandwidth is left, or no memory for transfers; give it a USB 2 \
         controller of its own, and look what `lumiscan check` says of the usbfs memory"
    )]
    Bandwidth,
    /// Anything else.
    #[error("USB: {0}; unplug the Kinect and plug it in again")]
    Other(String),
}

/// A Kinect that is plugged in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// Model.
    pub model: Model,
    /// Serial number; empty where it cannot be read.
    pub serial: String,
    /// Bus number.
    pub bus: u8,
    /// Ports from the root hub to the camera ("2.1").
    pub path: String,
    /// Device address on the bus.
    pub address: u8,
    /// True if the device node can be opened.
    pub accessible: bool,
}

/// Where devices are found.
pub trait Bus: Send {
    /// Every Kinect V1 camera that is plugged in.
    ///
    /// # Errors
    /// The USB stack fails (that there is none counts as an empty list), or something like a Kinect is there, but none
    /// that can be used.
    fn list(&mut self) -> Result<Vec<Found>, UsbError>;
    /// True while this one is plugged in; nothing is opened for it.
    fn is_here(&mut self, found: &Found) -> bool;
    /// Opens one of them.
    ///
    /// # Errors
    /// It is gone, held by another program, or not permitted.
    fn open(&mut self, found: &Found) -> Result<Box<dyn Transport>, UsbError>;
}

/// One opened Kinect.
pub trait Transport: Send {
    /// Vendor control transfer to a part, `wIndex` 0.
    ///
    /// # Errors
    /// As USB has them; [`UsbError::NoDevice`] where the Kinect has no such part.
    fn control_out(
        &mut self,
        part: Part,
        request: u8,
        value: u16,
        data: &[u8],
        limit: Duration,
    ) -> Result<(), UsbError>;
    /// Vendor control transfer from a part; returns the bytes read.
    ///
    /// # Errors
    /// As [`Transport::control_out`].
    fn control_in(
        &mut self,
        part: Part,
        request: u8,
        value: u16,
        data: &mut [u8],
        limit: Duration,
    ) -> Result<usize, UsbError>;
    /// Bulk transfer to the audio device's endpoint 0x01.
    ///
    /// # Errors
    /// As [`Transport::control_out`].
    fn bulk_out(&mut self, data: &[u8], limit: Duration) -> Result<(), UsbError>;
    /// Bulk transfer from the audio device's endpoint 0x81; returns the bytes read.
    ///
    /// # Errors
    /// As [`Transport::control_out`].
    fn bulk_in(&mut self, data: &mut [u8], limit: Duration) -> Result<usize, UsbError>;
    /// Selects an alternate setting of the camera's interface.
    ///
    /// # Errors
    /// As [`Transport::control_out`].
    fn select_alternate(&mut self, setting: u8) -> Result<(), UsbError>;
    /// Submits the isochronous transfers of the endpoints; what comes goes to `sink`.
    ///
    /// # Errors
    /// No bandwidth, or unplugged; nothing is in flight then.
    fn start(&mut self, endpoints: &[u8], sink: PacketSink) -> Result<(), UsbError>;
    /// Cancels the transfers and waits until none is in flight.
    fn stop(&mut self);
    /// True if the streams wait for who reads: only simulated ones can.
    fn waits(&self) -> bool;
    /// Time on the clock that limits are measured with.
    fn now(&self) -> Duration;
    /// Lets that clock go on.
    fn pause(&mut self, time: Duration);
}

/// Bytes of the ring between the USB callback and the assembler: about 180 ms of both streams.
pub const RING_BYTES: usize = 4 << 20;
/// Bytes before each packet in the ring: endpoint, reserved, length, host time.
const RECORD_HEADER: usize = 12;

/// Counters of what happens before the assembler.
#[derive(Debug, Default)]
struct RingCounters {
    packets: AtomicU64,
    dropped: AtomicU64,
    bad_status: AtomicU64,
    gone: AtomicBool,
}

/// What happened before the assembler.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RingStats {
    /// Packets that went through.
    pub packets: u64,
    /// Packets dropped because the ring was full.
    pub dropped: u64,
    /// Packets that the host controller flagged (missed service, babble).
    pub bad_status: u64,
}

/// Where the USB callback puts packets: it copies and returns, it never waits.
pub struct PacketSink {
    ring: ringbuf::HeapProd<u8>,
    counters: Arc<RingCounters>,
}

/// Where the assembler takes them.
pub struct PacketSource {
    ring: ringbuf::HeapCons<u8>,
    counters: Arc<RingCounters>,
}

/// A packet as it comes out of the ring.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arrived {
    /// Endpoint address.
    pub endpoint: u8,
    /// Bytes in the caller's buffer.
    pub len: usize,
    /// Host time of arrival in nanoseconds.
    pub host_ns: i64,
}

/// A ring of `bytes` bytes, split.
#[must_use]
pub fn packet_ring(bytes: usize) -> (PacketSink, PacketSource) {
    let (producer, consumer) = HeapRb::new(bytes).split();
    let counters = Arc::new(RingCounters::default());
    (PacketSink { ring: producer, counters: Arc::clone(&counters) }, PacketSource { ring: consumer, counters })
}

impl PacketSink {
    /// Copies a packet in; drops and counts it if there is no room.
    pub fn push(&mut self, endpoint: u8, host_ns: i64, data: &[u8]) {
        let Ok(len) = u16::try_from(data.len()) else {
            self.bad_status();
            return;
        };
        if self.ring.vacant_len() < RECORD_HEADER + data.len() {
            self.counters.dropped.fetch_add(1, Ordering::Relaxed);
            return;
        }
        let mut header = [0u8; RECORD_HEADER];
        header[0] = endpoint;
        header[2..4].copy_from_slice(&len.to_le_bytes());
        header[4..].copy_from_slice(&host_ns.to_le_bytes());
        self.ring.push_slice(&header);
        self.ring.push_slice(data);
        self.counters.packets.fetch_add(1, Ordering::Relaxed);
    }

    /// Counts a packet that the host controller flagged.
    pub fn bad_status(&mut self) {
        self.counters.bad_status.fetch_add(1, Ordering::Relaxed);
    }

    /// True if `bytes` more of packets fit for sure, each of at most 3072 bytes.
    #[must_use]
    pub fn has_room(&self, packets: usize, bytes: usize) -> bool {
        self.ring.vacant_len() >= packets * RECORD_HEADER + bytes
    }

    /// Says that nothing more will come: unplugged, or the stream died.
    pub fn set_gone(&mut self) {
        self.counters.gone.store(true, Ordering::Release);
    }
}

impl PacketSource {
    /// Moves the next packet into `buffer` (at most its length); `None` if there is none yet.
    pub fn pop(&mut self, buffer: &mut [u8]) -> Option<Arrived> {
        if self.ring.occupied_len() < RECORD_HEADER {
            return None;
        }
        let mut header = [0u8; RECORD_HEADER];
        self.ring.peek_slice(&mut header);
        let len = usize::from(u16::from_le_bytes([header[2], header[3]]));
        // The producer publishes the header before the payload.
        if self.ring.occupied_len() < RECORD_HEADER + len {
            return None;
        }
        self.ring.skip(RECORD_HEADER);
        let taken = len.min(buffer.len());
        self.ring.pop_slice(&mut buffer[..taken]);
        self.ring.skip(len - taken);
        let [_, _, _, _, time @ ..] = header;
        Some(Arrived { endpoint: header[0], len: taken, host_ns: i64::from_le_bytes(time) })
    }

    /// Forgets what came so far, if it was more than the ring holds, so that what is taken begins without a hole.
    pub fn begin_anew_if_full(&mut self) {
        if self.counters.dropped.load(Ordering::Relaxed) == 0 {
            return;
        }
        // What comes meanwhile is taken; the counters begin where the ring is empty.
        while self.pop(&mut []).is_some() {}
        self.counters.dropped.store(0, Ordering::Relaxed);
        self.counters.packets.store(0, Ordering::Relaxed);
    }

    /// True once nothing more will come; what is in the ring can still be taken.
    #[must_use]
    pub fn gone(&self) -> bool {
        self.counters.gone.load(Ordering::Acquire)
    }

    /// Counters.
    #[must_use]
    pub fn stats(&self) -> RingStats {
        RingStats {
            packets: self.counters.packets.load(Ordering::Relaxed),
            dropped: self.counters.dropped.load(Ordering::Relaxed),
            bad_status: self.counters.bad_status.load(Ordering::Relaxed),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packets_come_out_as_they_went_in() {
        let (mut sink, mut source) = packet_ring(4096);
        let mut buffer = [0; 2048];
        for round in 0..50u8 {
            sink.push(0x82, i64::from(round) - 7, &vec![round; 1000 + usize::from(round)]);
            sink.push(0x81, i64::MIN, &[]);
            let first = source.pop(&mut buffer).unwrap();
            assert_eq!(
                first,
                Arrived { endpoint: 0x82, len: 1000 + usize::from(round), host_ns: i64::from(round) - 7 }
            );
            assert!(buffer[..first.len].iter().all(|&b| b == round));
            assert_eq!(source.pop(&mut buffer), Some(Arrived { endpoint: 0x81, len: 0, host_ns: i64::MIN }));
            assert_eq!(source.pop(&mut buffer), None);
        }
    }

    #[test]
    fn a_ring_that_ran_full_before_it_was_read_begins_anew() {
        let (mut sink, mut source) = packet_ring(4096);
        sink.push(0x81, 1, &[7; 1000]);
        source.begin_anew_if_full();
        assert_eq!(source.stats().packets, 1, "nothing was lost");
        (0..10).for_each(|_| sink.push(0x81, 1, &[7; 1000]));
        source.begin_anew_if_full();
        sink.push(0x82, 2, &[8; 10]);
        assert_eq!(source.stats(), RingStats { packets: 1, dropped: 0, bad_status: 0 });
        assert_eq!(source.pop(&mut [0; 64]), Some(Arrived { endpoint: 0x82, len: 10, host_ns: 2 }));
    }

    #[test]
    fn a_full_ring_drops_and_counts() {
        let (mut sink, mut source) = packet_ring(4096);
        for _ in 0..10 {
            sink.push(0x81, 0, &[7; 1000]);
        }
        assert_eq!(source.stats(), RingStats { packets: 4, dropped: 6, bad_status: 0 });
        let mut buffer = [0; 2048];
        assert_eq!(std::iter::from_fn(|| source.pop(&mut buffer)).count(), 4);
    }
}
