//! The byte ring between the USB callback and the packet assembler: single producer, single consumer, never blocking.

use ringbuf::HeapRb;
use ringbuf::traits::{Consumer, Observer, Producer, Split};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Bytes of the ring between the USB callback and the assembler: about 180 ms of both streams.
pub const RING_BYTES: usize = 4 << 20;
/// Bytes before each packet in the ring: endpoint, reserved, length, host time.
const RECORD_HEADER: usize = 12;

/// Counters that both ends share.
#[derive(Debug, Default)]
struct RingCounters {
    packets: AtomicU64,
    dropped: AtomicU64,
    bad_status: AtomicU64,
    gone: AtomicBool,
}

/// Counters of the ring.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RingStats {
    /// Packets stored in the ring.
    pub packets: u64,
    /// Packets dropped because the ring was full.
    pub dropped: u64,
    /// Packets that the host controller flagged (missed service, babble).
    pub bad_status: u64,
}

/// The end of the USB callback: copies packets in and never waits.
pub struct PacketSink {
    ring: ringbuf::HeapProd<u8>,
    counters: Arc<RingCounters>,
}

/// The end of the assembler.
pub struct PacketSource {
    ring: ringbuf::HeapCons<u8>,
    counters: Arc<RingCounters>,
}

/// Head of a packet from the ring.
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
    /// Copies a packet in; drops and counts it if the ring is full.
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

    /// True if that many packets with `bytes` bytes in total fit.
    #[must_use]
    pub fn has_room(&self, packets: usize, bytes: usize) -> bool {
        self.ring.vacant_len() >= packets * RECORD_HEADER + bytes
    }

    /// Marks the end of the stream: unplugged or failed.
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

    /// Discards the contents if packets were dropped, so that the stream begins without a gap.
    pub fn discard_if_overflowed(&mut self) {
        if self.counters.dropped.load(Ordering::Relaxed) == 0 {
            return;
        }
        // Includes packets that arrive meanwhile; the counters start from the empty ring.
        while self.pop(&mut []).is_some() {}
        self.counters.dropped.store(0, Ordering::Relaxed);
        self.counters.packets.store(0, Ordering::Relaxed);
    }

    /// True after the end of the stream; the ring may still hold packets.
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
        source.discard_if_overflowed();
        assert_eq!(source.stats().packets, 1, "nothing was lost");
        (0..10).for_each(|_| sink.push(0x81, 1, &[7; 1000]));
        source.discard_if_overflowed();
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
