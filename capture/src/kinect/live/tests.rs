//! Whole sessions with a simulated Kinect and its faults.

use super::*;
use crate::kinect::decoder::Decoder;
use crate::kinect::transport::Bus;
use crate::simulator::bus::SimBus;
use crate::simulator::plan::SimPlan;
use firmware_config::kinect_models::Model;
use recordings::types::{ColorFrame, DepthFrame, UsbPacket};

fn config() -> KinectConfig {
    KinectConfig::default()
}

fn fast() -> SimPlan {
    SimPlan { fast: true, frames: 20, ..SimPlan::default() }
}

#[derive(Default)]
struct Session {
    depth: Vec<DepthFrame>,
    color: Vec<ColorFrame>,
    accelerometer: Vec<[f32; 3]>,
    packets: Vec<UsbPacket>,
    stats: LiveStats,
    ended: Option<Result<Polled, KinectError>>,
}

/// Opens the Kinect on the bus and starts its streams.
fn start(bus: &mut SimBus, config: &KinectConfig) -> Result<Live, KinectError> {
    Live::start(Kinect::open(bus, "", config)?, Wanted::Packets, config)
}

/// Polls until the session fails.
fn failure_of(mut live: Live) -> (KinectError, LiveStats) {
    loop {
        if let Err(e) = live.poll(&mut |_| {}) {
            return (e, live.stats());
        }
    }
}

/// Streams until the simulated device has sent everything, or is gone.
fn session(bus: &mut SimBus, config: &KinectConfig) -> Result<Session, KinectError> {
    let mut live = start(bus, config)?;
    let mut s = Session { packets: live.kinect().traffic().to_vec(), ..Session::default() };
    loop {
        // Read before the queue is emptied.
        let over = bus.log().over;
        let polled = live.poll(&mut |event| match event {
            Event::Depth(d) => s.depth.push(d),
            Event::Color(c) => s.color.push(c),
            Event::Accelerometer(a) => s.accelerometer.push(a.acceleration),
            Event::Packet(_) => {}
        });
        s.packets.extend(live.packets().map(|p| UsbPacket {
            timestamp_ns: p.host_ns,
            endpoint: p.endpoint,
            data: p.data.to_vec(),
        }));
        match polled {
            Ok(Polled::Nothing) if over => {}
            Ok(Polled::Some | Polled::Nothing) => continue,
            _ => {}
        }
        s.stats = live.stats();
        s.ended = Some(polled);
        return Ok(s);
    }
}

#[test]
fn a_clean_session_is_complete_and_correct() {
    for model in [Model::K1414, Model::K1473, Model::K1517] {
        let mut bus = SimBus::new(SimPlan { model, ..fast() });
        let s = session(&mut bus, &config()).unwrap();
        let log = bus.log();
        assert_eq!(log.violations, [""; 0], "{model:?}");
        assert_eq!((s.depth.len(), s.color.len()), (20, 20));
        assert_eq!(s.stats.queue.packets, log.depth.packets + log.color.packets);
        assert_eq!((s.stats.streams.depth.missing, s.stats.streams.color.missing, s.stats.restarts), (0, 0, 0));
        // The clock wraps during the session.
        for pair in s.depth.windows(2) {
            assert!((pair[1].timestamp_ns - pair[0].timestamp_ns - 33_333_333).abs() <= 1);
        }
        assert_eq!(s.depth[3].timestamp_ns, s.color[3].timestamp_ns);
        assert!(s.depth[0].depth.iter().filter(|d| **d > 0).count() > 280_000);
        assert!(s.color[5].bytes.iter().enumerate().all(|(i, &b)| b == (i / 7 + 29 * 5) as u8));
        assert_eq!(log.writes[..7], [(0x105, 0), (0x06, 0), (0x12, 3), (0x13, 1), (0x14, 0x1e), (0x06, 2), (0x17, 0)]);
        assert_eq!(log.writes[7..13], [(0x05, 0), (0x0c, 0), (0x0d, 1), (0x0e, 0x1e), (0x05, 1), (0x47, 0)]);
        assert_eq!(log.writes[13..], [(0x06, 0), (0x05, 0)]);
        let g = s.accelerometer.first().unwrap();
        assert!((g[1] + 9.8).abs() < 0.01 && g[0] == 0.0 && g[2] == 0.0, "{g:?}");
    }
}

#[test]
fn the_exposure_is_read_twice_a_second_at_most() {
    let plan = || SimPlan { frames: 90, ..fast() };
    let mut bus = SimBus::new(plan());
    session(&mut bus, &config()).unwrap();
    assert_eq!(bus.log().exposures, 0, "off by default");
    let mut bus = SimBus::new(plan());
    let s = session(&mut bus, &KinectConfig { read_exposure: true, ..config() }).unwrap();
    let most = |bus: &SimBus| 2 * (bus.now().as_secs() as u32 + 1);
    let read = bus.log().exposures;
    assert!((4..=most(&bus)).contains(&read), "{read} readings in {:?}", bus.now());
    assert_eq!(bus.log().violations, [""; 0]);
    assert_eq!(s.depth.len(), 90);
    // One that never answers costs a tenth of a second, twice a second, and no frame.
    let mut bus = SimBus::new(SimPlan { not_ready: 200, ..plan() });
    let mut live = start(&mut bus, &KinectConfig { read_exposure: true, ..config() }).unwrap();
    while !bus.log().over {
        live.poll(&mut |_| {}).unwrap();
    }
    assert!(bus.log().exposures <= most(&bus) && live.exposure_us().is_none());
}

/// Accelerometer and frames share one clock, and a reading precedes the first frame.
#[test]
fn accelerometer_readings_have_device_time() {
    let mut bus = SimBus::new(SimPlan { frames: 60, ..fast() });
    let mut live = start(&mut bus, &config()).unwrap();
    let mut events = Vec::new();
    while !bus.log().over {
        live.poll(&mut |event| events.push(event)).unwrap();
    }
    assert!(matches!(events[0], Event::Accelerometer(_)));
    let times: Vec<i64> = events.iter().map(Event::timestamp_ns).collect();
    assert!(times.iter().all(|t| (0..2_000_000_000).contains(&(t - times[0]))), "{times:?}");
    let readings = events.iter().filter(|e| matches!(e, Event::Accelerometer(_))).count();
    assert!((8..=12).contains(&readings), "{readings} in 2 s");
}

#[test]
fn garbage_without_end_is_silence() {
    let mut bus = SimBus::new(SimPlan { garbage: 1.0, frames: 0, ..fast() });
    let (error, _) = failure_of(start(&mut bus, &config()).unwrap());
    assert_eq!(error, UsbError::Timeout.into());
}

#[test]
fn other_formats_stream_too() {
    let mut bus = SimBus::new(fast());
    let s = session(&mut bus, &KinectConfig { depth_bits: 10, color_sxga: true, ..config() }).unwrap();
    assert_eq!(bus.log().violations, [""; 0]);
    assert_eq!((s.depth.len(), s.color.len()), (20, 7));
    assert_eq!((s.color[0].width, s.color[0].height, s.color[0].bytes.len()), (1280, 1024, 1_310_720));
    assert!(s.depth[0].depth.iter().filter(|d| **d > 0).count() > 280_000);
}

/// Every packet that did not come is counted; every frame that is not whole is marked.
#[test]
fn losses_are_counted_to_the_packet() {
    for (loss, burst) in [(0.001, 0.0), (0.01, 0.0), (0.1, 0.0), (0.5, 0.0), (0.001, 0.01)] {
        let plan = SimPlan { loss, burst, frames: 60, seed: 5, ..fast() };
        let mut bus = SimBus::new(plan);
        let s = session(&mut bus, &config()).unwrap();
        let log = bus.log();
        for (sent, got) in [(log.depth, s.stats.streams.depth), (log.color, s.stats.streams.color)] {
            assert_eq!(got.packets + sent.lost, sent.packets - got.skipped, "loss {loss}");
            // Packets lost before the first frame or after the last packet are not counted.
            assert!(sent.lost - got.missing <= got.skipped + 60, "loss {loss}: {sent:?} {got:?}");
            assert!(got.frames + got.lost_frames + 2 >= sent.frames, "loss {loss}: {got:?}");
            assert_eq!(got.resyncs, 0);
        }
        let incomplete = s.depth.iter().filter(|d| d.missing_packets > 0).count() as u64;
        assert_eq!(incomplete, s.stats.streams.depth.incomplete_frames);
        if loss <= 0.001 && burst == 0.0 {
            assert!(s.depth.iter().any(|d| d.missing_packets == 0));
        }
    }
}

#[test]
fn all_faults_together_cost_only_the_affected_frames() {
    let plan = SimPlan {
        loss: 0.005,
        burst: 0.0005,
        burst_packets: 300,
        reorder: 0.02,
        truncate: 0.01,
        garbage: 0.01,
        bad_status: 0.01,
        stall_every: 17,
        stall_frames: 5,
        frames: 120,
        seed: 11,
        ..fast()
    };
    let mut bus = SimBus::new(plan);
    let s = session(&mut bus, &config()).unwrap();
    let (log, got) = (bus.log(), s.stats.streams.depth);
    assert!(s.stats.queue.flagged > 100 && got.garbage > 50 && got.short > 50, "{:?}", s.stats);
    assert_eq!(got.frames, s.depth.len() as u64);
    // A seventh of all packets is lost in bursts longer than the sequence numbers reach; a burst costs two frames at most.
    assert!(got.frames + 2 * (log.depth.lost / 250) > log.depth.frames, "{got:?} of {:?}", log.depth);
    assert!(got.missing <= log.depth.lost + log.depth.spoilt + 250 * got.resyncs, "{got:?} of {:?}", log.depth);
    // Pixels that are there are right: rows of the pattern's planes.
    for (i, d) in s.depth.iter().enumerate() {
        let whole = d.depth.iter().filter(|&&mm| mm > 0).all(|&mm| (500..1400).contains(&mm));
        assert!(whole, "frame {i}");
    }
}

#[test]
fn not_ready_and_stale_replies_are_waited_out() {
    let mut bus = SimBus::new(SimPlan { not_ready: 7, stale: 3, ..fast() });
    let s = session(&mut bus, &config()).unwrap();
    assert_eq!((s.depth.len(), bus.log().violations.len()), (20, 0));
}

#[test]
fn devices_that_violate_the_protocol_fail_in_time() {
    for plan in [
        SimPlan { dead: true, ..fast() },
        SimPlan { never_ready: true, ..fast() },
        SimPlan { bad_magic: true, ..fast() },
    ] {
        let mut bus = SimBus::new(plan);
        let found = bus.list().unwrap().remove(0);
        let before = bus.open(&found).unwrap().now();
        let error = session(&mut bus, &config()).err().unwrap();
        let took = bus.open(&found).unwrap().now() - before;
        assert!(!error.is_gone() && took <= Duration::from_secs(4), "{error} after {took:?}");
    }
}

#[test]
fn unplugged_in_every_phase() {
    let mut phases = 0;
    for control in 1..200 {
        let mut bus =
            SimBus::new(SimPlan { unplug_at_control: Some(control), no_motor: true, replug_ms: Some(100), ..fast() });
        match session(&mut bus, &config()) {
            Err(e) => {
                assert!(e.is_gone(), "{e}");
                phases += 1;
            }
            // Later transfers are those of stopping.
            Ok(_) => break,
        }
        while bus.list().unwrap().is_empty() {}
        assert_eq!(session(&mut bus, &config()).unwrap().depth.len(), 20, "after unplugging at transfer {control}");
    }
    assert!(phases >= 2 * (4 + 12), "{phases}");
    for frame in [0, 1, 10] {
        let mut bus = SimBus::new(SimPlan { unplug_at_frame: Some(frame), replug_ms: Some(100), ..fast() });
        let s = session(&mut bus, &config()).unwrap();
        assert_eq!((s.depth.len() as u64, s.ended), (frame, Some(Ok(Polled::Gone))));
        while bus.list().unwrap().is_empty() {}
        assert_eq!(session(&mut bus, &config()).unwrap().depth.len(), 20);
    }
}

#[test]
fn one_stream_alone_is_named() {
    let mut bus = SimBus::new(SimPlan { no_color: true, frames: 200, ..fast() });
    let mut live = start(&mut bus, &config()).unwrap();
    let mut named = None;
    while !bus.log().over {
        live.poll(&mut |_| {}).unwrap();
        named = named.or(live.silent_stream());
    }
    assert_eq!(named, Some(StreamKind::Color));
}

#[test]
fn silence_starts_the_streams_anew_and_then_gives_up() {
    let mut bus = SimBus::new(fast());
    let (error, stats) = failure_of(start(&mut bus, &config()).unwrap());
    assert_eq!(error, UsbError::Timeout.into());
    assert!(stats.restarts >= config().tuning.session.max_restarts);
}

#[test]
fn a_serial_number_chooses() {
    let mut bus = SimBus::new(fast());
    assert!(Kinect::open(&mut bus, "another", &config()).err().unwrap().is_gone());
    assert!(Kinect::open(&mut bus, crate::simulator::bus::SERIAL, &config()).is_ok());
}

#[test]
fn recorded_packets_replay_bit_for_bit() {
    let plan = SimPlan { loss: 0.02, garbage: 0.01, reorder: 0.01, frames: 30, ..fast() };
    let s = session(&mut SimBus::new(plan), &config()).unwrap();
    let mut decoder = Decoder::default();
    let (mut depth, mut color) = (Vec::new(), Vec::new());
    for p in &s.packets {
        let sink = &mut |event| match event {
            Event::Depth(d) => depth.push(d),
            Event::Color(c) => color.push(c),
            _ => {}
        };
        decoder.push(p.endpoint, p.timestamp_ns, &p.data, sink).unwrap();
    }
    assert!(depth == s.depth && color == s.color);
    assert_eq!(decoder.stats(), s.stats.streams);
}

/// Figures for README.md: `cargo test --release --workspace --bin lumiscan -- --ignored --nocapture ms_a_frame`.
#[test]
#[ignore = "prints timings"]
fn ms_a_frame() {
    use crate::kinect::depth_decoder::DepthDecoder;
    use crate::kinect::packet_assembler::Assembler;
    use firmware_config::kinect_models::{BAYER_VGA, DEPTH_11};
    use std::time::Instant;
    const FRAMES: u32 = 100;
    let s = session(&mut SimBus::new(SimPlan { frames: u64::from(FRAMES), ..fast() }), &config()).unwrap();
    let least = |what: &str, work: &mut dyn FnMut()| {
        let time = |work: &mut dyn FnMut()| {
            let began = Instant::now();
            work();
            began.elapsed()
        };
        let best = (0..7).map(|_| time(work)).min().unwrap_or_default();
        println!("{what}: {:.2} ms a frame", best.as_secs_f64() * 1e3 / f64::from(FRAMES));
    };
    let images = crate::kinect::buffers::Pool::new(640 * 480, 1, 1);
    let mut assembled = Vec::new();
    for (what, format) in [("assembling depth", &DEPTH_11), ("assembling colour", &BAYER_VGA)] {
        least(what, &mut || {
            let mut assembler = Assembler::new(format);
            assembled.clear();
            for p in s.packets.iter().filter(|p| p.endpoint == format.endpoint) {
                assembler.push(&p.data, &mut |f| assembled.push(f.bytes));
            }
        });
        if format.endpoint == DEPTH_11.endpoint {
            let mut decoder = DepthDecoder::new(&crate::simulator::calibration::calibration(), format, images.clone());
            least("depth: unpacking, millimetres, registration", &mut || {
                assembled.iter().for_each(|bytes| images.give(decoder.decode(bytes, &[], 0).depth));
            });
        }
    }
    least("colour: demosaicing", &mut || s.color.iter().for_each(|c| drop(c.decode())));
    assert!(!s.color.is_empty());
}

#[test]
fn packets_without_calibration_are_refused() {
    let packet = [b'R', b'B', 0, 0x71, 0, 0, 0, 12, 0, 0, 0, 0];
    assert!(matches!(Decoder::default().push(0x82, 0, &packet, &mut |_| {}), Err(KinectError::Calibration(_))));
}
