//! From a source to a scan file: one thread per stage, bounded queues between them.
//!
//! ```text
//! read ──2──▶ decode ──2──▶ fuse (this thread) ──4──▶ disk
//! ```
//!
//! A full queue blocks the stage before it, so a replay never drops a frame and gives the same scan on any machine. With
//! a live sensor, the oldest pair that waits for `decode` is dropped and counted.

use crate::failure::Failure;
use crate::kinect::buffers::Buffers;
use crate::orders::Orders;
use crate::report::{Reporter, Step};
use crate::serve::live::hub::Hub;
use crate::sources::pace::Pace;
use crate::sources::pairs::{Pairs, RawPair};
use crate::status::{Board, State};
use crate::stop::Stop;
use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use firmware_config::Config;
use firmware_config::tuning::GravityTuning;
use fusion::Fusion;
use fusion::FusionError;
use fusion::FusionOutput;
use fusion::Tracking;
use glam::DVec3;
use recordings::recording::Event;
use recordings::scan::{CaptureStats, FrameId, ScanTail, ScanWriter};
use recordings::types::{ColorFrame, Pose, RgbdFrame, Sensor, TimestampNs};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{Scope, ScopedJoinHandle};
use std::time::{Duration, Instant};

/// Frames waiting between two stages.
const QUEUED_FRAMES: usize = 2;
/// Keyframes waiting for the disk.
const QUEUED_KEYFRAMES: usize = 4;

/// Outcome of a capture, beside the scan file.
#[derive(Debug)]
pub struct Captured {
    /// Camera-to-world poses of the tracked frames with their colour frames' time stamps.
    pub trajectory: Vec<(TimestampNs, Pose)>,
    /// Counters.
    pub stats: CaptureStats,
    /// Vertices of the mesh.
    pub vertices: usize,
    /// Triangles of the mesh.
    pub triangles: usize,
    /// Keyframes kept.
    pub keyframes: usize,
    /// Time spent tracking and integrating.
    pub fusion: Duration,
    /// Time spent on the mesh and the choice of keyframes.
    pub extraction: Duration,
    /// Time spent writing the scan after its last frame.
    pub writing: Duration,
    /// When the last frame was fused.
    pub last_frame: Instant,
}

/// A decoded frame, the up vector in camera axes, and the share of the source that has been played.
type Played = (RgbdFrame, Option<DVec3>, f64);

/// Messages to the disk thread.
enum ToDisk {
    Frame(FrameId, ColorFrame),
    Finish(Box<ScanTail>),
}

/// Input, output and settings of a capture.
#[derive(Clone, Copy)]
pub struct Job<'a> {
    /// Name of the scan.
    pub name: &'a str,
    /// Its source, for messages.
    pub source: &'a Path,
    /// The scan file to write.
    pub scan: &'a Path,
    /// Settings.
    pub config: &'a Config,
    /// Receives the figures of a scan.
    pub board: Option<&'a Board>,
    /// The user's requests; without them, nobody can pause or name the scan.
    pub orders: Option<&'a Orders>,
    /// Shows the scan to whoever watches.
    pub hub: Option<&'a Hub>,
    /// The source is played at its own speed.
    pub paced: bool,
}

/// Fuses `pairs` into a scan file.
///
/// # Errors
/// The source is damaged, the disk full, tracking never held, or a signal came.
pub fn run(pairs: Pairs, job: &Job<'_>, stop: &Stop, reporter: &Reporter) -> Result<Captured, Failure> {
    let Job { name, source: source_path, scan: scan_path, config, board, orders, hub, paced } = *job;
    let sensor = pairs.sensor(&config.capture);
    let bad_input =
        |e: FusionError| Failure::Input(format!("{}: {e}; record or import it again", source_path.display()));
    let fusion = Fusion::new(&sensor, &config.fusion_of(&sensor.serial)).map_err(bad_input)?;
    if let Some(hub) = hub {
        hub.begin(&sensor, config.fusion.pool_blocks);
    }
    let writer = ScanWriter::create(scan_path).map_err(|e| Failure::Internal(e.to_string()))?;

    let buffers = pairs.buffers();
    let (raw_out, raw_in) = bounded::<RawPair>(QUEUED_FRAMES);
    let (frame_out, frame_in) = bounded::<Played>(QUEUED_FRAMES);
    let (disk_out, disk_in) = bounded::<ToDisk>(QUEUED_KEYFRAMES);
    let over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        // A live sensor drops the oldest waiting pair; any other source waits.
        let drop_oldest = pairs.drops_when_slow().then(|| DropOldest {
            oldest: raw_in.clone(),
            over: &over,
            buffers: buffers.clone(),
        });
        let pace = orders.filter(|_| paced).map(|orders| Pace::new(orders, stop));
        let reader = start(scope, "read", move || read(pairs, &raw_out, drop_oldest, board, pace));
        let path: PathBuf = source_path.into();
        let decoder =
            start(scope, "decode", move || decode(&raw_in, &frame_out, &path, &config.capture.tuning.gravity));
        let disk = start(scope, "disk", {
            let buffers = buffers.clone();
            move || write(writer, &disk_in, &buffers)
        });

        let fused =
            fuse(fusion, &frame_in, &disk_out, stop, Observers { reporter, board, orders, hub }, &buffers, bad_input);
        // Ends the stages before this one if this one ended first.
        over.store(true, Ordering::Relaxed);
        drop(frame_in);
        // The stage nearest to the source reports the first error.
        let capture_stats = join(reader)?;
        join(decoder)?;
        let finished = fused.and_then(|fused| {
            let given = orders.and_then(Orders::name);
            let name = given.as_deref().unwrap_or(name);
            let tail = Box::new(tail(name, &sensor, config, fused.output, &capture_stats));
            let captured = Captured {
                trajectory: fused.trajectory,
                stats: tail.stats.clone(),
                vertices: tail.mesh.positions.len(),
                triangles: tail.mesh.triangles.len(),
                keyframes: tail.keyframes.len(),
                fusion: fused.fusion,
                extraction: fused.extraction,
                writing: Duration::ZERO,
                last_frame: fused.last_frame,
            };
            usable(&captured, source_path)?;
            let _ = disk_out.send(ToDisk::Finish(tail));
            Ok(captured)
        });
        drop(disk_out);
        let started = Instant::now();
        join(disk)?;
        finished.map(|captured| Captured { writing: started.elapsed(), ..captured })
    })
}

/// What the reader of a live sensor needs to drop the oldest pair instead of waiting.
struct DropOldest<'a> {
    /// The receiving end of the queue: takes its oldest pair when it is full.
    oldest: Receiver<RawPair>,
    /// Set when the receiver is gone, which the sender cannot see because `oldest` is a second receiver.
    over: &'a AtomicBool,
    /// Takes the buffers of what is dropped.
    buffers: Buffers,
}

fn read(
    mut pairs: Pairs,
    out: &Sender<RawPair>,
    drop_oldest: Option<DropOldest<'_>>,
    board: Option<&Board>,
    mut pace: Option<Pace<'_>>,
) -> Result<CaptureStats, Failure> {
    let mut dropped_pairs = 0;
    while let Some(pair) = pairs.next_pair()? {
        if pace.as_mut().is_some_and(|pace| !pace.wait(pair.color.timestamp_ns)) {
            break;
        }
        let sent = match &drop_oldest {
            Some(drop_oldest) => send_newest(pair, out, drop_oldest, &mut dropped_pairs),
            None => out.send(pair).is_ok(),
        };
        if let Some(board) = board {
            board.pairing(&CaptureStats { dropped_pairs, ..pairs.stats() });
        }
        if !sent {
            break;
        }
    }
    Ok(CaptureStats { dropped_pairs, ..pairs.stats() })
}

/// Sends without waiting: drops and counts the oldest pair of a full queue. False if the receiver is gone.
fn send_newest(mut pair: RawPair, out: &Sender<RawPair>, drop_oldest: &DropOldest<'_>, dropped: &mut u64) -> bool {
    while !drop_oldest.over.load(Ordering::Relaxed) {
        match out.try_send(pair) {
            Ok(()) => return true,
            Err(TrySendError::Disconnected(_)) => return false,
            Err(TrySendError::Full(back)) => {
                // The next stage may have taken it meanwhile.
                if let Ok(oldest) = drop_oldest.oldest.try_recv() {
                    *dropped += 1;
                    drop_oldest.buffers.recycle(Event::Depth(oldest.depth));
                    drop_oldest.buffers.recycle(Event::Color(oldest.color));
                }
                pair = back;
            }
        }
    }
    false
}

fn decode(raw: &Receiver<RawPair>, out: &Sender<Played>, path: &Path, gravity: &GravityTuning) -> Result<(), Failure> {
    let gravity_m_s2 = gravity.min_m_s2..gravity.max_m_s2;
    for RawPair { color, depth, acceleration, played } in raw {
        let rgb = color.decode().map_err(|problem| {
            let (shown, time) = (path.display(), color.timestamp_ns as f64 * 1e-9);
            Failure::Input(format!(
                "{shown}: the colour frame at {time:.6} s: {problem}; replace it, or remove it from the list"
            ))
        })?;
        // An accelerometer at rest measures the upward reaction to gravity.
        let up = acceleration.map(|a| DVec3::from(a.map(f64::from))).filter(|a| gravity_m_s2.contains(&a.length()));
        if out.send((RgbdFrame { depth, color, rgb }, up, played)).is_err() {
            break;
        }
    }
    Ok(())
}

fn write(mut writer: ScanWriter, disk: &Receiver<ToDisk>, buffers: &Buffers) -> Result<(), Failure> {
    for order in disk {
        match order {
            ToDisk::Frame(id, color) => {
                let written = writer.add_frame(id, &color);
                buffers.recycle(Event::Color(color));
                written
            }
            ToDisk::Finish(tail) => return writer.finish(&tail).map_err(|e| Failure::Internal(e.to_string())),
        }
        .map_err(|e| Failure::Internal(e.to_string()))?;
    }
    Ok(())
}

/// Receivers of fusion's progress.
struct Observers<'a> {
    reporter: &'a Reporter,
    board: Option<&'a Board>,
    orders: Option<&'a Orders>,
    hub: Option<&'a Hub>,
}

struct Fused {
    output: FusionOutput,
    trajectory: Vec<(TimestampNs, Pose)>,
    fusion: Duration,
    extraction: Duration,
    last_frame: Instant,
}

fn fuse(
    mut fusion: Fusion,
    frames: &Receiver<Played>,
    disk: &Sender<ToDisk>,
    stop: &Stop,
    observers: Observers<'_>,
    buffers: &Buffers,
    bad_input: impl Fn(FusionError) -> Failure,
) -> Result<Fused, Failure> {
    let Observers { reporter, board, orders, hub } = observers;
    let started = Instant::now();
    let mut spent = Duration::ZERO;
    let (mut count, mut kept, mut lost) = (0u64, 0u64, false);
    for (frame, up, played) in frames {
        stop.check()?;
        if let Some(up) = up {
            // Has an effect until the first frame is tracked.
            fusion.set_gravity(up);
        }
        let paused = orders.is_some_and(Orders::is_paused);
        fusion.set_paused(paused);
        let push = Instant::now();
        let report = fusion.push(&frame).map_err(&bad_input)?;
        spent += push.elapsed();
        count += 1;
        let now_lost = report.tracking == Tracking::Lost;
        if now_lost != lost {
            lost = now_lost;
            let t = frame.color.timestamp_ns as f64 * 1e-9;
            tracing::warn!("tracking {} at {t:.3} s (frame {count})", if lost { "lost" } else { "recovered" });
        }
        if report.coarsened {
            tracing::warn!("the voxel pool is full: continuing with twice the voxel size");
        }
        if let Some(board) = board {
            let block_m = 8.0 * report.voxel_size_m;
            board.fused(!now_lost, report.keep.is_some(), report.blocks_used, block_m);
        }
        if let Some(hub) = hub {
            hub.observe(&fusion, &frame, &report, paused);
        }
        buffers.recycle(Event::Depth(frame.depth));
        if let Some(id) = report.keep {
            kept += 1;
            // Fails only if the disk thread has ended, which returns its own error.
            if disk.send(ToDisk::Frame(id, frame.color)).is_err() {
                break;
            }
        } else {
            buffers.recycle(Event::Color(frame.color));
        }
        let fps = count as f64 / started.elapsed().as_secs_f64().max(1e-9);
        let detail = format!("{count} frames · {fps:.1} fps · {kept} frames kept · {} blocks", report.blocks_used);
        reporter.step(&Step { stage: "fusion".into(), fraction: Some(played), detail });
    }
    let last_frame = Instant::now();
    if let Some(hub) = hub {
        hub.end();
    }
    stop.check()?;
    if let Some(board) = board {
        board.enter(State::Finishing);
    }
    reporter.step(&Step { stage: "mesh".into(), fraction: None, detail: String::new() });
    let mut output = fusion.finish();
    let trajectory = std::mem::take(&mut output.trajectory);
    Ok(Fused { output, trajectory, fusion: spent, extraction: last_frame.elapsed(), last_frame })
}

/// The end of the scan file, with the counters of fusion and of the source.
fn tail(name: &str, sensor: &Sensor, config: &Config, output: FusionOutput, source: &CaptureStats) -> ScanTail {
    let stats = CaptureStats {
        depth_frames: source.depth_frames,
        color_frames: source.color_frames,
        pairs: source.pairs,
        unpaired_color: source.unpaired_color,
        unpaired_depth: source.unpaired_depth,
        incomplete_frames: source.incomplete_frames,
        missing_packets: source.missing_packets,
        dropped_pairs: source.dropped_pairs,
        duration_s: source.duration_s,
        ..output.stats
    };
    ScanTail {
        name: name.into(),
        sensor: sensor.clone(),
        mesh: output.mesh,
        keyframes: output.keyframes,
        witnesses: output.validation_frames,
        config: config.to_toml(),
        stats,
    }
}

/// Checks that the camera was tracked beyond its first frame and that there is a surface and a keyframe.
fn usable(captured: &Captured, source: &Path) -> Result<(), Failure> {
    let shown = source.display();
    let (pairs, tracked) = (captured.stats.pairs, captured.trajectory.len());
    let problem = if captured.stats.color_frames == 0 {
        "it holds no colour frames; use a source with depth and colour".into()
    } else if pairs == 0 {
        "no colour frame has a depth frame near in time; check the time stamps, or raise capture.max_pair_gap_ms".into()
    } else if tracked == 0 || (pairs > 1 && tracked < 2) {
        format!(
            "tracking never held ({tracked} of {pairs} frames); scan again, more slowly, with surfaces 0.5 to 3 m away in view"
        )
    } else if captured.triangles == 0 || captured.keyframes == 0 {
        format!("no surface was reconstructed from {pairs} frames; scan again, from 0.5 to 3 m away, for longer")
    } else {
        return Ok(());
    };
    Err(Failure::Unusable(format!("{shown}: {problem}")))
}

fn start<'scope, T: Send + 'scope>(
    scope: &'scope Scope<'scope, '_>,
    name: &str,
    work: impl FnOnce() -> Result<T, Failure> + Send + 'scope,
) -> Result<ScopedJoinHandle<'scope, Result<T, Failure>>, Failure> {
    std::thread::Builder::new()
        .name(name.into())
        .spawn_scoped(scope, work)
        .map_err(|e| Failure::Internal(format!("thread `{name}` could not be started: {e}")))
}

fn join<T>(thread: Result<ScopedJoinHandle<'_, Result<T, Failure>>, Failure>) -> Result<T, Failure> {
    thread?.join().unwrap_or_else(|panic| Err(Failure::panic(panic.as_ref())))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinect::driver::Kinect;
    use crate::kinect::frame_queue::Wanted;
    use crate::kinect::live::Live;
    use crate::memory::resident_bytes;
    use crate::simulator::bus::SimBus;
    use crate::simulator::plan::SimPlan;
    use crate::sources::sensor;
    use crate::sources::streaming::{Conditions, Streaming};
    use firmware_config::DaemonConfig;
    use std::sync::Arc;

    /// Ten minutes on the device's own clock, as fast as it goes, with a counting consumer in the place of fusion.
    #[test]
    fn ten_minutes_of_capture_with_every_drop_accounted_for_and_flat_memory() {
        const FRAMES: u64 = 18_000;
        let device = tempfile::tempdir().unwrap();
        let plan = "pattern,fast,hasty,frames=18000,loss=0.0002,burst=0.00001,truncate=0.0001,garbage=0.0001";
        let mut bus = SimBus::new(SimPlan::parse(plan).unwrap());
        let mut config = Config::default();
        (config.daemon.max_scan_s, config.daemon.min_free_mb, config.kinect.accelerometer_hz) = (3600.0, 1, 1);
        let kinect = Kinect::open(&mut bus, "", &config.kinect).unwrap();
        let described = sensor::describe(&kinect, &config);
        let live = Live::start(kinect, Wanted::NewFrames, &config.kinect).unwrap();
        let board = Arc::new(Board::default());
        let conditions = Conditions {
            orders: Orders::default(),
            stop: Stop::default(),
            board: Arc::clone(&board),
            config: DaemonConfig { ..config.daemon.clone() },
            device: device.path().into(),
        };
        let pairs = Pairs::live(Streaming::new(live, described, conditions), &config.capture);
        assert!(pairs.drops_when_slow());
        let buffers = pairs.buffers();
        let (out, waiting) = bounded(QUEUED_FRAMES);
        let oldest = waiting.clone();
        let reader = std::thread::spawn(move || {
            let over = AtomicBool::new(false);
            let outcome = read(pairs, &out, Some(DropOldest { oldest, over: &over, buffers }), None, None);
            drop(out);
            outcome
        });
        let (mut taken, mut last, mut settled) = (0u64, i64::MIN, 0);
        for RawPair { color, depth, .. } in waiting {
            assert!(color.timestamp_ns > last && (color.timestamp_ns - depth.timestamp_ns).abs() < 1_000_000);
            (taken, last) = (taken + 1, color.timestamp_ns);
            // For a minute much slower than the sensor.
            if taken == 2000 {
                let until = bus.log().depth.frames + 1800;
                while bus.log().depth.frames < until {
                    std::thread::sleep(Duration::from_millis(1));
                }
            }
            // Now and then slower than the sensor.
            if taken % 64 == 0 {
                std::thread::sleep(Duration::from_millis(4));
            }
            if taken == 500 {
                settled = resident_bytes().unwrap();
            }
        }
        let grown = resident_bytes().unwrap().saturating_sub(settled);
        let stats = reader.join().unwrap().unwrap();
        let (log, drops) = (bus.log(), board.get().drops);
        println!("{taken} pairs taken; {stats:?}; {drops:?}; {grown} bytes grown; {log:?}");
        assert_eq!((log.depth.frames, log.color.frames, log.violations.len()), (FRAMES, FRAMES, 0));
        assert_eq!(stats.pairs, taken + stats.dropped_pairs);
        assert!(stats.dropped_pairs > 1500, "about a minute's pairs are dropped");
        assert_eq!(stats.depth_frames, stats.pairs + stats.unpaired_depth);
        assert_eq!(stats.color_frames, stats.pairs + stats.unpaired_color);
        // Both streams together; what is not given out is lost, and counted.
        assert_eq!(stats.depth_frames + stats.color_frames + drops.lost_frames, 2 * FRAMES);
        let spoilt = log.depth.lost + log.color.lost + log.depth.spoilt + log.color.spoilt;
        assert_eq!(stats.missing_packets, spoilt, "a packet that did not come as it was sent is missing");
        assert_eq!((drops.dropped_frames, drops.flagged_packets), (0, 0));
        assert!(stats.incomplete_frames > 100 && stats.incomplete_frames <= stats.missing_packets);
        assert!(grown < 48 << 20, "{grown} bytes");
    }
}
