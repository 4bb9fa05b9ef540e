//! `lumiscan record`: the frames or USB packets of a Kinect to a file.

use crate::cli;
use crate::commands::output::check_parent;
use crate::commands::output::print;
use crate::commands::output::print_json;
use crate::commands::settings::load;
use crate::device_folder::disk;
use crate::failure::Failure;
use crate::kinect::driver::{Kinect, Led};
use crate::kinect::live::{Live, LiveStats, Polled};
use crate::kinect::protocol::KinectError;
use crate::report::{Reporter, Step};
use crate::sources::sensor;
use crate::stop::Stop;
use crossbeam_channel::{Receiver, bounded};
use recordings::recording::{Event, RecordingKind, RecordingWriter};
use recordings::types::{Accelerometer, UsbPacket};
use serde_json::json;
use std::path::Path;

/// Batches waiting for the disk: a second of frames, or three of packets (of at most 2.4 MB each).
const QUEUED: usize = 64;
/// Bytes of packets in a batch: the queue then holds some seconds of them while the disk pauses.
const BATCH_BYTES: usize = 1 << 20;
/// Bytes per second of raw packets, file headers included.
const RAW_RATE: f64 = 22.5e6;
/// Bytes per second of compressed frames, at most.
const FRAME_RATE: f64 = 17.0e6;
/// Length that must fit on the disk where `--seconds` is not given.
const OPEN_END_S: f64 = 60.0;

/// Runs the command.
pub fn run(args: &cli::Record, as_json: bool, reporter: &Reporter) -> Result<(), Failure> {
    check_parent(&args.output)?;
    #[cfg(feature = "openni")]
    if let Some(address) = &args.openni {
        return crate::commands::openni::run(address, args, as_json, reporter);
    }
    let config = load(&args.settings)?;
    let mut bus = sensor::bus(args.simulate.as_ref())?;
    let kinect = Kinect::open(bus.as_mut(), &config.kinect.serial, &config.kinect).map_err(sensor::failure)?;
    let folder = args.output.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let rate = if args.raw { RAW_RATE } else { FRAME_RATE };
    disk::require(folder, rate, args.seconds.unwrap_or(OPEN_END_S))?;

    let (kind, content) =
        if args.raw { (RecordingKind::Packets, "packets") } else { (RecordingKind::Frames, "frames") };
    let described = sensor::describe(&kinect, &config);
    let writer =
        RecordingWriter::create(&args.output, kind, &described).map_err(|e| Failure::Internal(e.to_string()))?;
    let live = Live::start(kinect, &config.kinect).map_err(sensor::failure)?;
    let stop = Stop::on_signals()?;
    let (out, events) = bounded::<Vec<Event>>(QUEUED);
    let (counted, gone) = std::thread::scope(|scope| {
        let disk = std::thread::Builder::new()
            .name("disk".into())
            .spawn_scoped(scope, || write(writer, &events))
            .map_err(|e| Failure::Internal(format!("thread `disk` could not be started: {e}")))?;
        let session = Session::new(live, args.raw, args.seconds);
        // A slow disk fills the queue and then the ring, which counts what it drops.
        let streamed = session.run(&stop, reporter, |batch| out.send(batch).is_ok());
        drop(out);
        disk.join().unwrap_or_else(|panic| Err(Failure::panic(panic.as_ref())))?;
        streamed
    })?;
    reporter.clear();
    if as_json {
        print_json(&json!({ "recording": args.output, "kind": content, "counters": counters(&counted) }))?;
    } else {
        let (d, c) = (counted.streams.depth, counted.streams.color);
        tracing::info!(
            "{} depth and {} colour frames, {} of them incomplete · {} packets, {} missing, {} dropped here",
            d.frames,
            c.frames,
            d.incomplete_frames + c.incomplete_frames,
            counted.ring.packets,
            d.missing + c.missing,
            counted.ring.dropped
        );
        print(&args.output.display().to_string())?;
    }
    if gone && counted.streams.depth.frames == 0 {
        return Err(Failure::Input("the Kinect was unplugged before its first frame; plug it in again".into()));
    }
    if gone {
        return Err(Failure::Input("the Kinect was unplugged; the recording is complete up to there".into()));
    }
    Ok(())
}

fn write(mut writer: RecordingWriter, events: &Receiver<Vec<Event>>) -> Result<(), Failure> {
    for event in events.iter().flatten() {
        writer.write(&event).map_err(|e| Failure::Internal(e.to_string()))?;
    }
    writer.finish().map_err(|e| Failure::Internal(e.to_string()))
}

/// A recording in progress.
struct Session {
    live: Live,
    raw: bool,
    /// Length of the recording on the device's clock.
    seconds: Option<f64>,
    /// Device time of the first frame and of the newest, in nanoseconds.
    first: Option<i64>,
    newest: i64,
    /// Events on their way to the disk, and the bytes of USB packets received meanwhile.
    batch: Vec<Event>,
    batch_bytes: usize,
}

impl Session {
    fn new(live: Live, raw: bool, seconds: Option<f64>) -> Self {
        // Commands and calibration come first: they say how the packets are to be decoded.
        let batch = if raw { live.kinect().traffic().iter().cloned().map(Event::Packet).collect() } else { Vec::new() };
        Self { live, raw, seconds, first: None, newest: 0, batch, batch_bytes: 0 }
    }

    /// Streams until the length is reached, a signal came, the Kinect is gone, or `out` accepts no more; true if it is gone.
    fn run(
        mut self,
        stop: &Stop,
        reporter: &Reporter,
        out: impl Fn(Vec<Event>) -> bool,
    ) -> Result<(LiveStats, bool), Failure> {
        self.live.set_led(Led::Scanning);
        let mut silent = None;
        let gone = loop {
            if let Some(stream) = self.live.silent_stream().filter(|s| silent != Some(*s)) {
                tracing::warn!("no {stream} frames arrive; plug the Kinect into a USB 2 port of its own");
                silent = Some(stream);
            }
            let polled = self.poll();
            let full = if self.raw { self.batch_bytes >= BATCH_BYTES } else { !self.batch.is_empty() };
            let accepted = !full || {
                self.batch_bytes = 0;
                out(std::mem::take(&mut self.batch))
            };
            self.report(reporter);
            match polled {
                Ok(Polled::Gone) => break true,
                // What came before the failure is worth keeping.
                Err(e) if self.first.is_some() => {
                    tracing::warn!("{e}");
                    break true;
                }
                Err(e) => return Err(sensor::failure(e)),
                Ok(_) if self.is_over() || !accepted || stop.check().is_err() => break false,
                Ok(_) => {}
            }
        };
        // The disk thread returns its own error.
        let _ = out(self.batch);
        self.live.set_led(if gone { Led::Error } else { Led::Ready });
        Ok((self.live.stats(), gone))
    }

    /// Moves what the Kinect sent into the batch.
    fn poll(&mut self) -> Result<Polled, KinectError> {
        let (raw, bytes) = (self.raw, &mut self.batch_bytes);
        let (mut packets, mut events, mut host_ns) = (Vec::new(), Vec::new(), 0);
        let polled = self.live.poll(
            &mut |p, data| {
                host_ns = p.host_ns;
                *bytes += data.len();
                if raw {
                    let packet = UsbPacket { timestamp_ns: p.host_ns, endpoint: p.endpoint, data: data.to_vec() };
                    packets.push(Event::Packet(packet));
                }
            },
            &mut |event| events.push(event),
        );
        for event in &events {
            if matches!(event, Event::Depth(_) | Event::Color(_)) {
                let t = event.timestamp_ns();
                self.first = Some(self.first.map_or(t, |f| f.min(t)));
                self.newest = self.newest.max(t);
            }
        }
        if raw {
            // On the packets' clock, and before them: gravity is known before the first frame.
            self.batch.extend(events.into_iter().filter_map(|e| match e {
                Event::Accelerometer(a) => Some(Event::Accelerometer(Accelerometer { timestamp_ns: host_ns, ..a })),
                _ => None,
            }));
            self.batch.append(&mut packets);
        } else {
            self.batch.append(&mut events);
        }
        polled
    }

    /// Seconds recorded, on the device's clock.
    fn recorded_s(&self) -> f64 {
        self.first.map_or(0.0, |f| (self.newest - f) as f64 * 1e-9)
    }

    fn is_over(&self) -> bool {
        self.seconds.is_some_and(|limit| self.recorded_s() >= limit)
    }

    fn report(&self, reporter: &Reporter) {
        let recorded = self.recorded_s();
        let exposure = self.live.exposure_us().map_or(String::new(), |us| format!(" · exposure {us:.0} µs"));
        let frames = self.live.stats().streams.depth.frames;
        reporter.step(&Step {
            stage: "record".into(),
            fraction: self.seconds.map(|s| (recorded / s).min(1.0)),
            detail: format!("{recorded:.1} s · {frames} depth frames{exposure}"),
        });
    }
}

/// Every counter of a session, for programs.
pub fn counters(s: &LiveStats) -> serde_json::Value {
    let stream = |p: &crate::kinect::packet_assembler::PacketStats| {
        json!({ "packets": p.packets, "missing": p.missing, "short": p.short, "garbage": p.garbage, "stale": p.stale,
                "skipped": p.skipped, "resyncs": p.resyncs, "frames": p.frames,
                "incomplete_frames": p.incomplete_frames, "lost_frames": p.lost_frames })
    };
    json!({ "ring_packets": s.ring.packets, "ring_dropped": s.ring.dropped, "bad_status": s.ring.bad_status,
            "restarts": s.restarts, "depth": stream(&s.streams.depth), "color": stream(&s.streams.color) })
}
