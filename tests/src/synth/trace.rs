//! The path tracer: many bounces, next-event estimation towards the environment (with multiple importance sampling) and
//! towards lights at finite distance, Russian roulette.

use super::environment::Environment;
use super::random::Rng;
use super::scene::{Scene, Surface};
use glam::Vec3;

/// No path is longer, whatever the roulette says.
const MAX_BOUNCES: usize = 48;
/// Bounces before the roulette starts.
const SURE_BOUNCES: usize = 3;

/// Radiance that arrives at `origin` from where the unit `direction` points.
#[must_use]
pub fn radiance(scene: &Scene, origin: Vec3, direction: Vec3, rng: &mut Rng) -> Vec3 {
    let surface = scene.intersect(origin, direction);
    let limit = surface.as_ref().map_or(f32::INFINITY, |s| s.distance);
    match (scene.emitters.along(origin, direction), surface) {
        (Some((distance, radiance)), _) if distance < limit => radiance,
        (_, Some(surface)) => scene.emitted(&surface) + outgoing(scene, surface, -direction, rng),
        (_, None) => scene.environment.radiance(direction),
    }
}

/// Radiance that a surface point reflects towards the unit direction `towards`.
#[must_use]
pub fn outgoing(scene: &Scene, surface: Surface, towards: Vec3, rng: &mut Rng) -> Vec3 {
    let (mut surface, mut towards) = (surface, towards);
    let (mut sum, mut throughput) = (Vec3::ZERO, Vec3::ONE);
    for bounce in 0..MAX_BOUNCES {
        let (material, base) = (scene.parts[surface.part].material, scene.base_color(&surface));
        let (direction, density) = scene.environment.sample([rng.uniform(), rng.uniform()]);
        let (reflected, own) = material.evaluate(base, surface.normal, towards, direction);
        if reflected != Vec3::ZERO && scene.lit(surface.position, surface.facet, direction) {
            sum += throughput * reflected * scene.environment.radiance(direction) * (heuristic(density, own) / density);
        }
        for light in 0..scene.emitters.count() {
            let u = [rng.uniform(), rng.uniform()];
            let Some(drawn) = scene.emitters.draw(light, surface.position, u) else { continue };
            let (reflected, _) = material.evaluate(base, surface.normal, towards, drawn.direction);
            if reflected != Vec3::ZERO
                && scene.reached(surface.position, surface.facet, drawn.direction, drawn.distance)
            {
                sum += throughput * reflected * drawn.weight;
            }
        }
        let u = [rng.uniform(), rng.uniform()];
        let direction = material.sample(surface.normal, towards, u, rng.uniform());
        let (reflected, own) = material.evaluate(base, surface.normal, towards, direction);
        if own <= 0.0 || surface.facet.dot(direction) <= 0.0 {
            break;
        }
        throughput *= reflected / own;
        match scene.next(surface.position, surface.facet, direction) {
            None => {
                sum += throughput * arriving(&scene.environment, direction, own);
                break;
            }
            Some(next) => surface = next,
        }
        towards = -direction;
        if bounce + 1 >= SURE_BOUNCES {
            let survive = throughput.max_element().min(0.95);
            if rng.uniform() >= survive {
                break;
            }
            throughput /= survive;
        }
    }
    sum
}

/// Environment radiance met by a direction that the BSDF drew with density `own`, weighted against next-event estimation.
pub(super) fn arriving(environment: &Environment, direction: Vec3, own: f32) -> Vec3 {
    environment.radiance(direction) * heuristic(own, environment.density(direction))
}

/// Veach's power heuristic.
pub(super) fn heuristic(a: f32, b: f32) -> f32 {
    a * a / (a * a + b * b)
}
