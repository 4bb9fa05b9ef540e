//! What the end-to-end tests share: running the executable, and a small synthetic scan as a TUM folder.

#![allow(dead_code, reason = "every test file uses a part of it")]
#![allow(clippy::expect_used, clippy::unwrap_used, reason = "these are tests")]

pub mod daemon;
pub mod http;
pub mod usage;

use assert_cmd::Command;
use estimator::rays::RayScene;
use glam::{DMat3, DVec3, Vec3};
use recordings::result::Estimate;
use std::fmt::Write as _;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::process::Output;

/// Size of the synthetic pictures.
pub const SIZE: (u32, u32) = (160, 120);
const FOCAL: f64 = 131.25;
const DEPTH_SCALE: f64 = 5000.0;

/// Path of the executable. Cargo's `runner` (an emulator, a checker) is not put before it: the kernel or that program sees to it.
pub const EXECUTABLE: &str = env!("CARGO_BIN_EXE_lumiscan");

/// The executable.
pub fn lumiscan() -> Command {
    let mut command = Command::new(EXECUTABLE);
    command.env_remove("LUMISCAN_DEVICE").timeout(std::time::Duration::from_secs(600));
    command
}

/// Runs it and returns what it printed.
pub fn run<S: AsRef<std::ffi::OsStr>>(args: &[S]) -> Output {
    lumiscan().args(args).output().expect("the executable starts")
}

/// Stdout of a run that ends well.
pub fn ok<S: AsRef<std::ffi::OsStr>>(args: &[S]) -> String {
    let output = run(args);
    assert!(output.status.success(), "{}", text(&output.stderr));
    text(&output.stdout)
}

/// Stderr of a run that ends with `code` and prints nothing on stdout.
pub fn fails<S: AsRef<std::ffi::OsStr>>(code: i32, args: &[S]) -> String {
    let output = run(args);
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{stderr}");
    assert!(!stderr.contains("panicked"), "{stderr}");
    assert_eq!(text(&output.stdout), "", "nothing is a result");
    stderr
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// JSON that the run prints.
pub fn json<S: AsRef<std::ffi::OsStr>>(args: &[S]) -> serde_json::Value {
    serde_json::from_str(&ok(args)).expect("JSON on stdout")
}

/// Path as an argument.
pub fn arg(path: impl AsRef<Path>) -> String {
    path.as_ref().to_str().expect("temporary paths are UTF-8").to_owned()
}

/// The folder `name` for what outlives a single test, emptied. It stays in the target folder until the next run.
pub fn fixture(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("a folder for fixtures");
    folder
}

/// A fixture folder with the synthetic table scanned and estimated, and the published scan in it.
pub fn scanned_table(name: &str) -> (PathBuf, PathBuf) {
    let dir = fixture(name);
    let (source, device) = (dir.join("table"), dir.join("device"));
    tum_folder(&source, 24);
    let settings = ["--set", "fusion.voxel_size_m=0.01", "--rounds", "2"];
    let folder = ok(&[&["replay", &arg(&source), "--device", &arg(&device)][..], &settings].concat());
    (dir, PathBuf::from(folder.trim()))
}

/// Where the middle of keyframe 0 meets the mesh of a result.
pub fn middle_of(estimate: &Estimate) -> Vec3 {
    let k = &estimate.keyframes[0];
    let i = k.camera.intrinsics;
    let d = k.world_from_camera.rotation * k.camera.unproject(f64::from(i.width) / 2.0, f64::from(i.height) / 2.0);
    let (eye, d) = (k.world_from_camera.translation.as_vec3(), d.normalize().as_vec3());
    eye + d * RayScene::new(&estimate.mesh).closest_hit(eye, d).expect("the table").distance
}

/// True if another program can be run like this.
pub fn works(command: &mut std::process::Command) -> bool {
    command.output().is_ok_and(|o| o.status.success())
}

/// Python, if it finds the module; otherwise says why not. `LUMISCAN_PYTHON` names another interpreter.
pub fn python(module: &str) -> Option<std::process::Command> {
    let program = std::env::var("LUMISCAN_PYTHON").unwrap_or_else(|_| "python3".into());
    let found = works(std::process::Command::new(&program).args(["-c", &format!("import {module}")]));
    if !found {
        eprintln!("skipped: {program} does not find the module {module} (LUMISCAN_PYTHON names another interpreter)");
    }
    found.then(|| std::process::Command::new(program))
}

/// The small recording that comes with the repository.
pub fn tiny_recording() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../recordings/data/tiny.lrec")
}

/// Publishes a scan of it in the device folder that takes half a second to estimate; returns the scan's folder.
pub fn small_scan(device: &Path, effort: &[&str]) -> PathBuf {
    let (source, device) = (arg(tiny_recording()), arg(device));
    let mut args = vec!["replay", &source, "--device", &device];
    for setting in ["fusion.voxel_size_m=0.05", "estimator.bands=2", "estimator.refine_poses=off"] {
        args.extend(["--set", setting]);
    }
    args.extend(effort);
    PathBuf::from(ok(&args).trim())
}

/// Writes a TUM folder: a table with two balls on it, seen from a camera that moves along a small arc.
pub fn tum_folder(dir: &Path, frames: usize) {
    for sub in ["rgb", "depth"] {
        std::fs::create_dir_all(dir.join(sub)).expect("a temporary folder");
    }
    let (mut rgb, mut depth) = (String::from("# color images\n"), String::from("# depth maps\n"));
    for i in 0..frames {
        let (t_color, t_depth) = (1000.0 + i as f64 / 30.0, 1000.004 + i as f64 / 30.0);
        let (colors, depths) = render(i as f64 * 0.008);
        write_png(&dir.join(format!("rgb/{i}.png")), png::ColorType::Rgb, png::BitDepth::Eight, &colors);
        let bytes: Vec<u8> = depths.iter().flat_map(|d| d.to_be_bytes()).collect();
        write_png(&dir.join(format!("depth/{i}.png")), png::ColorType::Grayscale, png::BitDepth::Sixteen, &bytes);
        let _ = writeln!(rgb, "{t_color:.6} rgb/{i}.png");
        let _ = writeln!(depth, "{t_depth:.6} depth/{i}.png");
    }
    let (w, h) = SIZE;
    let (cx, cy) = (f64::from(w) / 2.0 - 0.5, f64::from(h) / 2.0 - 0.5);
    let camera = format!("# fx fy cx cy depth_scale width height\n{FOCAL} {FOCAL} {cx} {cy} {DEPTH_SCALE} {w} {h}\n");
    for (name, content) in [("rgb.txt", rgb), ("depth.txt", depth), ("camera.txt", camera)] {
        std::fs::write(dir.join(name), content).expect("a temporary file");
    }
}

/// Colour (sRGB bytes) and depth (in units of the TUM folder) of the scene at a place `s` along the arc.
fn render(s: f64) -> (Vec<u8>, Vec<u16>) {
    let eye = DVec3::new(0.9 * libm::sin(s), -0.9 * libm::cos(s), 0.6);
    let forward = (DVec3::new(0.0, 0.0, 0.05) - eye).normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let world_from_camera = DMat3::from_cols(right, forward.cross(right), forward);
    let (w, h) = SIZE;
    let (mut colors, mut depths) = (Vec::new(), Vec::new());
    for i in 0..w * h {
        let (u, v) = (f64::from(i % w) + 0.5 - f64::from(w) / 2.0, f64::from(i / w) + 0.5 - f64::from(h) / 2.0);
        let camera_ray = DVec3::new(u / FOCAL, v / FOCAL, 1.0);
        let (depth, color) = trace(eye, world_from_camera * camera_ray);
        depths.push((depth * DEPTH_SCALE).round().min(65535.0) as u16);
        colors.extend(color.to_array().map(|c| (255.0 * libm::pow(c.clamp(0.0, 1.0), 1.0 / 2.2)).round() as u8));
    }
    (colors, depths)
}

/// Depth along the optical axis and linear colour of what a ray (of unit depth) hits.
fn trace(eye: DVec3, ray: DVec3) -> (f64, DVec3) {
    let balls = [
        (DVec3::new(-0.15, 0.0, 0.12), 0.12, DVec3::new(0.7, 0.25, 0.2)),
        (DVec3::new(0.18, 0.08, 0.09), 0.09, DVec3::new(0.2, 0.35, 0.7)),
    ];
    let mut best = (f64::INFINITY, DVec3::ZERO, DVec3::Z, DVec3::ZERO);
    for (center, radius, albedo) in balls {
        let (o, a) = (eye - center, ray.length_squared());
        let (b, c) = (o.dot(ray), o.length_squared() - radius * radius);
        let discriminant = b * b - a * c;
        let t = (-b - discriminant.max(0.0).sqrt()) / a;
        if discriminant > 0.0 && t > 0.0 && t < best.0 {
            best = (t, eye + ray * t, (eye + ray * t - center) / radius, albedo);
        }
    }
    let table = -eye.z / ray.z;
    if table > 0.0 && table < best.0 {
        let p = eye + ray * table;
        // Soft spots give tracking something to hold on to.
        let spots = libm::sin(p.x * 23.0) * libm::sin(p.y * 19.0) + libm::sin(p.x * 51.0 + p.y * 37.0) * 0.5;
        best = (table, p, DVec3::Z, DVec3::splat(0.4 + 0.12 * spots));
    }
    let (t, point, normal, albedo) = best;
    if !t.is_finite() || t > 3.0 {
        return (0.0, DVec3::splat(0.05));
    }
    let sun = DVec3::new(0.5, -0.4, 0.75).normalize();
    let shadow = balls.iter().any(|(center, radius, _)| {
        let o = point + normal * 1e-3 - *center;
        let b = o.dot(sun);
        b < 0.0 && b * b > o.length_squared() - radius * radius && o.length() > *radius
    });
    let direct = if shadow { 0.0 } else { normal.dot(sun).max(0.0) };
    (t, albedo * (0.35 + 0.25 * normal.z + 0.6 * direct))
}

pub fn write_png(path: &Path, color: png::ColorType, bits: png::BitDepth, data: &[u8]) {
    let file = BufWriter::new(File::create(path).expect("a temporary file"));
    let mut encoder = png::Encoder::new(file, SIZE.0, SIZE.1);
    encoder.set_color(color);
    encoder.set_depth(bits);
    let mut writer = encoder.write_header().expect("a header");
    writer.write_image_data(data).expect("a picture");
}

/// A library to preload, from a C source below `tests/`, built in `folder`.
#[cfg(target_os = "linux")]
pub fn preload(source: &str, folder: &Path) -> PathBuf {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests").join(source);
    let library = folder.join(source.with_extension("so").file_name().expect("the name of a file"));
    let built = std::process::Command::new(std::env::var("CC").unwrap_or("cc".into()))
        .args(["-std=gnu11", "-Wall", "-Wextra", "-Werror", "-O2", "-shared", "-fPIC", "-o", &arg(&library)])
        .arg(source)
        .args(["-lpthread", "-ldl"])
        .status();
    assert!(built.is_ok_and(|s| s.success()), "the C compiler that built libusb builds this");
    library
}

/// The child process of `parent`, if it has one.
#[cfg(target_os = "linux")]
pub fn child_of(parent: u32) -> Option<u32> {
    let tasks = std::fs::read_dir(format!("/proc/{parent}/task")).ok()?;
    tasks.flatten().find_map(|task| {
        let children = std::fs::read_to_string(task.path().join("children")).ok()?;
        children.split_whitespace().next()?.parse().ok()
    })
}

/// Names of everything below `<device>/scans`, hidden ones too.
pub fn scans(device: &Path) -> Vec<String> {
    let Ok(entries) = std::fs::read_dir(device.join("scans")) else { return Vec::new() };
    let mut names: Vec<String> = entries.map(|e| text(e.expect("an entry").file_name().as_encoded_bytes())).collect();
    names.sort();
    names
}
