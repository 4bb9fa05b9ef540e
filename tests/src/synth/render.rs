//! Pictures of a scene, before any sensor has touched them: linear radiance, and depth.

use super::cache;
use super::exchange::Lit;
use super::parallel;
use super::random::{Rng, Stratified};
use super::scene::Scene;
use super::trace;
use glam::{DQuat, Vec3};
use recordings::types::{Intrinsics, Pose};

/// How surfaces get their colour.
#[derive(Debug, Clone, Copy)]
pub enum Shading<'a> {
    /// Albedo · (½ + ½ n_z): no light is traced. For pictures that only have to be trackable.
    Flat,
    /// Full path tracing.
    Traced,
    /// Diffuse light looked up (from [`cache::diffuse_light`], for the vertices of the mesh), glossy lobes traced.
    Cached(&'a [Vec3]),
    /// The same under any light, lamps included (from [`exchange`](super::exchange)).
    Lit(&'a Lit<'a>),
}

impl Shading<'_> {
    /// Radiance that arrives at `origin` from where the unit `direction` points.
    #[must_use]
    pub fn radiance(self, scene: &Scene, origin: Vec3, direction: Vec3, rng: &mut Rng) -> Vec3 {
        match self {
            Self::Traced => return trace::radiance(scene, origin, direction, rng),
            Self::Lit(lit) => return lit.radiance(scene, origin, direction, rng),
            Self::Flat | Self::Cached(_) => {}
        }
        match (self, scene.intersect(origin, direction)) {
            (Self::Cached(light), Some(s)) => cache::outgoing(scene, light, s, -direction, rng),
            (_, Some(s)) => scene.base_color(&s) * (0.5 + 0.5 * s.normal.z),
            (_, None) => scene.environment.radiance(direction),
        }
    }
}

/// A linear picture or depth image, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct Image<T> {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` values.
    pub data: Vec<T>,
}

/// How a picture is taken.
#[derive(Debug, Clone, Copy)]
pub struct Exposure {
    /// Pose (world from camera) as the shutter opens for the first row and as it closes for the last.
    pub shutter: [Pose; 2],
    /// Share of that time which the readout takes from the first row to the last: 0 for a global shutter.
    pub rolling: f32,
    /// Rays per pixel.
    pub samples: usize,
    /// Seed of this picture.
    pub seed: u64,
    /// Threads; the picture is the same for any number.
    pub threads: usize,
}

impl Exposure {
    /// A camera at rest.
    #[must_use]
    pub fn still(world_from_camera: Pose, samples: usize, threads: usize) -> Self {
        Self { shutter: [world_from_camera; 2], rolling: 0.0, samples, seed: 0, threads }
    }
}

/// Linear radiance seen by a pinhole camera, box-filtered over the pixel.
#[must_use]
pub fn color(scene: &Scene, shading: Shading, camera: &Intrinsics, exposure: &Exposure) -> Image<Vec3> {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let data = parallel::map(width * height, width, exposure.threads, |k| {
        let mut rng = Rng::new(exposure.seed, k as u64);
        let mut points = Stratified::new(&mut rng);
        let mut sum = Vec3::ZERO;
        for sample in 0..exposure.samples {
            let [x, y] = points.point();
            // Moments of the shutter are stratified by sample number, so that they fall evenly on every part of a pixel.
            let moment = (sample as f32 + rng.uniform()) / exposure.samples as f32;
            let row = exposure.rolling * (k / width) as f32 / height as f32;
            let (origin, turn) = between(&exposure.shutter, row + (1.0 - exposure.rolling) * moment);
            let pixel = [(k % width) as f32 + x - 0.5, (k / width) as f32 + y - 0.5];
            let direction = (turn * ray(camera, pixel)).normalize();
            sum += shading.radiance(scene, origin, direction, &mut rng);
        }
        sum / exposure.samples.max(1) as f32
    });
    Image { width: camera.width, height: camera.height, data }
}

/// Depth (metres along the optical axis) through the pixel centres, 0 where there is no surface.
#[must_use]
pub fn depth(scene: &Scene, camera: &Intrinsics, world_from_camera: &Pose, threads: usize) -> Image<f32> {
    let (width, height) = (camera.width as usize, camera.height as usize);
    let (origin, turn) = between(&[*world_from_camera; 2], 0.0);
    let data = parallel::map(width * height, width, threads, |k| {
        let direction = turn * ray(camera, [(k % width) as f32, (k / width) as f32]);
        scene.distance(origin, direction).unwrap_or(0.0)
    });
    Image { width: camera.width, height: camera.height, data }
}

/// Camera-frame direction with unit z through a pixel position.
#[must_use]
pub fn ray(camera: &Intrinsics, pixel: [f32; 2]) -> Vec3 {
    Vec3::new(
        ((f64::from(pixel[0]) - camera.cx) / camera.fx) as f32,
        ((f64::from(pixel[1]) - camera.cy) / camera.fy) as f32,
        1.0,
    )
}

fn between(shutter: &[Pose; 2], moment: f32) -> (Vec3, glam::Quat) {
    let [a, b] = shutter;
    let t = f64::from(moment);
    let b_rotation = if a.rotation.dot(b.rotation) < 0.0 { -b.rotation } else { b.rotation };
    let rotation: DQuat = (a.rotation * (1.0 - t) + b_rotation * t).normalize();
    (a.translation.lerp(b.translation, t).as_vec3(), rotation.as_quat())
}
