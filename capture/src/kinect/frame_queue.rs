//! From the USB callback to the reader: packets are assembled where they arrive, and whole frames are handed over. A reader
//! that is too slow costs whole frames, of both streams, before a byte of them is copied.

use crate::kinect::buffers::{Buffers, Pool};
use crate::kinect::packet_assembler::{Assembled, Assembler, PacketStats};
use crate::lock::lock;
use firmware_config::kinect_models::StreamFormat;
use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

/// Frames beyond the queue whose buffers are kept: being assembled, decoded, paired and fused.
const FRAMES_IN_WORK: usize = 12;
/// Bytes of packets that are handed over at once, where packets are kept.
const BATCH_BYTES: usize = 1 << 20;
/// Batches of packets that may wait for the reader: three seconds.
const QUEUED_BATCHES: usize = 64;
/// Bytes before each packet in a batch: endpoint, length, host time.
const RECORD_HEADER: usize = 11;

/// What the reader wants.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wanted {
    /// The newest frames.
    NewFrames,
    /// All frames: a second of them may wait.
    AllFrames,
    /// All frames, and the packets that they were made of.
    Packets,
}

impl Wanted {
    /// Frames of both streams that may wait for the reader.
    fn queued(self) -> usize {
        match self {
            Self::NewFrames => 16,
            Self::AllFrames | Self::Packets => 60,
        }
    }
}

/// Counters of the queue.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct QueueStats {
    /// Packets that arrived.
    pub packets: u64,
    /// Packets that were to be kept, and were dropped because the reader was too slow.
    pub dropped_packets: u64,
    /// Packets that the host controller flagged (missed service, babble).
    pub flagged: u64,
}

/// One of the two streams.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StreamKind {
    /// Depth.
    Depth,
    /// Colour.
    Color,
}

/// A frame and the host time of its last packet, in nanoseconds.
#[derive(Debug)]
pub struct ArrivedFrame {
    /// Its stream.
    pub stream: StreamKind,
    /// Host time in nanoseconds.
    pub host_ns: i64,
    /// The frame.
    pub frame: Assembled,
}

/// A packet in a batch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arrived<'a> {
    /// Endpoint address.
    pub endpoint: u8,
    /// Host time of arrival in nanoseconds.
    pub host_ns: i64,
    /// Its bytes.
    pub data: &'a [u8],
}

struct State {
    depth: (u8, Assembler),
    color: (u8, Assembler),
    frames: VecDeque<ArrivedFrame>,
    /// Frames that may wait.
    queued: usize,
    /// Frames are turned away until half of the queue is free, so that what is left are pairs in a row and not single frames.
    full: bool,
    packets: Option<Packets>,
    stats: QueueStats,
    gone: bool,
}

/// Packets on their way to the reader.
struct Packets {
    /// The batch being filled.
    open: Vec<u8>,
    full: VecDeque<Vec<u8>>,
    spare: Vec<Vec<u8>>,
}

struct Shared {
    state: Mutex<State>,
    /// Signalled when there is something to take, or nothing more will come.
    filled: Condvar,
}

/// The end of the USB callback. It waits for nothing but the reader's taking of one buffer.
pub struct PacketSink(Arc<Shared>);

/// The end of the reader.
pub struct FrameSource {
    shared: Arc<Shared>,
    /// Counters before the session.
    before: (QueueStats, [PacketStats; 2]),
}

/// A queue for streams of these formats, and the pools of their buffers.
#[must_use]
pub fn frame_queue(
    depth: &'static StreamFormat,
    color: &'static StreamFormat,
    wanted: Wanted,
) -> (FrameSource, Buffers) {
    let made = wanted.queued() / 2 + FRAMES_IN_WORK;
    let pixels = (depth.width * depth.height) as usize;
    let buffers = Buffers {
        packed: Pool::new(depth.frame_bytes(), made, made),
        color: Pool::new(color.frame_bytes(), made, made),
        // Depth is decoded when the frame is taken out of the queue.
        depth: Pool::new(pixels, FRAMES_IN_WORK, FRAMES_IN_WORK),
    };
    let state = State {
        depth: (depth.endpoint, Assembler::pooled(depth, buffers.packed.clone())),
        color: (color.endpoint, Assembler::pooled(color, buffers.color.clone())),
        frames: VecDeque::with_capacity(wanted.queued() + 1),
        queued: wanted.queued(),
        full: false,
        packets: (wanted == Wanted::Packets).then(Packets::new),
        stats: QueueStats::default(),
        gone: false,
    };
    let shared = Arc::new(Shared { state: Mutex::new(state), filled: Condvar::new() });
    (FrameSource { shared, before: Default::default() }, buffers)
}

impl Packets {
    fn new() -> Self {
        Self { open: Vec::with_capacity(BATCH_BYTES), full: VecDeque::new(), spare: Vec::new() }
    }

    /// False if there is no room.
    fn push(&mut self, packet: Arrived<'_>) -> bool {
        let Ok(length) = u16::try_from(packet.data.len()) else { return false };
        if self.open.len() + RECORD_HEADER + packet.data.len() > BATCH_BYTES {
            if self.full.len() >= QUEUED_BATCHES {
                return false;
            }
            let next = self.spare.pop().unwrap_or_else(|| Vec::with_capacity(BATCH_BYTES));
            self.full.push_back(std::mem::replace(&mut self.open, next));
        }
        self.open.push(packet.endpoint);
        self.open.extend_from_slice(&length.to_le_bytes());
        self.open.extend_from_slice(&packet.host_ns.to_le_bytes());
        self.open.extend_from_slice(packet.data);
        true
    }

    fn take(&mut self) -> Option<Vec<u8>> {
        if let Some(full) = self.full.pop_front() {
            return Some(full);
        }
        if self.open.is_empty() {
            return None;
        }
        let next = self.spare.pop().unwrap_or_else(|| Vec::with_capacity(BATCH_BYTES));
        Some(std::mem::replace(&mut self.open, next))
    }
}

/// The packets of a batch.
pub fn packets_of(mut batch: &[u8]) -> impl Iterator<Item = Arrived<'_>> {
    std::iter::from_fn(move || {
        let (&[endpoint, l0, l1, ref time @ ..], rest) = batch.split_first_chunk::<RECORD_HEADER>()?;
        let (data, rest) = rest.split_at_checked(usize::from(u16::from_le_bytes([l0, l1])))?;
        batch = rest;
        Some(Arrived { endpoint, host_ns: i64::from_le_bytes(*time), data })
    })
}

impl PacketSink {
    /// Takes the packets of a transfer; the reader is woken if they complete a frame.
    pub fn push<'a>(&mut self, endpoint: u8, host_ns: i64, packets: impl Iterator<Item = &'a [u8]>) {
        let mut state = lock(&self.0.state);
        let State { depth, color, frames, queued, full, packets: kept, stats, .. } = &mut *state;
        *full = frames.len() >= if *full { *queued / 2 } else { *queued };
        depth.1.set_accepting(!*full);
        color.1.set_accepting(!*full);
        let (before, mut filled) = (frames.len(), false);
        let mut stream = match endpoint {
            e if e == depth.0 => Some((StreamKind::Depth, &mut depth.1)),
            e if e == color.0 => Some((StreamKind::Color, &mut color.1)),
            _ => None,
        };
        for data in packets {
            stats.packets += 1;
            if let Some(kept) = kept {
                let batches = kept.full.len();
                stats.dropped_packets += u64::from(!kept.push(Arrived { endpoint, host_ns, data }));
                filled |= kept.full.len() > batches;
            }
            if let Some((stream, assembler)) = &mut stream {
                assembler.push(data, &mut |frame| {
                    frames.push_back(ArrivedFrame { stream: *stream, host_ns, frame });
                });
            }
        }
        let wake = filled || frames.len() > before;
        drop(state);
        if wake {
            self.0.filled.notify_one();
        }
    }

    /// Counts packets that the host controller flagged.
    pub fn flag(&mut self, packets: u64) {
        if packets > 0 {
            lock(&self.0.state).stats.flagged += packets;
        }
    }

    /// True if neither a frame nor packets would be dropped now.
    #[must_use]
    pub fn has_room(&self) -> bool {
        let state = lock(&self.0.state);
        state.frames.len() < state.queued / 2 && state.packets.as_ref().is_none_or(|p| p.full.len() < QUEUED_BATCHES)
    }

    /// Marks the end of the streams: unplugged or failed.
    pub fn set_gone(&mut self) {
        lock(&self.0.state).gone = true;
        self.0.filled.notify_one();
    }
}

impl FrameSource {
    /// An end for another session of the same streams.
    #[must_use]
    pub fn sink(&self) -> PacketSink {
        lock(&self.shared.state).gone = false;
        PacketSink(Arc::clone(&self.shared))
    }

    /// The oldest frame that waits.
    pub fn frame(&mut self) -> Option<ArrivedFrame> {
        lock(&self.shared.state).frames.pop_front()
    }

    /// The packets that wait, in batches for [`packets_of`]; to be given back.
    pub fn packets(&mut self) -> Option<Vec<u8>> {
        lock(&self.shared.state).packets.as_mut()?.take()
    }

    /// Takes back a batch of packets.
    pub fn give(&mut self, mut batch: Vec<u8>) {
        batch.clear();
        if let Some(packets) = &mut lock(&self.shared.state).packets {
            packets.spare.push(batch);
        }
    }

    /// Waits until there is something to take, or nothing more will come, at most for `limit`.
    pub fn wait(&mut self, limit: Duration) {
        let state = lock(&self.shared.state);
        let batch = state.packets.as_ref().is_some_and(|p| !p.full.is_empty());
        if state.frames.is_empty() && !batch && !state.gone {
            drop(self.shared.filled.wait_timeout(state, limit));
        }
    }

    /// Discards what waits if anything was dropped, so that the streams begin without a gap.
    pub fn discard_if_overflowed(&mut self) {
        let mut state = lock(&self.shared.state);
        let State { depth, color, frames, full, packets, stats, .. } = &mut *state;
        let (before, [depth_before, color_before]) = self.before;
        if stats.dropped_packets == before.dropped_packets
            && depth.1.stats().dropped_frames == depth_before.dropped_frames
            && color.1.stats().dropped_frames == color_before.dropped_frames
        {
            return;
        }
        frames.drain(..).for_each(|f| match f.stream {
            StreamKind::Depth => depth.1.give(f.frame.bytes),
            StreamKind::Color => color.1.give(f.frame.bytes),
        });
        *full = false;
        depth.1.begin(depth_before);
        color.1.begin(color_before);
        *stats = before;
        if let Some(packets) = packets {
            packets.full.clear();
            packets.open.clear();
        }
    }

    /// Ends the streams: incomplete last frames are counted as lost.
    pub fn end(&mut self) {
        let mut state = lock(&self.shared.state);
        state.depth.1.end();
        state.color.1.end();
        drop(state);
        self.before = self.stats();
    }

    /// True after the end of the streams; frames may still wait.
    #[must_use]
    pub fn gone(&self) -> bool {
        lock(&self.shared.state).gone
    }

    /// Counters.
    #[must_use]
    pub fn stats(&self) -> (QueueStats, [PacketStats; 2]) {
        let state = lock(&self.shared.state);
        (state.stats, [state.depth.1.stats(), state.color.1.stats()])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_config::kinect_models::{BAYER_VGA, DEPTH_11};

    /// Packets of one frame of a stream.
    fn packets(format: &StreamFormat, frame: usize) -> Vec<Vec<u8>> {
        let n = format.packets();
        let place = |i| {
            if i == 0 {
                1
            } else if i + 1 == n {
                5
            } else {
                2
            }
        };
        (0..n)
            .map(|i| {
                let mut p = vec![b'R', b'B', 0, format.stream_id | place(i), 0, (frame * n + i) as u8, 0, 0];
                p.extend_from_slice(&(frame as u32 * format.period_ticks() + 1).to_le_bytes());
                p.resize(12 + format.payload_of(i), frame as u8);
                p
            })
            .collect()
    }

    fn send(sink: &mut PacketSink, frames: std::ops::Range<usize>) {
        for frame in frames {
            for format in [&DEPTH_11, &BAYER_VGA] {
                for (i, transfer) in packets(format, frame).chunks(16).enumerate() {
                    sink.push(format.endpoint, (frame * 100 + i) as i64, transfer.iter().map(Vec::as_slice));
                }
            }
        }
    }

    #[test]
    fn a_slow_reader_loses_whole_frames_of_both_streams() {
        let (mut source, _) = frame_queue(&DEPTH_11, &BAYER_VGA, Wanted::NewFrames);
        let mut sink = source.sink();
        let queued = Wanted::NewFrames.queued();
        let sent = 2 * queued;
        send(&mut sink, 0..sent);
        assert!(!sink.has_room());
        let frames: Vec<_> = std::iter::from_fn(|| source.frame()).collect();
        let (stats, [depth, color]) = source.stats();
        assert_eq!(frames.len(), queued);
        assert!(frames.iter().all(|f| f.frame.missing.is_empty()));
        for (kind, s) in [(StreamKind::Depth, depth), (StreamKind::Color, color)] {
            assert_eq!(frames.iter().filter(|f| f.stream == kind).count() as u64, s.frames);
            assert_eq!((s.frames, s.dropped_frames), (queued as u64 / 2, sent as u64 - queued as u64 / 2));
        }
        assert_eq!(stats.packets, depth.packets + color.packets);
        send(&mut sink, sent..sent + 1);
        assert_eq!(source.frame().map(|f| f.frame.bytes[0]), Some(sent as u8));
    }

    #[test]
    fn packets_are_kept_where_they_are_wanted() {
        let (mut source, _) = frame_queue(&DEPTH_11, &BAYER_VGA, Wanted::Packets);
        send(&mut source.sink(), 0..2);
        let mut expected = Vec::new();
        for frame in 0..2 {
            for format in [&DEPTH_11, &BAYER_VGA] {
                expected.extend(packets(format, frame).into_iter().map(|p| (format.endpoint, p)));
            }
        }
        let mut got = Vec::new();
        while let Some(batch) = source.packets() {
            got.extend(packets_of(&batch).map(|p| (p.endpoint, p.data.to_vec())));
            source.give(batch);
        }
        assert!(got == expected);
        assert_eq!(source.stats().0, QueueStats { packets: expected.len() as u64, ..QueueStats::default() });
    }

    #[test]
    fn a_queue_that_ran_full_before_it_was_read_begins_anew() {
        let (mut source, _) = frame_queue(&DEPTH_11, &BAYER_VGA, Wanted::NewFrames);
        let mut sink = source.sink();
        send(&mut sink, 0..2);
        source.discard_if_overflowed();
        assert_eq!(source.stats().1[0].frames, 2, "nothing was lost");
        source.end();
        send(&mut sink, 2..40);
        source.discard_if_overflowed();
        assert!(source.frame().is_none());
        send(&mut sink, 40..41);
        let (_, [depth, color]) = source.stats();
        assert_eq!((depth.frames, depth.dropped_frames, color.frames, color.dropped_frames), (3, 0, 3, 0));
    }
}
