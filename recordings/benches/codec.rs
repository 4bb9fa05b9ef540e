//! Size and speed of recordings, on a TUM RGB-D folder (`cargo bench -p recordings --bench codec -- FOLDER`) or, without
//! one, on a made-up depth image.

use recordings::import::tum::TumReader;
use recordings::recording::{Event, RecordingKind, RecordingReader, RecordingWriter};
use recordings::types::{CameraModel, DepthFrame, Distortion, Intrinsics, Pose, Response, Sensor};
use std::path::Path;
use std::sync::LazyLock;
use std::time::Instant;

/// Depth frames that are held in memory at once.
const FRAMES: usize = 100;
/// Times the recording is read; the fastest counts.
const READS: usize = 5;

/// Seconds this thread has run on a CPU (Linux), so that other work on the machine does not count; else wall time.
fn cpu_s() -> f64 {
    static START: LazyLock<Instant> = LazyLock::new(Instant::now);
    let on_cpu = std::fs::read_to_string("/proc/self/schedstat").ok();
    let ns = on_cpu.as_deref().and_then(|s| s.split_whitespace().next()).and_then(|s| s.parse::<f64>().ok());
    ns.map_or_else(|| START.elapsed().as_secs_f64(), |ns| ns * 1e-9)
}

fn main() -> recordings::Result<()> {
    let folder = std::env::args().skip(1).find(|a| !a.starts_with("--"));
    let (sensor, frames) = match &folder {
        Some(folder) => from_folder(Path::new(folder))?,
        None => made_up(),
    };
    let raw = frames.iter().map(|f| 2 * f.depth.len()).sum::<usize>() as f64;
    let path = std::env::temp_dir().join(format!("lumiscan-codec-{}.lrec", std::process::id()));
    let start = cpu_s();
    let mut writer = RecordingWriter::create(&path, RecordingKind::Frames, &sensor)?;
    let count = frames.len() as f64;
    for frame in frames {
        writer.write(&Event::Depth(frame))?;
    }
    let write_s = cpu_s() - start;
    writer.finish()?;
    let coded = std::fs::metadata(&path).map_err(|e| recordings::Error::io(&path, e))?.len() as f64;
    let mut read_s = f64::INFINITY;
    for _ in 0..READS {
        let start = cpu_s();
        let mut reader = RecordingReader::open(&path)?;
        while reader.next_event()?.is_some() {}
        read_s = read_s.min(cpu_s() - start);
    }
    let _ = std::fs::remove_file(&path);
    println!("{}", folder.as_deref().unwrap_or("made-up depth"));
    println!("  {count} depth frames, {:.1} kB each, {:.4} of raw", coded / count / 1e3, coded / raw);
    println!("  written at {:.0} frames/s, read at {:.0} frames/s", count / write_s, count / read_s);
    Ok(())
}

fn from_folder(folder: &Path) -> recordings::Result<(Sensor, Vec<DepthFrame>)> {
    let mut reader = TumReader::open(folder)?;
    let mut frames = Vec::new();
    while let Some(event) = reader.next_event()? {
        if let Event::Depth(frame) = event {
            frames.push(frame);
        }
        if frames.len() == FRAMES {
            break;
        }
    }
    Ok((reader.sensor().clone(), frames))
}

/// A slanted plane with a box in front, in a Kinect's steps of disparity, with noise and a shadow.
fn made_up() -> (Sensor, Vec<DepthFrame>) {
    let (width, height) = (640u32, 480u32);
    let intrinsics = Intrinsics { width, height, fx: 525.0, fy: 525.0, cx: 319.5, cy: 239.5 };
    let camera = CameraModel { intrinsics, distortion: Distortion::default() };
    let sensor = Sensor {
        name: "made up".into(),
        serial: String::new(),
        color: camera,
        depth: camera,
        color_from_depth: Pose::IDENTITY,
        depth_registered: true,
        depth_unit_m: 0.001,
        response: Response::Srgb,
        depth_to_color_offset_ns: 0,
    };
    let frames = (0..FRAMES as u32).map(|frame| {
        let depth = (0..width * height).map(|i| {
            let (x, y) = (i % width, i / width);
            let in_box = (200 + frame..400).contains(&x) && (150..350).contains(&y);
            let noise = (i ^ frame).wrapping_mul(2_654_435_761) >> 30;
            let disparity = if in_box { 480 } else { 240 + y / 4 + u32::from(noise == 0) };
            let shadow = (400..420).contains(&x) && (150..350).contains(&y);
            if shadow { 0 } else { (348_000 / disparity) as u16 }
        });
        DepthFrame { timestamp_ns: 0, width, height, depth: depth.collect(), missing_packets: 0 }
    });
    (sensor, frames.collect())
}
