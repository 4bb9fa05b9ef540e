//! What `lumiscan render` makes of the desk under its lamp, beside what the path tracer makes of the true scene. Needs
//! `LUMISCAN_SHARED`.
//!
//!     lumiscan import photos $LUMISCAN_SHARED/truth_near/lamp -o lamp.lscan
//!     lumiscan estimate lamp.lscan --rounds 2
//!     cargo run --release -p tests --example lamp_desk -- LUMISCAN lamp.lres OUT [SAMPLES]
//!
//! Prints the figures of a knot inserted over three keyframes (mask, shadow: as the shared scorer of composites defines
//! them), and those of the desk as scanned, with its lamp off, and with its lamp moved; writes the latter, truth above, to
//! `OUT/lamps.jpg`.

#![allow(clippy::expect_used, reason = "whatever is wrong with a fixture is to end the program")]

use glam::Vec3;
use recordings::ply::read::read_ply;
use recordings::types::{Intrinsics, RgbImage};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::Command;
use tests::lamp_desk::{Inserted, LampDesk, TrueView};
use tests::synth::color_sensor::{ColorSensor, Gain};
use tests::synth::emitters::Sphere;
use tests::synth::render::{self, Exposure, Image, Shading};
use tests::synth::scene::Scene;

/// Keyframes that the knot is inserted over.
const VIEWS: [usize; 3] = [4, 7, 11];
/// Where it stands: from its place in its own file.
const KNOT_AT: Vec3 = Vec3::new(-0.27, 0.1, 0.0);
/// Its albedo, as its file says.
const KNOT_ALBEDO: Vec3 = Vec3::new(0.7, 0.3, 0.15);
/// Where the lamp is moved.
const LAMP_TO: Vec3 = Vec3::new(0.3, -0.2, 0.35);
/// Keyframe of the pictures, and their size.
const SHOWN: usize = 4;
const SHOWN_SIZE: [u32; 2] = [320, 240];
/// Pixels around an outline that belong to neither side of it.
const MARGIN: usize = 2;
/// Rays a pixel of the true pictures.
const SAMPLES: usize = 128;
const JPEG_QUALITY: u8 = 90;

/// The executable, a result of the scene, and where pictures go.
struct Run {
    lumiscan: PathBuf,
    result: PathBuf,
    out: PathBuf,
    samples: usize,
}

impl Run {
    /// A picture of `lumiscan render`.
    fn render(&self, name: &str, options: &[String]) -> Result<RgbImage, Box<dyn Error>> {
        let file = self.out.join(name);
        let mut command = Command::new(&self.lumiscan);
        let output = command.arg("render").arg(&self.result).arg("-o").arg(&file).args(options).output()?;
        if !output.status.success() {
            return Err(String::from_utf8_lossy(&output.stderr).into());
        }
        Ok(RgbImage::decode(&std::fs::read(&file)?)?)
    }

    /// The path tracer's picture, as the camera would have taken it without noise.
    fn truth(&self, scene: &Scene, view: &TrueView, camera: &Intrinsics) -> RgbImage {
        let threads = std::thread::available_parallelism().map_or(1, Into::into);
        let exposure = Exposure::still(view.world_from_camera, self.samples, threads);
        let radiance: Image<Vec3> = render::color(scene, Shading::Traced, camera, &exposure);
        let blur_px = ColorSensor::default().blur_px * camera.width as f32 / 640.0;
        let sensor = ColorSensor { blur_px, full_well_e: f32::INFINITY, read_noise: 0.0, ..ColorSensor::default() };
        sensor.expose(&radiance, Gain { gain: 1.0, white_balance: view.gain }, 0)
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (lumiscan, result, out, samples) = match arguments.as_slice() {
        [lumiscan, result, out] => (lumiscan, result, out, SAMPLES),
        [lumiscan, result, out, samples] => (lumiscan, result, out, samples.parse()?),
        _ => return Err("usage: lamp_desk LUMISCAN RESULT OUT [SAMPLES]".into()),
    };
    std::fs::create_dir_all(out)?;
    let run = Run { lumiscan: lumiscan.into(), result: result.into(), out: out.into(), samples };
    let desk = LampDesk::new(&tests::shared());
    insertion(&run, &desk)?;
    lamps(&run, &desk)
}

/// The knot over each of the views.
fn insertion(run: &Run, desk: &LampDesk) -> Result<(), Box<dyn Error>> {
    let file = tests::shared().join("truth_mix/fruits/insert/knot/object.ply");
    let mut mesh = read_ply(&file)?;
    mesh.positions.iter_mut().for_each(|p| *p += KNOT_AT);
    let knot = Inserted { mesh, albedo: KNOT_ALBEDO };
    let object = file.with_extension("glb");
    let at = KNOT_AT.to_array().map(|x| x.to_string()).join(",");
    let with = desk.scene(Some(&knot), vec![desk.lamp()]);
    let without = desk.scene(None, vec![desk.lamp()]);
    println!(
        "| knot inserted over keyframe | mask, dB | object | shadow | shadow, photo unchanged |\n|---|---|---|---|---|"
    );
    let mut pooled = [Pool::default(); 4];
    for number in VIEWS {
        let view = desk.view(number);
        let whole = desk.camera();
        let over = ["--view", &format!("keyframe:{number}"), "--over", "photo", "--insert"].map(String::from);
        let insert = format!("{}@{at}", object.display());
        let result = run.render(&format!("knot_{number:03}.png"), &[&over[..], &[insert]].concat())?;
        let crop = Crop::around(&knot, &view, &whole);
        let camera = crop.camera(&whole);
        let (truth, clean) = (run.truth(&with, &view, &camera), run.truth(&without, &view, &camera));
        let (photo, result) = (crop.of(&view.photo), crop.of(&result));
        let size = [camera.width as usize, camera.height as usize];
        let silhouette = silhouette(&with, &without, &view, &camera);
        let differs: Vec<f32> = truth.data.chunks(3).zip(clean.data.chunks(3)).map(|(a, b)| change(a, b)).collect();
        let mask: Vec<bool> = blurred(&differs, size, 2).iter().map(|d| *d > 0.02).collect();
        let mask: Vec<bool> = mask.iter().zip(grown(&silhouette, size, 3)).map(|(m, s)| *m || s).collect();
        let outside = grown(&silhouette, size, MARGIN);
        let shadow = |i: usize| mask[i] && !outside[i];
        let figures = [
            Pool::of(&result, &truth, |i| mask[i]),
            Pool::of(&result, &truth, |i| mask[i] && silhouette[i]),
            Pool::of(&result, &truth, shadow),
            Pool::of(&photo, &truth, shadow),
        ];
        println!("| {number} | {} |", figures.map(|p| format!("{:.1}", p.psnr())).join(" | "));
        pooled.iter_mut().zip(figures).for_each(|(sum, p)| sum.add(&p));
    }
    println!("| all | {} |\n", pooled.map(|p| format!("{:.1}", p.psnr())).join(" | "));
    Ok(())
}

/// The desk as scanned, its lamp off, its lamp moved.
fn lamps(run: &Run, desk: &LampDesk) -> Result<(), Box<dyn Error>> {
    let (view, whole) = (desk.view(SHOWN), desk.camera());
    let scale = f64::from(SHOWN_SIZE[0]) / f64::from(whole.width);
    let center = |c: f64| (c + 0.5) * scale - 0.5;
    let camera = Intrinsics {
        width: SHOWN_SIZE[0],
        height: SHOWN_SIZE[1],
        fx: whole.fx * scale,
        fy: whole.fy * scale,
        cx: center(whole.cx),
        cy: center(whole.cy),
    };
    let lamp = desk.lamp();
    let moved = format!("0=@{}", LAMP_TO.to_array().map(|x| x.to_string()).join(","));
    let states: [(&str, Vec<Sphere>, &[&str]); 3] = [
        ("as scanned", vec![lamp], &[]),
        ("lamp off", vec![], &["--lamp", "0=off"]),
        ("lamp moved", vec![Sphere { center: LAMP_TO, ..lamp }], &["--lamp", &moved]),
    ];
    let mut columns = Vec::new();
    println!("| desk from keyframe {SHOWN} | surfaces, dB |\n|---|---|");
    for (name, spheres, options) in states {
        let size = format!("{}x{}", SHOWN_SIZE[0], SHOWN_SIZE[1]);
        let base = ["--view", &format!("keyframe:{SHOWN}"), "--size", &size].map(String::from);
        let options: Vec<String> = base.into_iter().chain(options.iter().map(|o| (*o).to_owned())).collect();
        let found = run.render(&format!("{}.png", name.replace(' ', "_")), &options)?;
        let scene = desk.scene(None, spheres);
        let truth = run.truth(&scene, &view, &camera);
        // Beyond the desk and through the lamp the scan knows nothing.
        let surface = surfaces(&scene, &view, &camera);
        println!("| {name} | {:.1} |", Pool::of(&found, &truth, |i| surface[i]).psnr());
        columns.push([truth, found]);
    }
    write(&run.out.join("lamps.jpg"), &columns)
}

/// Pixels whose centre shows the mesh, not a lamp.
fn surfaces(scene: &Scene, view: &TrueView, camera: &Intrinsics) -> Vec<bool> {
    let meets = |origin: Vec3, d: Vec3| {
        let surface = scene.intersect(origin, d)?;
        let lamp = scene.emitters.along(origin, d).is_some_and(|(distance, _)| distance < surface.distance);
        (!lamp).then_some(())
    };
    pixels(view, camera).map(|(origin, d)| meets(origin, d).is_some()).collect()
}

/// Pixels whose centre shows the knot.
fn silhouette(with: &Scene, without: &Scene, view: &TrueView, camera: &Intrinsics) -> Vec<bool> {
    let far = |scene: &Scene, origin: Vec3, d: Vec3| scene.intersect(origin, d).map_or(f32::INFINITY, |s| s.distance);
    pixels(view, camera).map(|(o, d)| far(with, o, d) < far(without, o, d)).collect()
}

fn pixels(view: &TrueView, camera: &Intrinsics) -> impl Iterator<Item = (Vec3, Vec3)> {
    let (origin, turn) = (view.world_from_camera.translation.as_vec3(), view.world_from_camera.rotation.as_quat());
    (0..camera.width * camera.height).map(move |i| {
        let pixel = [(i % camera.width) as f32, (i / camera.width) as f32];
        (origin, (turn * render::ray(camera, pixel)).normalize())
    })
}

/// Part of a picture.
struct Crop {
    left: u32,
    top: u32,
    width: u32,
    height: u32,
}

impl Crop {
    /// Twice the knot's size about it.
    fn around(knot: &Inserted, view: &TrueView, camera: &Intrinsics) -> Self {
        let inverse = view.world_from_camera.inverse();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in &knot.mesh.positions {
            let p = inverse.transform(p.as_dvec3());
            let at = [camera.fx * p.x / p.z + camera.cx, camera.fy * p.y / p.z + camera.cy];
            low = [low[0].min(at[0]), low[1].min(at[1])];
            high = [high[0].max(at[0]), high[1].max(at[1])];
        }
        let side = |axis: usize, most: u32| {
            let margin = high[axis] - low[axis];
            let first = (low[axis] - margin).clamp(0.0, f64::from(most - 1)) as u32;
            (first, (high[axis] + margin).clamp(0.0, f64::from(most)) as u32 - first)
        };
        let ((left, width), (top, height)) = (side(0, camera.width), side(1, camera.height));
        Self { left, top, width, height }
    }

    fn camera(&self, whole: &Intrinsics) -> Intrinsics {
        let (cx, cy) = (whole.cx - f64::from(self.left), whole.cy - f64::from(self.top));
        Intrinsics { width: self.width, height: self.height, cx, cy, ..*whole }
    }

    fn of(&self, picture: &RgbImage) -> RgbImage {
        let row = |y: u32| {
            let start = (3 * ((self.top + y) * picture.width + self.left)) as usize;
            picture.data[start..start + 3 * self.width as usize].iter().copied()
        };
        RgbImage { width: self.width, height: self.height, data: (0..self.height).flat_map(row).collect() }
    }
}

/// Largest relative change of a channel, linear.
fn change(with: &[u8], without: &[u8]) -> f32 {
    let linear = |v: u8| libm::powf((f32::from(v) / 255.0 + 0.055) / 1.055, 2.4);
    with.iter().zip(without).map(|(a, b)| (linear(*a) / linear(*b) - 1.0).abs()).fold(0.0, f32::max)
}

/// Mean over squares of side 2 `half` + 1.
fn blurred(values: &[f32], size: [usize; 2], half: usize) -> Vec<f32> {
    (0..values.len())
        .map(|i| {
            let around = square(i, size, half);
            around.iter().map(|&j| values[j]).sum::<f32>() / around.len() as f32
        })
        .collect()
}

fn grown(mask: &[bool], size: [usize; 2], by: usize) -> Vec<bool> {
    (0..mask.len()).map(|i| square(i, size, by).iter().any(|&j| mask[j])).collect()
}

fn square(i: usize, [width, height]: [usize; 2], half: usize) -> Vec<usize> {
    let (x, y) = (i % width, i / width);
    let rows = y.saturating_sub(half)..(y + half + 1).min(height);
    rows.flat_map(|y| (x.saturating_sub(half)..(x + half + 1).min(width)).map(move |x| y * width + x)).collect()
}

/// Squared differences of 8-bit values.
#[derive(Debug, Clone, Copy, Default)]
struct Pool {
    squares: f64,
    count: f64,
}

impl Pool {
    fn of(found: &RgbImage, truth: &RgbImage, counts: impl Fn(usize) -> bool) -> Self {
        let mut pool = Self::default();
        let pairs = found.data.chunks(3).zip(truth.data.chunks(3)).enumerate();
        for (_, (a, b)) in pairs.filter(|(i, _)| counts(*i)) {
            pool.squares += a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum::<f64>();
            pool.count += 3.0;
        }
        pool
    }

    fn add(&mut self, other: &Self) {
        self.squares += other.squares;
        self.count += other.count;
    }

    fn psnr(&self) -> f64 {
        10.0 * libm::log10(255.0 * 255.0 * self.count / self.squares)
    }
}

/// Truth above, what was rendered below it.
fn write(path: &Path, columns: &[[RgbImage; 2]]) -> Result<(), Box<dyn Error>> {
    let [width, height] = SHOWN_SIZE.map(|s| s as usize);
    let across = width * columns.len();
    let mut bytes = vec![0u8; 3 * across * 2 * height];
    for (column, pictures) in columns.iter().enumerate() {
        for (row, picture) in pictures.iter().enumerate() {
            for (y, line) in picture.data.chunks(3 * width).enumerate() {
                let at = 3 * ((row * height + y) * across + column * width);
                bytes[at..at + line.len()].copy_from_slice(line);
            }
        }
    }
    let encoder = jpeg_encoder::Encoder::new_file(path, JPEG_QUALITY)?;
    Ok(encoder.encode(&bytes, u16::try_from(across)?, u16::try_from(2 * height)?, jpeg_encoder::ColorType::Rgb)?)
}
