//! The depth camera: triangulation against a projector beside it, as the Kinect V1 does it.

use super::environment::luminance;
use super::parallel;
use super::random::Rng;
use super::render::{Image, ray};
use super::scene::{Scene, Surface};
use glam::Vec3;
use recordings::types::{DepthFrame, Intrinsics, Pose, TimestampNs};

/// A structured-light depth camera. Depth is registered to the colour camera, and both are taken to stand in one place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthSensor {
    /// Focal length of the infrared camera in pixels; with the baseline it turns depth into disparity f·b/z.
    pub focal_px: f64,
    /// Distance of the projector, to the right of the camera, in metres.
    pub baseline_m: f64,
    /// Steps of disparity per pixel.
    pub steps_per_px: f64,
    /// Standard deviation of the sideways error of a reading, in pixels.
    pub lateral_px: f32,
    /// Nearest and furthest depth, in metres.
    pub range_m: [f64; 2],
    /// Cosine of incidence below which nothing comes back.
    pub grazing_cosine: f32,
    /// Brightness (albedo · cosine) below which nothing comes back.
    pub darkest: f32,
    /// Glossy reflection of the projector, relative to the diffuse one, above which the pattern is washed out.
    pub brightest_gloss: f32,
    /// Metres per depth unit.
    pub unit_m: f64,
}

impl Default for DepthSensor {
    fn default() -> Self {
        Self {
            focal_px: 580.0,
            baseline_m: 0.075,
            steps_per_px: 8.0,
            lateral_px: 0.5,
            range_m: [0.45, 4.0],
            grazing_cosine: 0.17,
            darkest: 0.012,
            brightest_gloss: 12.0,
            unit_m: 0.001,
        }
    }
}

impl DepthSensor {
    /// Standard deviation of a depth reading in metres (Nguyen, Izadi, Lovell 2012), quantisation included.
    #[must_use]
    pub fn deviation_m(z: f64) -> f64 {
        0.0012 + 0.0019 * (z - 0.4) * (z - 0.4)
    }

    /// One reading: true depth to depth units, with a standard normal error; 0 out of range.
    #[must_use]
    pub fn read(&self, z: f64, error: f64) -> u16 {
        let disparity = self.focal_px * self.baseline_m / z;
        let spread = Self::deviation_m(z) * disparity / z;
        let rounding = 1.0 / (12.0 * self.steps_per_px * self.steps_per_px);
        let noisy = disparity + (spread * spread - rounding).max(0.0).sqrt() * error;
        let quantised = (noisy * self.steps_per_px).round() / self.steps_per_px;
        let depth = self.focal_px * self.baseline_m / quantised;
        let in_range = quantised > 0.0 && depth >= self.range_m[0] && depth <= self.range_m[1];
        if in_range { (depth / self.unit_m).round().min(65535.0) as u16 } else { 0 }
    }

    /// What the sensor delivers of a scene.
    #[must_use]
    pub fn frame(
        &self,
        scene: &Scene,
        camera: &Intrinsics,
        world_from_camera: &Pose,
        timestamp_ns: TimestampNs,
        seed: u64,
        threads: usize,
    ) -> DepthFrame {
        let (width, height) = (camera.width as usize, camera.height as usize);
        let [error, dx, dy, ragged] = std::array::from_fn(|k| patches(width, height, seed, k as u64));
        let origin = world_from_camera.translation.as_vec3();
        let turn = world_from_camera.rotation.as_quat();
        let projector = origin + turn * Vec3::X * self.baseline_m as f32;
        let depth = parallel::map(width * height, width, threads, |k| {
            let pixel =
                [(k % width) as f32 + self.lateral_px * dx.data[k], (k / width) as f32 + self.lateral_px * dy.data[k]];
            let direction = turn * ray(camera, pixel);
            let length = direction.length();
            let Some(surface) = scene.intersect(origin, direction / length) else { return 0 };
            if !self.answers(scene, &surface, origin, projector, ragged.data[k]) {
                return 0;
            }
            self.read(f64::from(surface.distance / length), f64::from(error.data[k]))
        });
        DepthFrame { timestamp_ns, width: camera.width, height: camera.height, depth, missing_packets: 0 }
    }

    /// True if the pattern can be read off a surface point; `ragged` (standard normal) frays the borders.
    fn answers(&self, scene: &Scene, surface: &Surface, origin: Vec3, projector: Vec3, ragged: f32) -> bool {
        let view = (origin - surface.position).normalize();
        let beam = (projector - surface.position).normalize();
        let (cos_view, cos_beam) = (surface.normal.dot(view), surface.normal.dot(beam));
        if cos_view.min(cos_beam) < self.grazing_cosine + 0.03 * ragged {
            return false;
        }
        let material = scene.parts[surface.part].material;
        let base = scene.base_color(surface);
        let diffuse = luminance(base) * (1.0 - material.w_s) * cos_beam;
        if diffuse < self.darkest * (1.0 + 0.3 * ragged) {
            return false;
        }
        let (all, _) = material.evaluate(base, surface.normal, view, beam);
        let gloss = luminance(all) * std::f32::consts::PI / diffuse - 1.0;
        gloss < self.brightest_gloss * (1.0 + 0.3 * ragged)
            && !scene.blocked(surface.position, surface.facet, projector)
    }
}

/// Standard normal noise that is alike over about three pixels, as a block matcher's is.
fn patches(width: usize, height: usize, seed: u64, layer: u64) -> Image<f32> {
    const KERNEL: [f32; 5] = [1.0, 2.0, 3.0, 2.0, 1.0];
    const NORM: f32 = 1.0 / 19.0;
    let white: Vec<f32> = (0..width * height).map(|k| Rng::new(seed ^ (layer + 1) << 40, k as u64).normal()).collect();
    let pass = |data: &[f32], across: bool| -> Vec<f32> {
        let (length, stride) = if across { (width, 1) } else { (height, width) };
        let taps = |k: usize| {
            let at = if across { k % width } else { k / width };
            // Periodic borders keep the variance the same everywhere.
            let tap = |i: usize| data[k - at * stride + ((at + i + length - 2) % length) * stride];
            (0..5).map(|i| KERNEL[i] * tap(i)).sum::<f32>()
        };
        (0..data.len()).map(taps).collect()
    };
    let mut data = pass(&pass(&white, true), false);
    data.iter_mut().for_each(|x| *x *= NORM);
    Image { width: width as u32, height: height as u32, data }
}
