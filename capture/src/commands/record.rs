//! `lumiscan record`: the frames or USB packets of a Kinect to a file.

use crate::cli;
use crate::commands::output::check_parent;
use crate::commands::output::print;
use crate::commands::output::print_json;
use crate::commands::settings::load;
use crate::device_folder::disk;
use crate::failure::Failure;
use crate::kinect::driver::{Kinect, Led};
use crate::kinect::frame_queue::Wanted;
use crate::kinect::live::{Live, LiveStats, Polled};
use crate::kinect::protocol::KinectError;
use crate::report::{Reporter, Step};
use crate::sources::sensor;
use crate::stop::Stop;
use recordings::recording::{Event, RecordingKind, RecordingWriter};
use recordings::types::Accelerometer;
use serde_json::json;
use std::path::Path;

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
    let writer = RecordingWriter::create(&args.output, kind, &described).map_err(internal)?;
    let wanted = if args.raw { Wanted::Packets } else { Wanted::AllFrames };
    let live = Live::start(kinect, wanted, &config.kinect).map_err(sensor::failure)?;
    let stop = Stop::on_signals()?;
    let (counted, gone) = Session::new(live, writer, args).run(&stop, reporter)?;
    reporter.clear();
    if as_json {
        print_json(&json!({ "recording": args.output, "kind": content, "counters": counters(&counted) }))?;
    } else {
        let (d, c) = (counted.streams.depth, counted.streams.color);
        tracing::info!(
            "{} depth and {} colour frames, {} of them incomplete, {} dropped here · {} packets, {} missing, {} dropped here",
            d.frames,
            c.frames,
            d.incomplete_frames + c.incomplete_frames,
            d.dropped_frames + c.dropped_frames,
            counted.queue.packets,
            d.missing + c.missing,
            counted.queue.dropped_packets
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

/// A recording in progress. One thread decodes, codes and writes: a slow disk fills the queue before it, whose frames are
/// still packed.
struct Session {
    live: Live,
    writer: RecordingWriter,
    raw: bool,
    /// Length of the recording on the device's clock.
    seconds: Option<f64>,
    /// Device time of the first frame and of the newest, in nanoseconds.
    first: Option<i64>,
    newest: i64,
    /// Host time of the newest packet, in nanoseconds.
    host_ns: i64,
    /// Frames and readings to be written.
    events: Vec<Event>,
}

impl Session {
    fn new(live: Live, writer: RecordingWriter, args: &cli::Record) -> Self {
        Self {
            live,
            writer,
            raw: args.raw,
            seconds: args.seconds,
            first: None,
            newest: 0,
            host_ns: 0,
            events: Vec::new(),
        }
    }

    /// Streams until the length is reached, a signal came, or the Kinect is gone; true if it is gone.
    fn run(mut self, stop: &Stop, reporter: &Reporter) -> Result<(LiveStats, bool), Failure> {
        if self.raw {
            // Commands and calibration come first: they say how the packets are to be decoded.
            for p in self.live.kinect().traffic() {
                self.writer.write_packet(p.timestamp_ns, p.endpoint, &p.data).map_err(internal)?;
            }
        }
        self.live.set_led(Led::Scanning);
        let mut silent = None;
        let gone = loop {
            if let Some(stream) = self.live.silent_stream().filter(|s| silent != Some(*s)) {
                tracing::warn!("no {stream} frames arrive; plug the Kinect into a USB 2 port of its own");
                silent = Some(stream);
            }
            let polled = self.poll();
            self.write()?;
            self.report(reporter);
            match polled {
                Ok(Polled::Gone) => break true,
                // What came before the failure is worth keeping.
                Err(e) if self.first.is_some() => {
                    tracing::warn!("{e}");
                    break true;
                }
                Err(e) => return Err(sensor::failure(e)),
                Ok(_) if self.is_over() || stop.check().is_err() => break false,
                Ok(_) => {}
            }
        };
        self.live.set_led(if gone { Led::Error } else { Led::Ready });
        let counted = self.live.stats();
        // The streams end first: syncing the file takes time.
        drop(self.live);
        self.writer.finish().map_err(internal)?;
        Ok((counted, gone))
    }

    /// Takes what the Kinect sent.
    fn poll(&mut self) -> Result<Polled, KinectError> {
        let Self { live, events, .. } = self;
        let polled = live.poll(&mut |event| events.push(event));
        for event in &self.events {
            if matches!(event, Event::Depth(_) | Event::Color(_)) {
                let t = event.timestamp_ns();
                self.first = Some(self.first.map_or(t, |f| f.min(t)));
                self.newest = self.newest.max(t);
            }
        }
        polled
    }

    /// Writes what was taken.
    fn write(&mut self) -> Result<(), Failure> {
        self.host_ns = self.live.packets().last().map_or(self.host_ns, |p| p.host_ns);
        for event in self.events.drain(..) {
            match event {
                _ if !self.raw => self.writer.write(&event).map_err(internal)?,
                // On the packets' clock, and before them: gravity is known before the first frame.
                Event::Accelerometer(a) => {
                    let reading = Accelerometer { timestamp_ns: self.host_ns, ..a };
                    self.writer.write(&Event::Accelerometer(reading)).map_err(internal)?;
                }
                _ => {}
            }
            self.live.buffers().recycle(event);
        }
        for p in self.live.packets() {
            self.writer.write_packet(p.host_ns, p.endpoint, p.data).map_err(internal)?;
        }
        Ok(())
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

fn internal(e: recordings::error::Error) -> Failure {
    Failure::Internal(e.to_string())
}

/// Every counter of a session, for programs.
pub fn counters(s: &LiveStats) -> serde_json::Value {
    let stream = |p: &crate::kinect::packet_assembler::PacketStats| {
        json!({ "packets": p.packets, "missing": p.missing, "short": p.short, "garbage": p.garbage, "stale": p.stale,
                "skipped": p.skipped, "resyncs": p.resyncs, "frames": p.frames,
                "incomplete_frames": p.incomplete_frames, "lost_frames": p.lost_frames,
                "dropped_frames": p.dropped_frames })
    };
    json!({ "packets": s.queue.packets, "dropped_packets": s.queue.dropped_packets, "bad_status": s.queue.flagged,
            "restarts": s.restarts, "depth": stream(&s.streams.depth), "color": stream(&s.streams.color) })
}
