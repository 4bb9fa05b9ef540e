//! Runs TUM RGB-D folders through fusion and prints what the project is judged by: trajectory error, share of frames
//! tracked, CPU time per frame and stage, mesh against truth.
//!
//! `cargo run --release -p tests --example ate -- [--out DIR] [--threads N] [--set key=value]… [--every N] [--backwards]
//! [--loop N] [--drop N] [--pieces N] [FOLDER[=TRUTH_MESH]…]`
//!
//! Without a folder: every recording with a `groundtruth.txt` below `LUMISCAN_SHARED`. `--every N` plays each Nth frame,
//! `--loop N` forward and backward in turns, `--drop N` leaves out N frames of every 30, `--pieces N` cuts into pieces of N
//! frames and plays them out of order.

#[path = "../../fusion/benches/usage/mod.rs"]
mod usage;

use estimator::sweep::alignment::rigid_alignment;
use firmware_config::Config;
use fusion::Fusion;
use fusion::FusionOutput;
use fusion::Tracking;
use glam::{DMat3, DVec3, Vec3};
use recordings::import::trajectory::{format_trajectory, read_trajectory};
use recordings::import::tum::TumReader;
use recordings::ply::read::read_ply;
use recordings::ply::write::write_ply;
use recordings::recording::Event;
use recordings::types::{ColorFrame, DepthFrame, Pose, RgbdFrame, Sensor, TimestampNs};
use std::collections::HashMap;
use std::error::Error;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;
use usage::{cpu_ms, peak_mib};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

fn main() -> Result<()> {
    let mut config = Config::default();
    let mut out: Option<PathBuf> = None;
    let mut folders = Vec::new();
    let mut threads = 1;
    let mut play = Play { every: 1, backwards: false, loops: 1, drop: 0, pieces: 0 };
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--out" => out = Some(args.next().ok_or("--out needs a folder")?.into()),
            "--threads" => threads = args.next().ok_or("--threads needs a number")?.parse()?,
            "--set" => config.set(&args.next().ok_or("--set needs key=value")?)?,
            "--every" => play.every = args.next().ok_or("--every needs a number")?.parse::<usize>()?.max(1),
            "--backwards" => play.backwards = true,
            "--loop" => play.loops = args.next().ok_or("--loop needs a number")?.parse()?,
            "--drop" => play.drop = args.next().ok_or("--drop needs a number")?.parse()?,
            "--pieces" => play.pieces = args.next().ok_or("--pieces needs a number")?.parse()?,
            "--trace" => tracing::subscriber::set_global_default(stages::Printer)?,
            _ => folders.push(arg),
        }
    }
    if folders.is_empty() {
        folders =
            shared_recordings(&std::env::var("LUMISCAN_SHARED").map_err(|_| "give a folder, or set LUMISCAN_SHARED")?)?;
    }
    if !tracing::dispatcher::has_been_set() {
        tracing::subscriber::set_global_default(stages::Collector)?;
    }
    // Inside a pool of one thread, that thread's clock gives the stages' CPU time.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    for folder in folders {
        let (dir, truth) = folder.split_once('=').map_or((folder.as_str(), None), |(d, t)| (d, Some(t)));
        pool.install(|| {
            run(Path::new(dir), truth.map(Path::new), &config, &play, out.as_deref()).map_err(|e| e.to_string())
        })?;
    }
    Ok(())
}

/// The recordings with a true path in the folder of shared data, with the true mesh where there is one.
fn shared_recordings(shared: &str) -> Result<Vec<String>> {
    let mut found = Vec::new();
    for group in ["data", "truth_rgbd"] {
        for entry in std::fs::read_dir(Path::new(shared).join(group))? {
            let entry = entry?;
            if !entry.path().join("groundtruth.txt").is_file() {
                continue;
            }
            let mesh = Path::new(shared).join("truth").join(entry.file_name()).join("mesh.ply");
            let mesh = if mesh.is_file() { format!("={}", mesh.display()) } else { String::new() };
            found.push(format!("{}{mesh}", entry.path().display()));
        }
    }
    found.sort();
    Ok(found)
}

/// In what order a recording is played.
struct Play {
    every: usize,
    backwards: bool,
    loops: usize,
    drop: usize,
    pieces: usize,
}

/// A frame's number in the recording, and the stamps of depth and colour under which it is played.
type Turn = (usize, i64, i64);

impl Play {
    /// The frames to play, on a clock that runs on where the recording is played backwards.
    fn turns(&self, pairs: &[Pair]) -> Vec<Turn> {
        let chosen: Vec<usize> =
            (0..pairs.len()).filter(|i| i % 30 >= self.drop || *i < 30).step_by(self.every).collect();
        let chosen = if self.pieces > 0 { shuffled(&chosen, self.pieces) } else { chosen };
        let mut turns: Vec<Turn> = Vec::new();
        let mut before: Option<usize> = None;
        for round in 0..self.loops {
            let back = (round % 2 == 1) != self.backwards;
            let order: Vec<usize> = if back { chosen.iter().rev().copied().collect() } else { chosen.clone() };
            for i in order {
                let (depth, color) = (pairs[i].0.timestamp_ns, pairs[i].1.timestamp_ns);
                let clock = match (before, turns.last()) {
                    (Some(j), _) if i == j => continue,
                    (Some(j), Some(last)) if i.abs_diff(j) < 30 => last.2 + (color - pairs[j].1.timestamp_ns).abs(),
                    (Some(_), Some(last)) => last.2 + 33_333_333,
                    _ => color,
                };
                turns.push((i, clock + if back { color - depth } else { depth - color }, clock));
                before = Some(i);
            }
        }
        turns
    }
}

/// Pieces of `n` numbers in an order in which neighbours are far apart.
fn shuffled(all: &[usize], n: usize) -> Vec<usize> {
    let pieces: Vec<&[usize]> = all.chunks(n).collect();
    let mut order: Vec<usize> = (0..pieces.len()).collect();
    order.sort_by_key(|i| (*i as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    order.into_iter().flat_map(|i| pieces[i].iter().copied()).collect()
}

fn run(dir: &Path, truth: Option<&Path>, config: &Config, play: &Play, out: Option<&Path>) -> Result<()> {
    let (sensor, pairs) = read_pairs(dir)?;
    let turns = play.turns(&pairs);
    let mut fusion = Fusion::new(&sensor, &config.fusion_of(&sensor.serial))?;
    stages::reset();
    let mut times = Vec::new();
    let mut lost = Vec::new();
    for (i, (number, depth_ns, color_ns)) in turns.iter().enumerate() {
        let (depth, color) = &pairs[*number];
        let mut frame = RgbdFrame { depth: depth.clone(), color: color.clone(), rgb: color.decode()? };
        (frame.depth.timestamp_ns, frame.color.timestamp_ns) = (*depth_ns, *color_ns);
        let (cpu, wall) = (cpu_ms(), Instant::now());
        let report = fusion.push(&frame)?;
        times.push((cpu_ms() - cpu, wall.elapsed().as_secs_f64() * 1e3));
        if report.tracking == Tracking::Lost {
            lost.push(i);
        }
    }
    let n = times.len().max(1);
    let start = (cpu_ms(), Instant::now());
    let result = fusion.finish();
    let finish = (cpu_ms() - start.0, start.1.elapsed().as_secs_f64() * 1e3);
    // Truth is looked up by the recording's own clock.
    let own_clock: HashMap<i64, i64> = turns.iter().map(|t| (t.2, pairs[t.0].1.timestamp_ns)).collect();
    let trajectory = result.trajectory.iter().map(|(t, p)| (own_clock[t], *p)).collect();
    let result = FusionOutput { trajectory, ..result };
    println!("== {}", dir.display());
    let s = &result.stats;
    println!(
        "frames {n}, in trajectory {:.1} %, losses {}, relocalisations {}, lost frames {lost:?}",
        100.0 * result.trajectory.len() as f64 / n as f64,
        s.losses,
        s.relocalisations
    );
    let median = |f: fn(&(f64, f64)) -> f64| {
        let mut t: Vec<f64> = times.iter().map(f).collect();
        t.sort_by(f64::total_cmp);
        (t[t.len() / 2], t[t.len() * 95 / 100])
    };
    let ((cpu, cpu95), (wall, wall95)) = (median(|t| t.0), median(|t| t.1));
    println!("per frame: CPU median {cpu:.1} ms (95 % {cpu95:.1}), wall median {wall:.1} ms (95 % {wall95:.1})");
    println!("finish: CPU {:.0} ms, wall {:.0} ms; peak memory {} MiB", finish.0, finish.1, peak_mib());
    for (name, ms) in stages::totals() {
        println!("    {name:<12} {:.2} ms", ms / n as f64);
    }
    println!(
        "blocks {} of {}, refused {}, coarsened {} times, voxel {:.4} m",
        s.blocks_used, s.blocks_total, s.blocks_refused, s.coarsenings, s.voxel_size_m
    );
    println!(
        "mesh: {} vertices, {} triangles; {} keyframes + {} witnesses cover {:.1} %",
        result.mesh.positions.len(),
        result.mesh.triangles.len(),
        result.keyframes.len(),
        result.validation_frames.len(),
        100.0 * s.keyframe_coverage
    );
    report_ate(dir, &result, truth)?;
    if let Some(out) = out {
        let name = dir.file_name().ok_or("no folder name")?;
        let to = out.join(name);
        std::fs::create_dir_all(&to)?;
        std::fs::write(to.join("trajectory.txt"), format_trajectory(&result.trajectory))?;
        let mut mesh = std::io::BufWriter::new(std::fs::File::create(to.join("mesh.ply"))?);
        write_ply(&mut mesh, "fused", &result.mesh, &[])?;
    }
    Ok(())
}

type Pair = (DepthFrame, ColorFrame);

/// Each colour frame with the depth frame nearest in time, within 20 ms.
fn read_pairs(dir: &Path) -> Result<(Sensor, Vec<Pair>)> {
    let mut reader = TumReader::open(dir)?;
    let sensor = reader.sensor().clone();
    let (mut depths, mut colors) = (Vec::new(), Vec::new());
    while let Some(event) = reader.next_event()? {
        match event {
            Event::Depth(d) => depths.push(d),
            Event::Color(c) => colors.push(c),
            _ => {}
        }
    }
    let mut pairs = Vec::new();
    for c in colors {
        let gap = |d: &DepthFrame| (d.timestamp_ns - c.timestamp_ns).abs();
        if let Some(d) = depths.iter().min_by_key(|d| gap(d)).filter(|d| gap(d) <= 20_000_000) {
            pairs.push((d.clone(), c));
        }
    }
    Ok((sensor, pairs))
}

/// Ground truth at a time: between the neighbours where they are near, `None` in gaps of over 50 ms.
fn at_time(poses: &[(TimestampNs, Pose)], t: f64) -> Option<Pose> {
    let stamp = |p: &(TimestampNs, Pose)| p.0 as f64 * 1e-9;
    let i = poses.partition_point(|p| stamp(p) < t);
    let (a, b) = (poses.get(i.saturating_sub(1))?, poses.get(i).or(poses.last())?);
    let (ta, tb) = (stamp(a), stamp(b));
    if (ta - t).abs().min((tb - t).abs()) > 0.05 {
        return None;
    }
    let f = if tb > ta { ((t - ta) / (tb - ta)).clamp(0.0, 1.0) } else { 0.0 };
    Some(Pose::new(a.1.rotation.slerp(b.1.rotation, f), a.1.translation.lerp(b.1.translation, f)))
}

fn report_ate(dir: &Path, result: &FusionOutput, truth: Option<&Path>) -> Result<()> {
    let truth_poses = read_trajectory(&dir.join("groundtruth.txt"))?;
    let mut text = String::new();
    for shift_ms in [-40, -20, 0, 20, 40] {
        let Some((rmse, max, ..)) = ate(result, &truth_poses, f64::from(shift_ms) * 1e-3) else { continue };
        if shift_ms == 0 {
            println!("ATE RMSE {:.2} cm, max {:.2} cm", rmse * 100.0, max * 100.0);
        }
        write!(text, " {shift_ms} ms: {:.2}", rmse * 100.0)?;
    }
    println!("ATE in cm with truth read at stamp + shift:{text}");
    if let (Some(path), Some((_, _, r, t))) = (truth, ate(result, &truth_poses, 0.0)) {
        let mesh = read_ply(path)?;
        let reference: Vec<(Vec3, Vec3)> = mesh.positions.into_iter().zip(mesh.normals).collect();
        let ours: Vec<(Vec3, Vec3)> =
            result.mesh.positions.iter().map(|p| ((r * p.as_dvec3() + t).as_vec3(), Vec3::ZERO)).collect();
        report_mesh(dir, &ours, &reference)?;
    }
    Ok(())
}

/// RMSE and maximum after the best rigid alignment (Umeyama without scale), and that alignment, ours to truth.
fn ate(result: &FusionOutput, truth: &[(TimestampNs, Pose)], shift: f64) -> Option<(f64, f64, DMat3, DVec3)> {
    let beside_truth = |(t, pose): &(TimestampNs, Pose)| {
        at_time(truth, *t as f64 * 1e-9 + shift).map(|true_pose| (pose.translation, true_pose.translation))
    };
    let pairs: Vec<(DVec3, DVec3)> = result.trajectory.iter().filter_map(beside_truth).collect();
    if pairs.len() < 3 {
        return None;
    }
    let (r, t) = rigid_alignment(&pairs)?;
    let errors: Vec<f64> = pairs.iter().map(|(a, b)| (r * *a + t - *b).length()).collect();
    let rmse = (errors.iter().map(|e| e * e).sum::<f64>() / pairs.len() as f64).sqrt();
    Some((rmse, errors.iter().copied().fold(0.0, f64::max), r, t))
}

/// Distance of our vertices to the truth's surface (the tangent plane of its nearest vertex), and the share of the
/// truth's vertices near ours, among those the camera saw.
fn report_mesh(dir: &Path, ours: &[(Vec3, Vec3)], truth: &[(Vec3, Vec3)]) -> Result<()> {
    let near_truth = Grid::new(truth, 0.02);
    let to_plane = |p: &Vec3| near_truth.nearest(*p).map(|(_, i)| (*p - truth[i].0).dot(truth[i].1).abs());
    let mut d: Vec<f32> = ours.iter().map(|p| &p.0).filter_map(to_plane).collect();
    d.sort_by(f32::total_cmp);
    let far = ours.len() - d.len();
    let near_ours = Grid::new(ours, 0.02);
    let seen = seen_vertices(dir, truth)?;
    let complete = seen.iter().filter(|p| near_ours.nearest(p.0).is_some_and(|(d, _)| d < 0.005)).count();
    println!(
        "mesh to truth: median {:.2} mm, 90 % {:.2} mm, 97 % {:.2} mm, {} vertices beyond 20 mm; complete at 5 mm: {:.1} % of {}",
        d.get(d.len() / 2).unwrap_or(&f32::NAN) * 1e3,
        d.get(d.len() * 9 / 10).unwrap_or(&f32::NAN) * 1e3,
        d.get(d.len() * 97 / 100).unwrap_or(&f32::NAN) * 1e3,
        far,
        100.0 * complete as f64 / seen.len().max(1) as f64,
        seen.len()
    );
    Ok(())
}

/// The truth's vertices that at least five frames faced and measured: a depth within 1 cm at their pixel.
fn seen_vertices(dir: &Path, truth: &[(Vec3, Vec3)]) -> Result<Vec<(Vec3, Vec3)>> {
    let (sensor, pairs) = read_pairs(dir)?;
    let poses = read_trajectory(&dir.join("groundtruth.txt"))?;
    let k = sensor.depth.intrinsics;
    let mut count = vec![0u32; truth.len()];
    for (depth, color) in pairs.iter().step_by(3) {
        let Some(pose) = at_time(&poses, color.timestamp_ns as f64 * 1e-9) else { continue };
        let (p, camera_from_world) = (pose.translation, pose.inverse());
        for ((v, normal), n) in truth.iter().zip(&mut count) {
            if (p - v.as_dvec3()).dot(normal.as_dvec3()) <= 0.0 {
                continue;
            }
            let x = camera_from_world.transform(v.as_dvec3());
            let (u, w) = ((k.fx * x.x / x.z + k.cx).round(), (k.fy * x.y / x.z + k.cy).round());
            if x.z > 0.1 && u >= 0.0 && w >= 0.0 && u < f64::from(k.width) && w < f64::from(k.height) {
                let z = f64::from(depth.depth[w as usize * k.width as usize + u as usize]) * sensor.depth_unit_m;
                *n += u32::from((z - x.z).abs() < 0.01);
            }
        }
    }
    Ok(truth.iter().zip(count).filter(|(_, n)| *n >= 5).map(|(v, _)| *v).collect())
}

/// Points in cells of `size`, for the nearest within `size`.
struct Grid {
    cells: HashMap<[i32; 3], Vec<(Vec3, usize)>>,
    size: f32,
}

impl Grid {
    fn new(points: &[(Vec3, Vec3)], size: f32) -> Self {
        let mut cells: HashMap<[i32; 3], Vec<(Vec3, usize)>> = HashMap::new();
        for (i, (p, _)) in points.iter().enumerate() {
            cells.entry((*p / size).floor().as_ivec3().to_array()).or_default().push((*p, i));
        }
        Self { cells, size }
    }

    /// Distance to the nearest point and its number.
    fn nearest(&self, p: Vec3) -> Option<(f32, usize)> {
        let c = (p / self.size).floor().as_ivec3();
        let mut best = self.size * self.size;
        let mut found = None;
        for k in 0..27 {
            let d = glam::IVec3::new(k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1);
            for (q, i) in self.cells.get(&(c + d).to_array()).into_iter().flatten() {
                let d = q.distance_squared(p);
                if d < best {
                    (best, found) = (d, Some(*i));
                }
            }
        }
        found.map(|i| (best.sqrt(), i))
    }
}

/// CPU time per tracing span (the stages of `Fusion::push`), complete with one thread.
mod stages {
    use std::cell::RefCell;
    use std::fmt::Debug;
    use std::sync::Mutex;
    use tracing::field::{Field, Visit};
    use tracing::span::{Attributes, Id, Record};
    use tracing::{Event, Metadata, Subscriber};

    static NAMES: Mutex<Vec<(&'static str, f64)>> = Mutex::new(Vec::new());
    thread_local!(static OPEN: RefCell<Vec<f64>> = const { RefCell::new(Vec::new()) });

    /// CPU time of this thread in milliseconds (Linux; 0 elsewhere).
    fn thread_ms() -> f64 {
        let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
        text.split_whitespace().next().and_then(|t| t.parse::<f64>().ok()).unwrap_or(0.0) * 1e-6
    }

    pub fn reset() {
        if let Ok(mut names) = NAMES.lock() {
            names.clear();
        }
    }

    pub fn totals() -> Vec<(&'static str, f64)> {
        NAMES.lock().map(|n| n.clone()).unwrap_or_default()
    }

    pub struct Collector;

    impl Subscriber for Collector {
        fn enabled(&self, metadata: &Metadata<'_>) -> bool {
            metadata.is_span()
        }
        fn new_span(&self, span: &Attributes<'_>) -> Id {
            let name = span.metadata().name();
            let Ok(mut names) = NAMES.lock() else { return Id::from_u64(1) };
            let at = names.iter().position(|n| n.0 == name).unwrap_or_else(|| {
                names.push((name, 0.0));
                names.len() - 1
            });
            Id::from_u64(at as u64 + 1)
        }
        fn record(&self, _: &Id, _: &Record<'_>) {}
        fn record_follows_from(&self, _: &Id, _: &Id) {}
        fn event(&self, _: &Event<'_>) {}
        fn enter(&self, _: &Id) {
            OPEN.with_borrow_mut(|o| o.push(thread_ms()));
        }
        fn exit(&self, id: &Id) {
            let start = OPEN.with_borrow_mut(Vec::pop);
            if let (Some(start), Ok(mut names)) = (start, NAMES.lock())
                && let Some(name) = names.get_mut(id.into_u64() as usize - 1)
            {
                name.1 += thread_ms() - start;
            }
        }
    }

    /// Prints every event.
    pub struct Printer;

    impl Subscriber for Printer {
        fn enabled(&self, metadata: &Metadata<'_>) -> bool {
            metadata.is_event() && metadata.target().starts_with("fusion")
        }
        fn new_span(&self, _: &Attributes<'_>) -> Id {
            Id::from_u64(1)
        }
        fn record(&self, _: &Id, _: &Record<'_>) {}
        fn record_follows_from(&self, _: &Id, _: &Id) {}
        fn event(&self, event: &Event<'_>) {
            struct Line(String);
            impl Visit for Line {
                fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
                    self.0 += &format!("{}={value:?} ", field.name());
                }
            }
            let mut line = Line(String::new());
            event.record(&mut line);
            println!("{}", line.0);
        }
        fn enter(&self, _: &Id) {}
        fn exit(&self, _: &Id) {}
    }
}
