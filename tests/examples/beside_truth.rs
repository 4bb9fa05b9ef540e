//! What `lumiscan replay recordings/data/tabletop.lrec` recovers, beside what is true:
//! `cargo run --release -p tests --example beside_truth -- SCAN/result.lres OUT.jpg`.
//!
//! Above what is true, below what was recovered; from left to right a keyframe's view, its albedo, the light (up is +Z;
//! both to as many bands as were recovered, and smoothed alike), and the view in a light that the scan never saw. Albedo
//! and brightness have a free factor in each channel: medians over the view set them.

use estimator::numerics::sh;
use estimator::rays::RayScene;
use estimator::render::change::change;
use estimator::render::compose::Viewpoint;
use estimator::render::inpainting::geometry::cut;
use estimator::render::lighting::completion::complete;
use estimator::render::lighting::environment::Environment;
use estimator::render::lighting::observed_background::ObservedBackground;
use estimator::render::relight::{BANDS, NewLight, Relight};
use firmware_config::RealityConfig;
use glam::{DQuat, DVec3, Vec3};
use rayon::prelude::*;
use recordings::import::trajectory::read_trajectory;
use recordings::local_light::LocalLight;
use recordings::result::{Estimate, ResultKeyframe};
use recordings::types::{CameraModel, Distortion, Intrinsics, Pose, Response};
use std::error::Error;
use std::path::Path;
use tests::synth::environment::Environment as TrueLight;
use tests::synth::render::{self, Exposure, Shading};
use tests::synth::tabletop;

/// Size of a picture.
const SIZE: [usize; 2] = [320, 240];
/// Cells of the true scene, in metres.
const CELL_M: f32 = 0.003;
/// Rays a pixel of the true pictures.
const SAMPLES: usize = 256;
const JPEG_QUALITY: u8 = 90;
/// Share of an image that may be brighter than white.
const BRIGHTER: f32 = 0.01;

type Image = Vec<Vec3>;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [result, out] = arguments.as_slice() else { return Err("usage: beside_truth RESULT OUT.jpg".into()) };
    let estimate = Estimate::read(Path::new(result))?;
    let keyframe = estimate.keyframes.get(estimate.keyframes.len() / 2).ok_or("the result has no keyframe")?;
    let truth = true_pose(keyframe)?;
    // From the scan's world, which starts where its first frame was taken, to the scene's.
    let turn = (truth.rotation * keyframe.world_from_camera.rotation.inverse()).normalize();

    let mut scene = tabletop::tabletop(CELL_M);
    let camera = camera();
    let threads = rayon::current_num_threads();
    let exposure = Exposure::still(truth, SAMPLES, threads);
    let seen = render::color(&scene, Shading::Traced, &camera, &exposure).data;
    let albedo = true_albedo(&scene, &camera, &truth);
    let bands = estimate.light.bands().max(1) as usize;
    let coefficients = scene.environment.spherical_harmonics(bands - 1);
    let light = panorama(&coefficients, DQuat::IDENTITY);
    scene.environment = TrueLight::new(128, evening);
    let relit = render::color(&scene, Shading::Traced, &camera, &exposure).data;

    let view = View::new(&estimate, keyframe);
    let seen_found = view.lit(&NewLight {
        coefficients: estimate.light.coefficients.clone(),
        environment: Environment::from_light(&estimate.light),
        scanned: false,
    });
    let albedo_found = view.albedo(&estimate);
    let surface = |i: usize| albedo[i] != Vec3::ZERO && albedo_found[i] != Vec3::ZERO;
    let brightness = factor(&seen, &seen_found, surface);
    let reflectance = factor(&albedo, &albedo_found, surface);
    let light_found = panorama(&estimate.light.coefficients, turn.inverse());
    let there = TrueLight::new(128, move |d| evening((turn * d.as_dvec3()).as_vec3()));
    let relit_found = view.lit(&NewLight {
        coefficients: there.spherical_harmonics(BANDS - 1),
        environment: Environment::from_fn(|d| there.radiance(d)),
        scanned: false,
    });

    // Black beside the scene, as in the albedo: what is far away has no truth of its own.
    let masked = |image: Image, by: Vec3, albedo: &Image| -> Image {
        image.into_iter().zip(albedo).map(|(v, a)| if *a == Vec3::ZERO { *a } else { v * by }).collect()
    };
    let columns = [
        (masked(seen, Vec3::ONE, &albedo), masked(seen_found, brightness, &albedo_found)),
        (albedo.clone(), masked(albedo_found.clone(), reflectance, &albedo_found)),
        (light, light_found.into_iter().map(|v| v * brightness / reflectance).collect()),
        (masked(relit, Vec3::ONE, &albedo), masked(relit_found, reflectance, &albedo_found)),
    ];
    write(Path::new(out), &columns)
}

/// A night with a warm lamp low on the right and a cold one behind.
fn evening(d: Vec3) -> Vec3 {
    let lamp = |towards: Vec3, width: f32| libm::expf((d.dot(towards.normalize()) - 1.0) / (width * width));
    Vec3::new(0.010, 0.012, 0.018)
        + Vec3::new(6.0, 3.4, 1.5) * lamp(Vec3::new(0.8, -0.2, 0.5), 0.25)
        + Vec3::new(0.5, 0.9, 1.6) * lamp(Vec3::new(-0.5, 0.8, 0.9), 0.35)
}

/// Where the keyframe's picture was taken.
fn true_pose(keyframe: &ResultKeyframe) -> Result<Pose, Box<dyn Error>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../recordings/data/tabletop_truth/trajectory.txt");
    let near = |time: i64| (time - keyframe.timestamp_ns).abs() < 100_000;
    let found = read_trajectory(&path)?.into_iter().find(|(time, _)| near(*time));
    Ok(found.ok_or("the result is not one of the bundled recording")?.1)
}

/// The recording's camera at the size of the pictures.
fn camera() -> Intrinsics {
    let scale = SIZE[0] as f64 / 640.0;
    let [width, height] = SIZE.map(|s| s as u32);
    let center = |full: f64| (full / 2.0) * scale - 0.5;
    Intrinsics { width, height, fx: 525.0 * scale, fy: 525.0 * scale, cx: center(640.0), cy: center(480.0) }
}

fn pixels() -> impl IndexedParallelIterator<Item = [f32; 2]> {
    (0..SIZE[0] * SIZE[1]).into_par_iter().map(|i| [(i % SIZE[0]) as f32, (i / SIZE[0]) as f32])
}

/// Diffuse albedo at the pixels' centres, black beside the scene.
fn true_albedo(scene: &tests::synth::scene::Scene, camera: &Intrinsics, pose: &Pose) -> Image {
    let (origin, turn) = (pose.translation.as_vec3(), pose.rotation.as_quat());
    pixels()
        .map(|pixel| {
            let d = (turn * render::ray(camera, pixel)).normalize();
            let met = scene.intersect(origin, d);
            met.map_or(Vec3::ZERO, |s| scene.base_color(&s) * (1.0 - scene.parts[s.part].material.w_s))
        })
        .collect()
}

/// The recovered scene from the keyframe.
struct View {
    viewpoint: Viewpoint,
    relight: Relight,
    kept: estimator::render::relight::CachedView,
}

impl View {
    fn new(estimate: &Estimate, keyframe: &ResultKeyframe) -> Self {
        let config = RealityConfig::default();
        let viewpoint = Viewpoint {
            camera: CameraModel { intrinsics: camera(), distortion: Distortion::default() },
            world_from_camera: keyframe.world_from_camera,
            gain: Vec3::ONE,
        };
        let nothing = cut(&estimate.mesh, &vec![false; estimate.mesh.positions.len()], &config.tuning.inpainting);
        let around = (complete(&estimate.light, &[], &config.tuning.surroundings), ObservedBackground::default());
        let changed = change(estimate, around, nothing, &[], &config);
        let relight = Relight::new(&changed, &LocalLight::default(), &config, &|_| {});
        let kept = relight.view(&changed, &viewpoint, &config);
        Self { viewpoint, relight, kept }
    }

    fn lit(&self, light: &NewLight) -> Image {
        self.relight.picture(&self.kept, light, Vec3::ONE, None).linear
    }

    fn albedo(&self, estimate: &Estimate) -> Image {
        let scene = RayScene::new(&estimate.mesh);
        let eye = self.viewpoint.world_from_camera.translation.as_vec3();
        pixels()
            .map(|[x, y]| {
                let Some(hit) = scene.closest_hit(eye, self.viewpoint.ray(x, y)) else { return Vec3::ZERO };
                let [a, b, c] = estimate.mesh.triangles[hit.triangle as usize].map(|i| estimate.albedo[i as usize]);
                a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v
            })
            .collect()
    }
}

/// Light over directions, turned, in a picture twice as wide as high in the middle of one of the common size. Higher
/// bands count less (Hann's window), or else cutting the light off would ring.
fn panorama(coefficients: &[[f64; 3]], turn: DQuat) -> Image {
    let bands = coefficients.len().isqrt();
    let share = |band: usize| 0.5 + 0.5 * libm::cos(std::f64::consts::PI * band as f64 / bands as f64);
    let smoothed: Vec<[f64; 3]> =
        (0..).zip(coefficients).map(|(k, c): (usize, _)| c.map(|c| c * share(k.isqrt()))).collect();
    let margin = (SIZE[1] - SIZE[0] / 2) / 2;
    pixels()
        .map(|[x, y]| {
            let v = (y - margin as f32 + 0.5) / (SIZE[0] / 2) as f32;
            if !(0.0..1.0).contains(&v) {
                return Vec3::ZERO;
            }
            let (st, ct) = libm::sincosf(std::f32::consts::PI * v);
            let (sa, ca) = libm::sincosf(std::f32::consts::TAU * (x + 0.5) / SIZE[0] as f32);
            let direction = turn * DVec3::new((st * sa).into(), (st * ca).into(), ct.into());
            Vec3::from(sh::radiance(&smoothed, direction).map(|x| x as f32)).max(Vec3::ZERO)
        })
        .collect()
}

/// Median of `truth` over `found` in each channel where `counts`.
fn factor(truth: &[Vec3], found: &[Vec3], counts: impl Fn(usize) -> bool) -> Vec3 {
    let median = |c: usize| {
        let valid = (0..truth.len()).filter(|&i| counts(i) && found[i][c] > 1e-6);
        let mut ratios: Vec<f32> = valid.map(|i| truth[i][c] / found[i][c]).collect();
        ratios.sort_by(f32::total_cmp);
        ratios.get(ratios.len() / 2).copied().unwrap_or(1.0)
    };
    Vec3::new(median(0), median(1), median(2))
}

/// Truth above, what was found below it; the truth defines white.
fn write(path: &Path, columns: &[(Image, Image)]) -> Result<(), Box<dyn Error>> {
    let [width, height] = SIZE;
    let across = width * columns.len();
    let mut bytes = vec![0u8; 3 * across * 2 * height];
    for (column, (truth, found)) in columns.iter().enumerate() {
        let mut brightest: Vec<f32> = truth.iter().map(|v| v.max_element()).filter(|v| *v > 0.0).collect();
        brightest.sort_by(f32::total_cmp);
        let white = brightest.get((brightest.len() as f32 * (1.0 - BRIGHTER)) as usize).copied().unwrap_or(1.0);
        for (row, image) in [truth, found].into_iter().enumerate() {
            for (i, value) in image.iter().enumerate() {
                let at = 3 * ((row * height + i / width) * across + column * width + i % width);
                bytes[at..at + 3].copy_from_slice(&(*value / white).to_array().map(|c| Response::Srgb.encode(c)));
            }
        }
    }
    let encoder = jpeg_encoder::Encoder::new_file(path, JPEG_QUALITY)?;
    Ok(encoder.encode(&bytes, u16::try_from(across)?, u16::try_from(2 * height)?, jpeg_encoder::ColorType::Rgb)?)
}
