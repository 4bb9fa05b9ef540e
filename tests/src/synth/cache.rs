//! The diffuse light of a scene at rest, traced once and looked up in every frame: a surface's diffuse radiance is its
//! albedo times this, from wherever it is seen.

use super::material::cosine_direction;
use super::parallel;
use super::random::{Rng, Stratified};
use super::scene::{Scene, Surface};
use super::trace::{self, arriving, heuristic};
use glam::Vec3;
use std::f32::consts::PI;

/// Irradiance / π at every vertex, all bounces: the radiance that a white Lambertian patch there would show.
///
/// A first pass traces whole paths; a second one gathers again with many more samples, and takes the diffuse light where
/// its rays end from the first, whose noise averages out over the gather.
#[must_use]
pub fn diffuse_light(scene: &Scene, samples: usize, seed: u64, threads: usize) -> Vec<Vec3> {
    let (positions, normals) = (&scene.mesh.positions, &scene.mesh.normals);
    let first = integrate(scene, positions, normals, samples.div_ceil(12), seed, threads, trace::outgoing);
    gathered_light(scene, &first, positions, normals, samples, seed ^ 1, threads)
}

/// The same at any points with unit normals, from a table `light` for the scene's vertices.
#[must_use]
pub fn gathered_light(
    scene: &Scene,
    light: &[Vec3],
    positions: &[Vec3],
    normals: &[Vec3],
    samples: usize,
    seed: u64,
    threads: usize,
) -> Vec<Vec3> {
    let far = |scene: &Scene, surface: Surface, towards: Vec3, rng: &mut Rng| {
        let gloss = mirrored(scene, light, surface, towards, rng);
        diffuse_part(scene, light, &surface) + gloss
    };
    integrate(scene, positions, normals, samples, seed, threads, far)
}

/// Irradiance / π by sampling the environment and the cosine, weighted against each other; `far` is the radiance of the
/// surfaces that are met.
fn integrate(
    scene: &Scene,
    positions: &[Vec3],
    normals: &[Vec3],
    samples: usize,
    seed: u64,
    threads: usize,
    far: impl Fn(&Scene, Surface, Vec3, &mut Rng) -> Vec3 + Sync,
) -> Vec<Vec3> {
    parallel::map(positions.len().min(normals.len()), 64, threads, |k| {
        let (position, normal) = (positions[k], normals[k]);
        let mut rng = Rng::new(seed, k as u64);
        let (mut of_light, mut of_cosine) = (Stratified::new(&mut rng), Stratified::new(&mut rng));
        let mut sum = Vec3::ZERO;
        for _ in 0..samples {
            let (direction, density) = scene.environment.sample(of_light.point());
            let own = normal.dot(direction) / PI;
            if own > 0.0 && scene.lit(position, normal, direction) {
                sum += scene.environment.radiance(direction) * (own / density * heuristic(density, own));
            }
            let direction = cosine_direction(normal, of_cosine.point());
            let own = normal.dot(direction).max(0.0) / PI;
            sum += match scene.next(position, normal, direction) {
                None => arriving(&scene.environment, direction, own),
                Some(surface) => far(scene, surface, -direction, &mut rng),
            };
        }
        sum / samples.max(1) as f32
    })
}

/// Radiance that leaves a surface point towards the unit direction `towards`, its diffuse part from the table; several
/// rays where the glossy lobe has much weight.
#[must_use]
pub fn outgoing(scene: &Scene, light: &[Vec3], surface: Surface, towards: Vec3, rng: &mut Rng) -> Vec3 {
    let diffuse = diffuse_part(scene, light, &surface);
    let rays = (32.0 * scene.parts[surface.part].material.w_s).ceil() as usize;
    let gloss: Vec3 = (0..rays).map(|_| mirrored(scene, light, surface, towards, rng)).sum();
    diffuse + gloss / rays.max(1) as f32
}

/// The table holds the light on the outside; within a solid it is dark.
fn diffuse_part(scene: &Scene, light: &[Vec3], surface: &Surface) -> Vec3 {
    if !surface.outside {
        return Vec3::ZERO;
    }
    let arriving: Vec3 = surface.vertices.iter().zip(surface.weights).map(|(&i, w)| light[i as usize] * w).sum();
    scene.base_color(surface) * arriving * (1.0 - scene.parts[surface.part].material.w_s)
}

/// One path through glossy lobes only; what it meets adds its diffuse light.
fn mirrored(scene: &Scene, light: &[Vec3], surface: Surface, towards: Vec3, rng: &mut Rng) -> Vec3 {
    const MIRRORINGS: usize = 6;
    let (mut surface, mut towards) = (surface, towards);
    let (mut sum, mut throughput) = (Vec3::ZERO, 1.0);
    for _ in 0..MIRRORINGS {
        let material = scene.parts[surface.part].material;
        if material.w_s == 0.0 || !surface.outside {
            break;
        }
        let (direction, weight) = material.sample_lobe(surface.normal, towards, [rng.uniform(), rng.uniform()]);
        throughput *= material.w_s * weight;
        if throughput == 0.0 || surface.facet.dot(direction) <= 0.0 {
            break;
        }
        match scene.next(surface.position, surface.facet, direction) {
            Some(next) => {
                sum += diffuse_part(scene, light, &next) * throughput;
                (surface, towards) = (next, -direction);
            }
            None => {
                sum += scene.environment.radiance(direction) * throughput;
                break;
            }
        }
    }
    sum
}
