//! Isochronous packets to frames. A frame with missing packets is marked, never filled with older bytes, and every missing
//! packet is counted.

use crate::kinect::buffers::Pool;
use firmware_config::kinect_models::{PACKET_HEADER, StreamFormat};

/// A packet at most this many sequence numbers behind is late (or a duplicate), not 256 minus that ahead.
const LATE_WINDOW: u8 = 32;

/// Counters of one stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct PacketStats {
    /// Packets with a valid header and length.
    pub packets: u64,
    /// Packets without bytes, which are normal.
    pub empty: u64,
    /// Packets with a wrong magic or flag.
    pub garbage: u64,
    /// Packets cut short.
    pub short: u64,
    /// Packets that arrived too late or twice.
    pub stale: u64,
    /// Packets before the first frame, or after a resync before the next one.
    pub skipped: u64,
    /// Packets that are missing according to the sequence numbers.
    pub missing: u64,
    /// Times the sequence was lost.
    pub resyncs: u64,
    /// Frames delivered.
    pub frames: u64,
    /// Of these, frames with missing packets.
    pub incomplete_frames: u64,
    /// Frames that were not delivered: empty, or without a known sequence.
    pub lost_frames: u64,
    /// Frames that were turned away because whoever takes them was too slow.
    pub dropped_frames: u64,
}

/// An assembled frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Assembled {
    /// [`StreamFormat::frame_bytes`] bytes, 0 where packets are missing.
    pub bytes: Vec<u8>,
    /// Indices of the missing packets, ascending; packet `i` starts at byte `i * format.payload`.
    pub missing: Vec<u16>,
    /// Time stamp of its packets, 60 MHz.
    pub ticks: u32,
}

/// Assembles the frames of one stream.
pub struct Assembler {
    format: &'static StreamFormat,
    pool: Pool<u8>,
    /// The frame's bytes; empty before its first packet.
    bytes: Vec<u8>,
    received: Vec<bool>,
    /// False while frames that begin are turned away.
    accepting: bool,
    /// The frame being assembled; `None` while waiting for a first packet.
    current: Option<Current>,
    /// Sequence number of the newest packet.
    newest: Option<u8>,
    /// Its frame's time stamp, 0 before there was any.
    newest_ticks: u32,
    stats: PacketStats,
}

#[derive(Debug, Clone, Copy, Default)]
struct Current {
    /// Index in the frame of the newest packet; `None` before the frame's first one.
    index: Option<usize>,
    ticks: u32,
    received: usize,
    /// It was turned away: its packets are counted, not copied.
    dropped: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    First,
    Middle,
    Last,
}

struct Header {
    place: Place,
    sequence: u8,
    ticks: u32,
}

impl Assembler {
    /// For one stream.
    #[must_use]
    pub fn new(format: &'static StreamFormat) -> Self {
        Self::pooled(format, Pool::new(format.frame_bytes(), 0, 1))
    }

    /// For one stream, with frames in the buffers of a pool of [`StreamFormat::frame_bytes`] bytes each.
    #[must_use]
    pub fn pooled(format: &'static StreamFormat, pool: Pool<u8>) -> Self {
        Self {
            format,
            pool,
            bytes: Vec::new(),
            received: vec![false; format.packets()],
            accepting: true,
            current: None,
            newest: None,
            newest_ticks: 0,
            stats: PacketStats::default(),
        }
    }

    /// Counters so far.
    #[must_use]
    pub fn stats(&self) -> PacketStats {
        self.stats
    }

    /// Takes a frame's buffer back.
    pub fn give(&self, bytes: Vec<u8>) {
        self.pool.give(bytes);
    }

    /// Whether frames that begin from now on are accepted, or turned away and counted.
    pub fn set_accepting(&mut self, accepting: bool) {
        self.accepting = accepting;
    }

    /// Begins anew, with these counters.
    pub fn begin(&mut self, stats: PacketStats) {
        self.reset();
        (self.newest, self.newest_ticks, self.stats) = (None, 0, stats);
    }

    /// Takes a packet; passes each frame that it completes to `sink`.
    pub fn push(&mut self, packet: &[u8], sink: &mut impl FnMut(Assembled)) {
        if packet.is_empty() {
            self.stats.empty += 1;
            return;
        }
        let Some(header) = self.header(packet) else {
            self.stats.garbage += 1;
            return;
        };
        let payload = &packet[PACKET_HEADER..];
        let ahead = self.newest.map_or(1, |newest| header.sequence.wrapping_sub(newest));
        if (ahead == 0 || ahead > u8::MAX - LATE_WINDOW) && !self.is_newer(header.ticks) {
            return self.take_late(&header, usize::from(ahead.wrapping_neg()), payload);
        }
        self.newest = Some(header.sequence);
        if header.ticks != 0 {
            self.newest_ticks = header.ticks;
        }
        let lost = usize::from(ahead.wrapping_sub(1));
        let Some(current) = self.current else {
            self.stats.missing += lost as u64;
            return self.wait_for_first(&header, payload);
        };
        let n = self.format.packets();
        let place = current.index.map_or(0, |i| i + 1) + lost;
        let (crossed, index) = (place / n, place % n);
        let expected = match index {
            0 => Place::First,
            i if i == n - 1 => Place::Last,
            _ => Place::Middle,
        };
        if header.place != expected || (lost > 0 && !self.is_ahead_by(&current, crossed, header.ticks)) {
            return self.resync(&header, lost, payload, sink);
        }
        self.stats.missing += lost as u64;
        for _ in 0..crossed {
            self.finish(sink);
        }
        self.store(index, &header, payload);
        if index == n - 1 {
            self.finish(sink);
        }
    }

    /// Ends the stream: an incomplete last frame is counted as lost.
    pub fn end(&mut self) {
        if self.current.is_some_and(|c| c.received > 0) {
            self.stats.lost_frames += 1;
        }
        self.begin(self.stats);
    }

    fn header(&self, packet: &[u8]) -> Option<Header> {
        let h: &[u8; PACKET_HEADER] = packet.first_chunk()?;
        if h[..2] != *b"RB" || h[3] & 0xf0 != self.format.stream_id {
            return None;
        }
        let place = match h[3] & 0x0f {
            1 => Place::First,
            2 => Place::Middle,
            5 => Place::Last,
            _ => return None,
        };
        Some(Header { place, sequence: h[5], ticks: u32::from_le_bytes([h[8], h[9], h[10], h[11]]) })
    }

    /// True if the time stamp belongs to a later frame than any before.
    fn is_newer(&self, ticks: u32) -> bool {
        let ahead = ticks.wrapping_sub(self.newest_ticks) as i32;
        ticks != 0 && self.newest_ticks != 0 && ahead > (self.format.period_ticks() / 2) as i32
    }

    /// False if the time stamps show that the packet is not of the `frames`-th frame after the current one: sequence numbers
    /// repeat every 256 packets.
    fn is_ahead_by(&self, current: &Current, frames: usize, ticks: u32) -> bool {
        if ticks == 0 || current.ticks == 0 {
            return true;
        }
        let period = self.format.period_ticks();
        let ahead = ticks.wrapping_sub(current.ticks).wrapping_add(period / 2) / period;
        ahead as usize == frames
    }

    fn wait_for_first(&mut self, header: &Header, payload: &[u8]) {
        if header.place != Place::First {
            self.stats.skipped += 1;
            return;
        }
        self.current = Some(Current::default());
        self.store(0, header, payload);
    }

    /// A packet `behind` the newest one fills its place if that is still empty.
    fn take_late(&mut self, header: &Header, behind: usize, payload: &[u8]) {
        let newest = self.current.and_then(|c| c.index);
        let place = newest.and_then(|i| i.checked_sub(behind));
        if let (Some(index), Some(current)) = (place, self.current)
            && self.received.get(index) == Some(&false)
            && self.is_ahead_by(&current, 0, header.ticks)
        {
            let missing = self.stats.missing;
            self.store(index, header, payload);
            // It is no longer missing, unless it was short.
            if self.stats.missing == missing {
                self.stats.missing = missing.saturating_sub(1);
            } else {
                self.stats.missing = missing;
            }
            self.current = self.current.map(|c| Current { index: newest, ..c });
        } else {
            self.stats.stale += 1;
        }
    }

    /// Waits for the next first packet, beginning with this one, after the sequence was lost. The current frame is delivered
    /// only if it had no gap before a new one starts; otherwise the places of its packets are uncertain.
    fn resync(&mut self, header: &Header, lost: usize, payload: &[u8], sink: &mut impl FnMut(Assembled)) {
        self.stats.resyncs += 1;
        let (arrived, received) = self.current.map_or((0, 0), |c| (c.index.map_or(0, |i| i + 1), c.received));
        if header.place == Place::First && lost > 0 && arrived > 0 && arrived == received {
            self.stats.missing += (self.format.packets() - arrived) as u64;
            self.finish(sink);
        } else {
            self.stats.missing += lost as u64;
            self.stats.lost_frames += u64::from(received > 0);
        }
        self.reset();
        self.wait_for_first(header, payload);
    }

    fn reset(&mut self) {
        self.received.fill(false);
        self.current = None;
    }

    fn store(&mut self, index: usize, header: &Header, payload: &[u8]) {
        let Some(current) = &mut self.current else { return };
        current.index = Some(index);
        if header.ticks != 0 {
            current.ticks = header.ticks;
        }
        if current.received == 0 {
            current.dropped = !self.accepting;
            if !current.dropped && self.bytes.is_empty() {
                self.bytes = self.pool.take();
            }
        }
        let len = self.format.payload_of(index);
        let start = index * self.format.payload;
        if current.dropped && payload.len() >= len {
            current.received += 1;
            self.stats.packets += 1;
            return;
        }
        match (payload.get(..len), self.bytes.get_mut(start..start + len), self.received.get_mut(index)) {
            (Some(from), Some(to), Some(received)) => {
                to.copy_from_slice(from);
                *received = true;
                current.received += 1;
                self.stats.packets += 1;
            }
            _ => {
                self.stats.short += 1;
                self.stats.missing += 1;
            }
        }
    }

    /// Delivers the frame, unless it is empty, and prepares for the next.
    fn finish(&mut self, sink: &mut impl FnMut(Assembled)) {
        let Some(current) = self.current.replace(Current::default()) else { return };
        if current.dropped {
            self.stats.dropped_frames += 1;
            return;
        }
        // The first packet has no time stamp, so it is useless alone.
        if current.received == 0 || (current.received == 1 && current.ticks == 0 && self.format.packets() > 1) {
            self.stats.lost_frames += 1;
            self.received.fill(false);
            return;
        }
        let missing: Vec<u16> = self.received.iter().enumerate().filter(|(_, r)| !**r).map(|(i, _)| i as u16).collect();
        self.received.fill(false);
        self.stats.frames += 1;
        self.stats.incomplete_frames += u64::from(!missing.is_empty());
        let mut bytes = std::mem::take(&mut self.bytes);
        for &packet in &missing {
            // What stands there is of an earlier frame.
            let start = usize::from(packet) * self.format.payload;
            bytes[start..start + self.format.payload_of(usize::from(packet))].fill(0);
        }
        sink(Assembled { bytes, missing, ticks: current.ticks });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_config::kinect_models::{BAYER_SXGA, BAYER_VGA, DEPTH_11};
    use proptest::prelude::*;

    /// Packets of `frames` frames; byte `i` of frame `f` is a hash of both.
    fn stream(format: &StreamFormat, frames: usize, sequence: u8) -> Vec<Vec<u8>> {
        let mut packets = Vec::new();
        for f in 0..frames {
            let bytes = frame_bytes(format, f);
            for (i, payload) in bytes.chunks(format.payload).enumerate() {
                let place = if i == 0 {
                    1
                } else if i + 1 == format.packets() {
                    5
                } else {
                    2
                };
                let ticks = if i == 0 { 0 } else { ticks_of(format, f) };
                let mut p =
                    vec![b'R', b'B', 0, format.stream_id | place, 0, sequence.wrapping_add(packets.len() as u8), 0, 0];
                p.extend_from_slice(&ticks.to_le_bytes());
                p.extend_from_slice(payload);
                packets.push(p);
            }
        }
        packets
    }

    fn ticks_of(format: &StreamFormat, frame: usize) -> u32 {
        // Wraps after the third frame.
        (frame as u32 * format.period_ticks()).wrapping_sub(3 * format.period_ticks() - 7)
    }

    fn frame_bytes(format: &StreamFormat, frame: usize) -> Vec<u8> {
        (0..format.frame_bytes()).map(|i| ((i * 31 + frame * 7919) >> 3) as u8 | 1).collect()
    }

    fn assemble(format: &'static StreamFormat, packets: &[Vec<u8>]) -> (Vec<Assembled>, PacketStats) {
        let mut assembler = Assembler::new(format);
        let mut frames = Vec::new();
        for p in packets {
            assembler.push(p, &mut |f| frames.push(f));
        }
        (frames, assembler.stats())
    }

    /// Every byte is the frame's own, or 0 where a packet is listed as missing: never stale, never shifted.
    fn check_honest(format: &StreamFormat, frames: &[Assembled]) {
        for f in frames {
            let number = f.ticks.wrapping_sub(ticks_of(format, 0)) / format.period_ticks();
            let mut expected = frame_bytes(format, number as usize);
            for &m in &f.missing {
                let start = usize::from(m) * format.payload;
                expected[start..start + format.payload_of(usize::from(m))].fill(0);
            }
            assert!(f.bytes == expected, "frame {number}, missing {:?}", f.missing);
        }
    }

    #[test]
    fn whole_frames_come_out_whole() {
        for format in [&DEPTH_11, &BAYER_VGA, &BAYER_SXGA] {
            let (frames, stats) = assemble(format, &stream(format, 5, 250));
            check_honest(format, &frames);
            assert_eq!((frames.len(), stats.frames, stats.missing, stats.resyncs, stats.stale), (5, 5, 0, 0, 0));
            assert_eq!(frames[4].ticks, ticks_of(format, 4));
        }
    }

    #[test]
    fn a_hole_is_marked_wherever_it_is() {
        let n = DEPTH_11.packets();
        for hole in [0..1, 0..3, 100..101, 100..140, n - 1..n, n - 3..n, n - 2..n + 2, n - 1..2 * n - 10] {
            let mut packets = stream(&DEPTH_11, 5, 9);
            packets.drain(n + hole.start..n + hole.end);
            let (frames, stats) = assemble(&DEPTH_11, &packets);
            check_honest(&DEPTH_11, &frames);
            assert_eq!(stats.missing, hole.len() as u64, "{hole:?}");
            assert_eq!(frames.iter().map(|f| f.missing.len()).sum::<usize>(), hole.len(), "{hole:?}");
            assert_eq!((frames.len(), stats.resyncs), (5, 0), "{hole:?}");
        }
    }

    #[test]
    fn a_burst_longer_than_the_sequence_numbers_costs_frames_but_never_lies() {
        for format in [&DEPTH_11, &BAYER_VGA, &BAYER_SXGA] {
            let n = format.packets();
            for lost in [230, 250, 255, 256, 257, 300, 512, 700, 1000] {
                for at in [n, n + 1, n + 77, 2 * n - 1] {
                    let mut packets = stream(format, 14, 200);
                    packets.drain(at..at + lost);
                    let (frames, _) = assemble(format, &packets);
                    check_honest(format, &frames);
                    let untouched = 14 - (at + lost).div_ceil(n) + at / n;
                    assert!(
                        frames.len() + 1 >= untouched,
                        "{} lost {lost} at {at}: {} frames",
                        format.name,
                        frames.len()
                    );
                }
            }
        }
    }

    #[test]
    fn swapped_neighbours_cost_nothing() {
        let mut packets = stream(&BAYER_VGA, 3, 0);
        for i in [20, 200, 300] {
            packets.swap(i, i + 1);
        }
        let (frames, stats) = assemble(&BAYER_VGA, &packets);
        check_honest(&BAYER_VGA, &frames);
        assert_eq!((stats.frames, stats.incomplete_frames, stats.missing, stats.stale), (3, 0, 0, 0));
    }

    #[test]
    fn a_packet_that_comes_twice_is_used_once() {
        let mut packets = stream(&BAYER_VGA, 3, 0);
        packets.insert(50, packets[49].clone());
        packets.insert(170, packets[165].clone());
        let (frames, stats) = assemble(&BAYER_VGA, &packets);
        check_honest(&BAYER_VGA, &frames);
        assert_eq!((stats.frames, stats.missing, stats.stale), (3, 0, 2));
    }

    #[test]
    fn short_and_garbled_packets_are_holes() {
        let mut packets = stream(&DEPTH_11, 3, 0);
        packets[300].truncate(500);
        packets[301][0] = 0;
        packets[310][3] = 0x81;
        packets[400].truncate(5);
        let (frames, stats) = assemble(&DEPTH_11, &packets);
        check_honest(&DEPTH_11, &frames);
        assert_eq!((stats.short, stats.garbage, stats.missing), (1, 3, 4));
        assert_eq!(frames[1].missing, [58, 59, 68, 158]);
    }

    #[test]
    fn frames_that_are_turned_away_are_whole_ones_and_counted() {
        let packets = stream(&DEPTH_11, 4, 0);
        let mut assembler = Assembler::pooled(&DEPTH_11, Pool::new(DEPTH_11.frame_bytes(), 1, 1));
        let mut frames = Vec::new();
        for (i, p) in packets.iter().enumerate() {
            // From the middle of the first frame to the middle of the third.
            assembler.set_accepting(!(100..600).contains(&i));
            assembler.push(p, &mut |f| frames.push(f));
        }
        check_honest(&DEPTH_11, &frames);
        let stats = assembler.stats();
        assert_eq!(frames.iter().map(|f| f.ticks).collect::<Vec<_>>(), [0, 3].map(|f| ticks_of(&DEPTH_11, f)));
        assert_eq!((stats.frames, stats.dropped_frames, stats.missing, stats.lost_frames), (2, 2, 0, 0));
        assert_eq!(stats.packets, packets.len() as u64);
    }

    #[test]
    fn a_hole_in_a_used_buffer_shows_nothing_of_the_frame_before() {
        let mut packets = stream(&DEPTH_11, 3, 0);
        packets.drain(300..320);
        let mut assembler = Assembler::new(&DEPTH_11);
        for p in &packets {
            let mut done = Vec::new();
            assembler.push(p, &mut |f| done.push(f));
            check_honest(&DEPTH_11, &done);
            done.into_iter().for_each(|f| assembler.give(f.bytes));
        }
        assert_eq!(assembler.stats().incomplete_frames, 1);
    }

    #[test]
    fn the_first_frame_is_waited_for() {
        let packets = stream(&DEPTH_11, 3, 0);
        let (frames, stats) = assemble(&DEPTH_11, &packets[100..]);
        check_honest(&DEPTH_11, &frames);
        assert_eq!((frames.len(), stats.skipped, stats.missing), (2, 142, 0));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn loss_is_counted_to_the_packet(losses in proptest::collection::vec((0usize..1200, 1usize..40), 0..60)) {
            let packets = stream(&DEPTH_11, 5, 77);
            let mut keep = vec![true; packets.len()];
            for (at, len) in losses {
                // The first packet and the last are kept, so that both ends of the stream are known.
                for k in keep.iter_mut().take(packets.len() - 1).skip(at.max(1)).take(len) {
                    *k = false;
                }
            }
            // Longer runs exceed the sequence numbers.
            prop_assume!(keep.split(|k| *k).all(|run| run.len() < 200));
            let sent: Vec<_> = packets.iter().zip(&keep).filter(|(_, k)| **k).map(|(p, _)| p.clone()).collect();
            let (frames, stats) = assemble(&DEPTH_11, &sent);
            check_honest(&DEPTH_11, &frames);
            prop_assert_eq!(stats.missing as usize, packets.len() - sent.len());
            prop_assert_eq!(stats.resyncs, 0);
        }

        #[test]
        fn whatever_the_bytes(packets in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..40), 0..60), order in proptest::collection::vec(0usize..490, 0..600)) {
            let sound = stream(&DEPTH_11, 2, 0);
            let mut mixed: Vec<Vec<u8>> = order.iter().filter_map(|&i| sound.get(i).cloned()).collect();
            mixed.extend(packets);
            assemble(&DEPTH_11, &mixed);
        }
    }
}
