//! Veiling glare: light from in and around the picture that the lens scatters over all of it.

use super::random::Rng;
use super::render::{Image, Shading, ray};
use super::scene::Scene;
use glam::Vec3;
use recordings::types::{Intrinsics, Pose};

/// A lens that scatters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Glare {
    /// Share of the light that is scattered.
    pub share: f32,
    /// Angle beyond which the scattered light falls off as its inverse square, radians.
    pub core_rad: f32,
}

/// The surroundings that are looked at: pixels, and how much wider than the picture.
const WIDE: [usize; 2] = [72, 54];
const WIDER: f64 = 2.6;
/// Points of the picture where the veil is computed; it is smooth between.
const GRID: [usize; 2] = [17, 13];
/// Rays per pixel of the surroundings.
const SAMPLES: usize = 2;

impl Glare {
    /// Adds the veil to a linear picture, which loses as much as it scatters.
    pub fn add(
        &self,
        picture: &mut Image<Vec3>,
        scene: &Scene,
        shading: Shading,
        camera: &Intrinsics,
        world_from_camera: &Pose,
        seed: u64,
    ) {
        let origin = world_from_camera.translation.as_vec3();
        let turn = world_from_camera.rotation.as_quat();
        let at =
            |x: f64, y: f64| ray(camera, [(x * f64::from(camera.width)) as f32, (y * f64::from(camera.height)) as f32]);
        // Directions in the camera's frame, and radiance times solid angle.
        let mut rng = Rng::new(seed, 0);
        let mut around = Vec::with_capacity(WIDE[0] * WIDE[1]);
        for k in 0..WIDE[0] * WIDE[1] {
            let mut sum = Vec3::ZERO;
            let mut middle = Vec3::Z;
            for _ in 0..SAMPLES {
                let [x, y] = [(k % WIDE[0], WIDE[0]), (k / WIDE[0], WIDE[1])]
                    .map(|(i, n)| 0.5 + WIDER * ((i as f64 + f64::from(rng.uniform())) / n as f64 - 0.5));
                middle = at(x, y);
                sum += shading.radiance(scene, origin, (turn * middle).normalize(), &mut rng);
            }
            let cosine = 1.0 / middle.length();
            around.push((middle * cosine, sum * (cosine * cosine * cosine / SAMPLES as f32)));
        }
        let core = self.core_rad * self.core_rad;
        // 2 (1 − cos) is the squared angle, nearly.
        let weight = |a: Vec3, b: Vec3| 1.0 / (2.0 * (1.0 - a.dot(b)).max(0.0) + core);
        let forward = Vec3::Z;
        let total: f32 = around.iter().map(|(d, _)| weight(forward, *d) * d.z * d.z * d.z).sum();
        let veil: Vec<Vec3> = (0..GRID[0] * GRID[1])
            .map(|k| {
                let [x, y] = [(k % GRID[0], GRID[0]), (k / GRID[0], GRID[1])].map(|(i, n)| i as f64 / (n - 1) as f64);
                let d = at(x, y).normalize();
                around.iter().map(|(a, light)| *light * weight(d, *a)).sum::<Vec3>() / total
            })
            .collect();
        let [width, height] = [picture.width as usize, picture.height as usize];
        for (k, value) in picture.data.iter_mut().enumerate() {
            let x = (k % width) as f32 / width as f32 * (GRID[0] - 1) as f32;
            let y = (k / width) as f32 / height as f32 * (GRID[1] - 1) as f32;
            let (i, j) = (x as usize, y as usize);
            let (fx, fy) = (x - i as f32, y - j as f32);
            let row = |j: usize| veil[j * GRID[0] + i].lerp(veil[j * GRID[0] + i + 1], fx);
            *value = *value * (1.0 - self.share) + row(j).lerp(row(j + 1), fy) * self.share;
        }
    }
}
