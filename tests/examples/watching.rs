//! What it costs to watch a scan of the bundled recording, how late its pictures come, and how good the light so far is:
//! `cargo run --release -p tests --example watching -- LUMISCAN`.
//!
//! Drops: a scan on a simulated Kinect that shows the recording in real time, with two clients, light so far, and kept frames going to disk.
//! Pairs that the pipeline dropped since fusion was busy, and frames that were turned away before it, as `/api/status` counts them.
//!
//! Cost: processor time and memory of `lumiscan replay --watch` with two clients that take pictures, surface and events, and without any;
//! the light so far, a process of its own, is off there. Lateness: from when a frame was due until its picture was received, counted from
//! the order to start, which the command may take up to 50 ms to notice. Light: irradiance (with shadows, bounces left out) at the vertices
//! of the true mesh that see half of their hemisphere, relative error after one factor a channel.

use estimator::mesh::graph::Graph;
use estimator::rays::RayScene;
use estimator::transfer::Tracer;
use glam::DQuat;
use recordings::import::trajectory::read_trajectory;
use recordings::ply::read::read_ply;
use recordings::result::Estimate;
use serde_json::Value;
use std::error::Error;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tests::metrics::{percentile, scene_irradiance};
use tests::synth::environment::Environment;
use tests::synth::tabletop;

type Outcome<T> = Result<T, Box<dyn Error>>;

/// Bands of the true light, and rays a vertex of the true transfer.
const BANDS: usize = 9;
const RAYS: u32 = 64;
/// Share of its hemisphere from which on a vertex counts as hidden.
const HIDDEN: f32 = 0.5;
/// Cells of the true scene, whose light alone is used.
const CELL_M: f32 = 0.02;
/// Runs of each kind.
const RUNS: usize = 7;
/// Scans on the simulated Kinect, and the length of each: the recording's, after which its last picture stands.
const SCANS: usize = 3;
const SCAN_S: f64 = 5.5;

fn main() -> Outcome<()> {
    let lumiscan = std::env::args().nth(1).ok_or("usage: watching LUMISCAN")?;
    let recording = Path::new(env!("CARGO_MANIFEST_DIR")).join("../recordings/data/tabletop.lrec");
    for scan in 1..=SCANS {
        let Dropped { pairs, dropped_pairs, dropped_frames, lights } = scan_in_real_time(&lumiscan, &recording)?;
        println!(
            "scan {scan} on a simulated Kinect: {pairs} pairs fused, {dropped_pairs} dropped; {dropped_frames} frames dropped \
             before; {lights} estimates of the light"
        );
    }
    let run = |clients: usize| watch(&lumiscan, &recording, clients, &["--no-estimate", "--set", "serve.light=false"]);
    // In turns, so that what else goes on meets both kinds alike.
    let pairs_of_runs = (0..RUNS).map(|_| Ok((run(0)?, run(2)?))).collect::<Outcome<Vec<_>>>()?;
    let (alone, two): (Vec<Watched>, Vec<Watched>) = pairs_of_runs.into_iter().unzip();
    let per_pair = |w: &Watched| w.cpu_s * 1e3 / w.pairs.max(1) as f64;
    let median = |values: Vec<f64>| percentile(&values, 0.5);
    let differences: Vec<f64> = alone.iter().zip(&two).map(|(a, t)| per_pair(t) - per_pair(a)).collect();
    println!("frame pairs: {}; pictures that each of two clients received: {}", two[0].pairs, two[0].late_s.len() / 2);
    println!(
        "cost of two clients: {:.2} CPU-ms a frame pair, median of {RUNS} pairs of runs ({:.1} with, {:.1} without; {differences:.1?})",
        median(differences.clone()),
        median(two.iter().map(per_pair).collect()),
        median(alone.iter().map(per_pair).collect()),
    );
    let peak = |runs: &[Watched]| median(runs.iter().map(|w| w.peak_bytes as f64 / f64::from(1 << 20)).collect());
    println!("peak memory: {:.1} MiB with, {:.1} MiB without", peak(&two), peak(&alone));
    let late: Vec<f64> = two.iter().flat_map(|w| w.late_s.iter().copied()).collect();
    let ms = |share: f64| percentile(&late, share) * 1e3;
    println!(
        "lateness of pictures: median {:.0} ms, 95th percentile {:.0} ms, worst {:.0} ms",
        ms(0.5),
        ms(0.95),
        ms(1.0)
    );

    let lit = watch(&lumiscan, &recording, 1, &[])?;
    let scan = lit.scan.ok_or("the scan was not published")?;
    let truth = Truth::read(&recording, &scan)?;
    println!("| of second | vertices | CPU-s | irradiance, relative error: median / p90 |\n|---|---|---|---|");
    for light in &lit.lights {
        let (median, high) = truth.error(&serde_json::from_value::<Vec<[f64; 3]>>(light["coefficients"].clone())?);
        let number = |key: &str| light[key].as_f64().unwrap_or(f64::NAN);
        println!(
            "| {:.2} | {} | {:.2} | {median:.3} / {high:.3} |",
            number("seconds"),
            light["vertices"],
            number("cpu_s")
        );
    }
    let (median, high) = truth.error(&Estimate::read(&scan.join("result.lres"))?.light.coefficients);
    println!("| result | | | {median:.3} / {high:.3} |");
    if let Some(first) = lit.first_light_s {
        println!("the first ball was shown {first:.1} s after the first frame was due");
    }
    Ok(())
}

/// A watched replay.
struct Watched {
    cpu_s: f64,
    peak_bytes: u64,
    pairs: u64,
    /// Of each received picture.
    late_s: Vec<f64>,
    lights: Vec<Value>,
    first_light_s: Option<f64>,
    scan: Option<PathBuf>,
}

/// Ends the command, however the measurement ended.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// What was lost of a scan in real time.
struct Dropped {
    pairs: u64,
    dropped_pairs: u64,
    dropped_frames: u64,
    lights: u64,
}

fn scan_in_real_time(lumiscan: &str, recording: &Path) -> Outcome<Dropped> {
    let folder = tempfile::tempdir()?;
    let mut command = Command::new(lumiscan);
    command.args(["capture", "--no-estimate", "--serve", "127.0.0.1:0", "--simulate"]).arg(recording);
    command.arg("--device").arg(folder.path().join("device"));
    let (_running, box_) = served(command, folder.path())?;
    let until = |wanted: &dyn Fn(&Value) -> bool| -> Outcome<Value> {
        loop {
            let status: Value = serde_json::from_slice(&box_.ask("GET", "/api/status")?.1)?;
            if wanted(&status) {
                return Ok(status);
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    };
    until(&|s| s["state"] == "ready")?;
    box_.ask("POST", "/api/scan/start")?;
    let (began, over, late) = (Instant::now(), AtomicBool::new(false), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| box_.watch(began, &over, &late));
        }
        let ended = (|| {
            let status = until(&|s| s["scan"]["seconds"].as_f64().is_some_and(|t| t >= SCAN_S))?;
            box_.ask("POST", "/api/scan/stop")?;
            until(&|s| s["state"] == "ready")?;
            let count = |v: &Value| v.as_u64().ok_or("no such count");
            Ok(Dropped {
                pairs: count(&status["scan"]["fused_pairs"])?,
                dropped_pairs: count(&status["drops"]["dropped_pairs"])?,
                dropped_frames: count(&status["drops"]["dropped_frames"])?,
                lights: count(&status["live"]["light"])?,
            })
        })();
        over.store(true, Ordering::Relaxed);
        ended
    })
}

/// Starts the command with a token for this program; returns it with its page.
fn served(mut command: Command, folder: &Path) -> Outcome<(Running, Box_)> {
    let token = folder.join("token");
    let mut child = command
        .args(["--set", &format!("serve.token_file={}", token.display())])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()?;
    let mut stderr = BufReader::new(child.stderr.take().ok_or("stderr")?);
    let running = Running(child);
    let mut line = String::new();
    stderr.read_line(&mut line)?;
    std::thread::spawn(move || std::io::copy(&mut stderr, &mut std::io::sink()));
    let host = line.trim().strip_prefix("serving http://").and_then(|l| l.split('/').next()).ok_or("no address")?;
    Ok((running, Box_ { host: host.into(), token: std::fs::read_to_string(&token)?.trim().into() }))
}

fn watch(lumiscan: &str, recording: &Path, clients: usize, more: &[&str]) -> Outcome<Watched> {
    let folder = tempfile::tempdir()?;
    // The scan is read after the folder of this run is gone.
    let device = std::env::temp_dir().join("lumiscan-watching");
    // What an interrupted run left there would be told first.
    let _ = std::fs::remove_dir_all(&device);
    let mut command = Command::new(lumiscan);
    command.args(["replay", "--watch", "--keep", "--device"]).arg(&device).arg(recording).args(more);
    let (running, box_) = served(command, folder.path())?;
    box_.ask("POST", "/api/scan/start")?;
    let (began, over, late) = (Instant::now(), AtomicBool::new(false), Mutex::new(Vec::new()));
    let (mut lights, mut first_light_s): (Vec<Value>, Option<f64>) = (Vec::new(), None);
    let status = std::thread::scope(|scope| -> Outcome<Value> {
        for _ in 0..clients {
            scope.spawn(|| box_.watch(began, &over, &late));
        }
        let mut pairs = 0;
        let ended = (|| loop {
            let mut status: Value = serde_json::from_slice(&box_.ask("GET", "/api/status")?.1)?;
            if status["live"]["light"].as_u64().unwrap_or(0) > lights.len() as u64 {
                first_light_s.get_or_insert(began.elapsed().as_secs_f64());
                lights.push(serde_json::from_slice(&box_.ask("GET", "/api/light")?.1)?);
            }
            pairs = status["scan"]["fused_pairs"].as_u64().unwrap_or(pairs);
            if status["state"] == "done" {
                status["pairs"] = pairs.into();
                return Ok(status);
            }
            std::thread::sleep(Duration::from_millis(100));
        })();
        over.store(true, Ordering::Relaxed);
        ended
    })?;
    let of = |file: &str| std::fs::read_to_string(format!("/proc/{}/{file}", running.0.id()));
    let stat = of("stat")?;
    // After the name, which may hold anything: user and system time are the 12th and 13th, in hundredths of a second.
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = fields[11].parse::<f64>()? + fields[12].parse::<f64>()?;
    let memory = of("status")?;
    let peak = memory.lines().find_map(|l| l.strip_prefix("VmHWM:")).ok_or("no peak")?;
    Ok(Watched {
        cpu_s: ticks / 100.0,
        peak_bytes: peak.trim().trim_end_matches(" kB").parse::<u64>()? * 1024,
        pairs: status["pairs"].as_u64().unwrap_or(0),
        late_s: late.into_inner()?,
        lights,
        first_light_s,
        scan: status["last_scan"].as_str().map(PathBuf::from),
    })
}

/// The page under measurement.
struct Box_ {
    host: String,
    token: String,
}

impl Box_ {
    fn send(&self, method: &str, path: &str) -> Outcome<BufReader<TcpStream>> {
        let mut stream = TcpStream::connect(&self.host)?;
        stream.set_read_timeout(Some(Duration::from_secs(20)))?;
        let (host, token) = (&self.host, &self.token);
        write!(
            stream,
            "{method} {path} HTTP/1.1\r\nHost: {host}\r\nAuthorization: Bearer {token}\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"
        )?;
        Ok(BufReader::new(stream))
    }

    /// Head and body of the answer.
    fn ask(&self, method: &str, path: &str) -> Outcome<(String, Vec<u8>)> {
        let mut bytes = Vec::new();
        self.send(method, path)?.read_to_end(&mut bytes)?;
        let at = bytes.windows(4).position(|w| w == b"\r\n\r\n").ok_or("no head")?;
        Ok((String::from_utf8_lossy(&bytes[..at]).into_owned(), bytes.split_off(at + 4)))
    }

    /// Takes pictures, surface and events, as a page does.
    fn watch(&self, began: Instant, over: &AtomicBool, late: &Mutex<Vec<f64>>) {
        std::thread::scope(|scope| {
            scope.spawn(|| self.events(over));
            scope.spawn(|| self.surface(over));
            scope.spawn(|| self.pictures(began, over, late));
        });
    }

    fn events(&self, over: &AtomicBool) {
        let Ok(mut stream) = self.send("GET", "/api/events") else { return };
        let mut line = String::new();
        while !over.load(Ordering::Relaxed) && stream.read_line(&mut line).is_ok_and(|n| n > 0) {
            line.clear();
        }
    }

    fn surface(&self, over: &AtomicBool) {
        let (mut generation, mut since) = (0, 0);
        while !over.load(Ordering::Relaxed) {
            let path = format!("/api/surface?generation={generation}&since={since}");
            let Ok((_, bytes)) = self.ask("GET", &path) else { return };
            if let (Some(g), Some(s)) = (bytes.get(4..8), bytes.get(8..16)) {
                generation = g.try_into().map_or(0, u32::from_le_bytes);
                since = s.try_into().map_or(0, u64::from_le_bytes);
            }
            std::thread::sleep(Duration::from_millis(if bytes.len() > 200_000 { 30 } else { 350 }));
        }
    }

    fn pictures(&self, began: Instant, over: &AtomicBool, late: &Mutex<Vec<f64>>) {
        let mut last = 0u64;
        while !over.load(Ordering::Relaxed) {
            let Ok((head, _)) = self.ask("GET", &format!("/api/live.jpg?after={last}")) else { return };
            let header = |name: &str| -> Option<f64> {
                head.lines().find_map(|l| l.strip_prefix(name)?.strip_prefix(": ")?.parse().ok())
            };
            let (Some(number), Some(seconds)) = (header("X-Number"), header("X-Seconds")) else { continue };
            last = number as u64;
            if let Ok(mut late) = late.lock() {
                late.push(began.elapsed().as_secs_f64() - seconds);
            }
        }
    }
}

/// The true light and how the true surface receives it, in the scan's axes.
struct Truth {
    /// `[vertex][81][3]`, alike for the channels.
    transfer: Vec<f64>,
    light: Vec<[f64; 3]>,
}

impl Truth {
    fn read(recording: &Path, scan: &Path) -> Outcome<Self> {
        let folder = recording.with_file_name("tabletop_truth");
        let (found, right) =
            (read_trajectory(&scan.join("trajectory.txt"))?, read_trajectory(&folder.join("trajectory.txt"))?);
        let (time, pose) = found.first().ok_or("nothing was tracked")?;
        let near = |t: i64| (t - time).abs() < 100_000;
        let (_, right) = right.iter().find(|(t, _)| near(*t)).ok_or("the scan is not one of the bundled recording")?;
        // From the scan's world to the scene's.
        let turn: DQuat = (right.rotation * pose.rotation.inverse()).normalize();
        let back = turn.inverse().as_quat();
        let mut mesh = read_ply(&folder.join("mesh.ply"))?;
        mesh.positions.iter_mut().chain(&mut mesh.normals).for_each(|v| *v = back * *v);
        let scene = RayScene::new(&mesh);
        let traced =
            Tracer { mesh: &mesh, graph: &Graph::of(&mesh), scene: &scene, bands: BANDS, seed: 1 }.trace(RAYS, &|_| {});
        let there = tabletop::tabletop(CELL_M).environment;
        let light = Environment::new(128, |d| there.radiance(turn.as_quat() * d)).spherical_harmonics(BANDS - 1);
        // What is nearly hidden receives next to nothing, of which no share is an error that anybody sees.
        let open =
            traced.direct.chunks_exact(BANDS * BANDS).zip(&traced.blocked).filter(|(_, blocked)| **blocked < HIDDEN);
        let transfer = open.flat_map(|(row, _)| row).flat_map(|x| [f64::from(*x); 3]).collect();
        Ok(Self { transfer, light })
    }

    fn error(&self, coefficients: &[[f64; 3]]) -> (f64, f64) {
        scene_irradiance(&self.transfer, coefficients, &self.light)
    }
}
