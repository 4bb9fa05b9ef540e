//! `lumiscan record`: what a Kinect sends, to a file.

use crate::cli;
use crate::commands::output::check_parent;
use crate::commands::output::print;
use crate::commands::output::print_json;
use crate::commands::settings::load;
use crate::device_folder::disk;
use crate::failure::Failure;
use crate::kinect::driver::{Kinect, Led};
use crate::kinect::live::{Live, LiveStats, Polled};
use crate::report::{Reporter, Step};
use crate::sources::sensor;
use crate::stop::Stop;
use crossbeam_channel::{Receiver, bounded};
use recordings::recording::{Event, RecordingKind, RecordingWriter};
use recordings::types::UsbPacket;
use serde_json::json;
use std::path::Path;

/// Batches waiting for the disk: a second of frames, or three of packets (of at most 2.4 MB each).
const QUEUED: usize = 64;
/// Packets are handed on by so many bytes, so that the queue holds some seconds of them while a disk rests.
const GATHERED: usize = 1 << 20;
/// Bytes a second that raw packets come to, headers of the file included.
const RAW_RATE: f64 = 22.5e6;
/// The same for compressed frames, at worst.
const FRAME_RATE: f64 = 17.0e6;
/// Without `--seconds` there shall be room for so many.
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

    let kind = if args.raw { RecordingKind::Packets } else { RecordingKind::Frames };
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
        let session = Session { live, raw: args.raw, seconds: args.seconds, first: None, newest: 0 };
        // A disk that is too slow fills the queue and then the ring, whose overflow is counted.
        let streamed = session.run(&stop, reporter, |batch| out.send(batch).is_ok());
        drop(out);
        disk.join().unwrap_or_else(|panic| Err(Failure::panic(panic.as_ref())))?;
        streamed
    })?;
    reporter.clear();
    if as_json {
        print_json(
            &json!({ "recording": args.output, "kind": format!("{kind:?}").to_lowercase(), "counters": counters(&counted) }),
        )?;
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

struct Session {
    live: Live,
    raw: bool,
    seconds: Option<f64>,
    /// Device time of the first frame and of the newest, in nanoseconds.
    first: Option<i64>,
    newest: i64,
}

impl Session {
    /// Streams until the time is over, a signal came, the Kinect is gone, or `out` takes no more; true if it is gone.
    fn run(
        mut self,
        stop: &Stop,
        reporter: &Reporter,
        out: impl Fn(Vec<Event>) -> bool,
    ) -> Result<(LiveStats, bool), Failure> {
        self.live.set_led(Led::Scanning);
        if self.raw {
            // How the streams are to be read stands first.
            let traffic = self.live.kinect().traffic().iter().cloned().map(Event::Packet).collect();
            if !out(traffic) {
                return Ok((self.live.stats(), false));
            }
        }
        let (mut told, mut batch, mut bytes) = (None, Vec::new(), 0);
        let gone = loop {
            if let Some(stream) = self.live.silent_stream().filter(|s| told != Some(*s)) {
                tracing::warn!("no {stream} frames come; plug the Kinect into a USB 2 port of its own");
                told = Some(stream);
            }
            let (mut packets, mut events, mut host_ns) = (Vec::new(), Vec::new(), 0);
            let raw = self.raw;
            let polled = self.live.poll(
                &mut |p, data| {
                    host_ns = p.host_ns;
                    bytes += data.len();
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
                // Before the packets, so that where up is stands before the first frame; on the packets' clock.
                events.retain_mut(|e| match e {
                    Event::Accelerometer(a) => {
                        a.timestamp_ns = host_ns;
                        true
                    }
                    _ => false,
                });
                events.append(&mut packets);
            }
            batch.append(&mut events);
            let full = if raw { bytes >= GATHERED } else { !batch.is_empty() };
            let taken = !full || out(std::mem::take(&mut batch));
            if full {
                bytes = 0;
            }
            let seconds = self.first.map_or(0.0, |f| (self.newest - f) as f64 * 1e-9);
            let over = self.seconds.is_some_and(|limit| seconds >= limit);
            let exposure = self.live.exposure_us().map_or(String::new(), |us| format!(" · exposure {us:.0} µs"));
            let frames = self.live.stats().streams.depth.frames;
            let detail = format!("{seconds:.1} s · {frames} depth frames{exposure}");
            reporter.step(&Step {
                stage: "record".into(),
                fraction: self.seconds.map(|s| (seconds / s).min(1.0)),
                detail,
            });
            match polled {
                Ok(Polled::Gone) => break true,
                // What came before it fell silent is worth keeping.
                Err(e) if self.first.is_some() => {
                    tracing::warn!("{e}");
                    break true;
                }
                Err(e) => return Err(sensor::failure(e)),
                Ok(_) if over || !taken || stop.check().is_err() => break false,
                Ok(_) => {}
            }
        };
        // A disk that takes no more says so itself.
        let _ = out(batch);
        self.live.set_led(if gone { Led::Error } else { Led::Ready });
        Ok((self.live.stats(), gone))
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
