//! Diffuse light transport between the vertices of a scene, for several lights at once.
//!
//! [`Exchange::trace`] keeps where cosine-distributed rays of every vertex end. Direct light is integrated per light
//! ([`Exchange::direct`]), and bounces are sparse products over the kept hits ([`Exchange::solve`]), repeated until they
//! converge. Between vertices light is interpolated; [`Lit`] shades what a camera sees with it and traces glossy lobes.

use super::emitters::{Emitters, Portal};
use super::environment::{Environment, harmonics, luminance};
use super::material::cosine_direction;
use super::parallel;
use super::random::{Rng, Stratified};
use super::scene::{Scene, Surface};
use glam::Vec3;
use recordings::types::Mesh;
use std::collections::HashMap;
use std::f32::consts::PI;

/// What lights a scene.
#[derive(Debug, Clone, Copy)]
pub struct Light<'a> {
    /// Distant light.
    pub environment: &'a Environment,
    /// Light at finite distance.
    pub emitters: &'a Emitters,
    /// Openings of a closed room; empty where distant light comes from all around.
    pub portals: &'a [Portal],
}

/// Where a ray from a vertex met the front of a surface.
#[derive(Debug, Clone, Copy)]
struct End {
    vertices: [u32; 3],
    weights: [f32; 3],
}

/// Ends of the rays of one vertex.
#[derive(Debug, Clone, Default)]
struct Rays {
    ends: Vec<End>,
    /// What is reflected at the end, relative to irradiance / π there.
    reflectance: Vec<Vec3>,
    /// Directions of those that escaped.
    escaped: Vec<Vec3>,
}

/// Kept rays of all vertices.
#[derive(Debug)]
pub struct Exchange {
    rays: Vec<Rays>,
    /// Where the vertices' rays start.
    origins: Vec<Vec3>,
    per_vertex: usize,
    threads: usize,
}

/// Bounces end when they change the mean by less than this share.
const CONVERGED: f32 = 2e-4;
const MAX_BOUNCES: usize = 300;
/// Directions drawn towards a light, per light and vertex, relative to the rays kept.
const DRAWS_PER_RAY: f32 = 0.75;

impl Exchange {
    /// Casts `per_vertex` rays from every vertex. The lobe of glossy surfaces counts as diffuse white in the bounces.
    #[must_use]
    pub fn trace(scene: &Scene, per_vertex: usize, seed: u64, threads: usize) -> Self {
        let mesh = &scene.mesh;
        let origins = origins(mesh);
        let rays = parallel::map(mesh.positions.len(), 64, threads, |k| {
            let (position, normal) = (origins[k], mesh.normals[k]);
            let mut points = Stratified::new(&mut Rng::new(seed, k as u64));
            let mut out = Rays::default();
            for _ in 0..per_vertex {
                let direction = cosine_direction(normal, points.point());
                match scene.next(position, normal, direction) {
                    None => out.escaped.push(direction),
                    Some(surface) if surface.outside => {
                        let w_s = scene.parts[surface.part].material.w_s;
                        out.reflectance.push(scene.base_color(&surface) * (1.0 - w_s) + w_s);
                        out.ends.push(End { vertices: surface.vertices, weights: surface.weights });
                    }
                    Some(_) => {}
                }
            }
            out
        });
        Self { rays, origins, per_vertex, threads }
    }

    /// Irradiance / π at the vertices, straight from the light, by multiple importance sampling (balance heuristic) of
    /// the cosine, the environment or the portals; lights at finite distance by their own.
    #[must_use]
    pub fn direct(&self, scene: &Scene, light: &Light, seed: u64) -> Vec<Vec3> {
        let mesh = &scene.mesh;
        let draws = (self.per_vertex as f32 * DRAWS_PER_RAY) as usize;
        // Drawings per steradian of all strategies together.
        let density = |from: Vec3, normal: Vec3, direction: Vec3| {
            let far = if light.portals.is_empty() {
                light.environment.density(direction)
            } else {
                light.portals.iter().map(|p| p.density(from, direction)).sum()
            };
            self.per_vertex as f32 * normal.dot(direction).max(0.0) / PI + draws as f32 * far
        };
        parallel::map(self.rays.len(), 64, self.threads, |k| {
            let (position, normal) = (self.origins[k], mesh.normals[k]);
            let mut rng = Rng::new(seed, k as u64);
            let arriving = |direction: Vec3| {
                let cosine = normal.dot(direction).max(0.0) / PI;
                light.environment.radiance(direction) * (cosine / density(position, normal, direction).max(1e-9))
            };
            let mut sum: Vec3 = self.rays[k].escaped.iter().map(|&d| arriving(d)).sum();
            let mut towards = |direction: Vec3| {
                if normal.dot(direction) > 0.0 && scene.lit(position, normal, direction) {
                    sum += arriving(direction);
                }
            };
            let mut points = Stratified::new(&mut rng);
            if light.portals.is_empty() {
                (0..draws).for_each(|_| towards(light.environment.sample(points.point()).0));
            }
            for portal in light.portals {
                (0..draws).for_each(|_| towards(portal.draw(position, points.point())));
            }
            sum + self.near(scene, light.emitters, position, normal, draws, &mut rng)
        })
    }

    /// Irradiance / π at the vertices from lights at finite distance alone.
    #[must_use]
    pub fn direct_near(&self, scene: &Scene, emitters: &Emitters, seed: u64) -> Vec<Vec3> {
        let mesh = &scene.mesh;
        let draws = (self.per_vertex as f32 * DRAWS_PER_RAY) as usize;
        parallel::map(self.rays.len(), 64, self.threads, |k| {
            let mut rng = Rng::new(seed, k as u64);
            self.near(scene, emitters, self.origins[k], mesh.normals[k], draws, &mut rng)
        })
    }

    fn near(&self, scene: &Scene, emitters: &Emitters, at: Vec3, normal: Vec3, draws: usize, rng: &mut Rng) -> Vec3 {
        let mut sum = Vec3::ZERO;
        for light in 0..emitters.count() {
            let mut points = Stratified::new(rng);
            for _ in 0..draws {
                let Some(drawn) = emitters.draw(light, at, points.point()) else { continue };
                let cosine = normal.dot(drawn.direction);
                if cosine > 0.0 && scene.reached(at, normal, drawn.direction, drawn.distance) {
                    sum += drawn.weight * (cosine / (PI * draws as f32));
                }
            }
        }
        sum
    }

    /// Where rays from the vertices start.
    #[must_use]
    pub fn origins(&self) -> &[Vec3] {
        &self.origins
    }

    /// Transfer of distant light without bounces, `[vertex][(order + 1)²]`, 1/π inside, from the kept rays.
    #[must_use]
    pub fn transfer(&self, order: usize) -> Vec<Vec<f64>> {
        parallel::map(self.rays.len(), 64, self.threads, |k| {
            let mut sum = vec![0.0; (order + 1) * (order + 1)];
            for direction in &self.rays[k].escaped {
                sum.iter_mut().zip(harmonics(order, *direction)).for_each(|(s, y)| *s += y / self.per_vertex as f64);
            }
            sum
        })
    }

    /// Irradiance / π with all bounces, where surfaces reflect as the scene says.
    #[must_use]
    pub fn solve(&self, direct: &[Vec3]) -> Vec<Vec3> {
        self.converge(direct, |_, x| x, |rays, k| rays.reflectance[k])
    }

    /// Irradiance / π with all bounces, where surfaces reflect by `albedo`, given at the vertices.
    #[must_use]
    pub fn solve_with(&self, direct: &[Vec3], albedo: &[Vec3]) -> Vec<Vec3> {
        self.converge(direct, |i, x| albedo[i] * x, |_, _| Vec3::ONE)
    }

    /// x ← direct + mean over the rays of `reflectance` · (`emitted`(x) interpolated at their ends).
    fn converge(
        &self,
        direct: &[Vec3],
        emitted: impl Fn(usize, Vec3) -> Vec3 + Sync,
        reflectance: impl Fn(&Rays, usize) -> Vec3 + Sync,
    ) -> Vec<Vec3> {
        let mut light = direct.to_vec();
        for _ in 0..MAX_BOUNCES {
            let out: Vec<Vec3> = light.iter().enumerate().map(|(i, &x)| emitted(i, x)).collect();
            let next = parallel::map(light.len(), 256, self.threads, |i| {
                let rays = &self.rays[i];
                let gathered: Vec3 = rays
                    .ends
                    .iter()
                    .enumerate()
                    .map(|(k, end)| {
                        let at: Vec3 = end.vertices.iter().zip(end.weights).map(|(&v, w)| out[v as usize] * w).sum();
                        at * reflectance(rays, k)
                    })
                    .sum();
                direct[i] + gathered / self.per_vertex as f32
            });
            let change: f32 = light.iter().zip(&next).map(|(a, b)| luminance((*b - *a).abs())).sum();
            let size: f32 = next.iter().map(|x| luminance(*x)).sum();
            light = next;
            if change <= CONVERGED * size {
                break;
            }
        }
        light
    }
}

/// The vertices, but those on open borders a little inwards: where two sheets meet, rays would slip through the seam.
fn origins(mesh: &Mesh) -> Vec<Vec3> {
    const INWARDS: f32 = 0.08;
    let mut sides: HashMap<(u32, u32), u32> = HashMap::new();
    let mut inwards = vec![(Vec3::ZERO, 0.0f32); mesh.positions.len()];
    for t in &mesh.triangles {
        let middle = t.iter().map(|&i| mesh.positions[i as usize]).sum::<Vec3>() / 3.0;
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            *sides.entry((a.min(b), a.max(b))).or_default() += 1;
            let (sum, count) = &mut inwards[a as usize];
            *sum += middle - mesh.positions[a as usize];
            *count += 1.0;
        }
    }
    let mut out = mesh.positions.clone();
    for (&(a, b), _) in sides.iter().filter(|(_, count)| **count == 1) {
        for i in [a as usize, b as usize] {
            out[i] = mesh.positions[i] + inwards[i].0 * (INWARDS / inwards[i].1);
        }
    }
    out
}

/// A scene under a light that is known at its vertices.
#[derive(Debug)]
pub struct Lit<'a> {
    /// The light.
    pub light: Light<'a>,
    /// Irradiance / π at the vertices, all bounces.
    pub arriving: &'a [Vec3],
    /// False: the surfaces that emit are off.
    pub emission: bool,
}

/// Rays of the glossy lobe per unit of its weight, for every camera ray.
const LOBE_RAYS: f32 = 24.0;

impl Lit<'_> {
    /// Radiance that arrives at `origin` from where the unit `direction` points.
    #[must_use]
    pub fn radiance(&self, scene: &Scene, origin: Vec3, direction: Vec3, rng: &mut Rng) -> Vec3 {
        let surface = scene.intersect(origin, direction);
        let limit = surface.as_ref().map_or(f32::INFINITY, |s| s.distance);
        match (self.light.emitters.along(origin, direction), surface) {
            (Some((distance, radiance)), _) if distance < limit => radiance,
            (_, Some(surface)) => self.outgoing(scene, &surface, -direction, rng),
            (_, None) => self.light.environment.radiance(direction),
        }
    }

    fn outgoing(&self, scene: &Scene, surface: &Surface, towards: Vec3, rng: &mut Rng) -> Vec3 {
        let own = if self.emission { scene.emitted(surface) } else { Vec3::ZERO };
        let w_s = scene.parts[surface.part].material.w_s;
        let diffuse = self.diffuse(scene, surface);
        if w_s == 0.0 || !surface.outside {
            return own + diffuse;
        }
        let rays = (LOBE_RAYS * w_s).ceil();
        let gloss: Vec3 = (0..rays as usize).map(|_| self.mirrored(scene, surface, towards, rng)).sum();
        own + diffuse + gloss / rays
    }

    /// Within a solid it is dark.
    fn diffuse(&self, scene: &Scene, surface: &Surface) -> Vec3 {
        if !surface.outside {
            return Vec3::ZERO;
        }
        let at: Vec3 = surface.vertices.iter().zip(surface.weights).map(|(&i, w)| self.arriving[i as usize] * w).sum();
        scene.base_color(surface) * at * (1.0 - scene.parts[surface.part].material.w_s)
    }

    /// The glossy lobe: one ray by its visible normals, one towards the environment, one towards every lamp.
    fn mirrored(&self, scene: &Scene, surface: &Surface, towards: Vec3, rng: &mut Rng) -> Vec3 {
        let material = scene.parts[surface.part].material;
        let environment = self.light.environment;
        // `base` zero leaves the lobe alone.
        let lobe = |direction: Vec3| material.evaluate_lobe(surface.normal, towards, direction);
        let mut sum = Vec3::ZERO;
        let (direction, weight) = material.sample_lobe(surface.normal, towards, [rng.uniform(), rng.uniform()]);
        if surface.facet.dot(direction) > 0.0 {
            sum += material.w_s
                * weight
                * match scene.next(surface.position, surface.facet, direction) {
                    Some(next) => self.diffuse(scene, &next),
                    None if self.light.portals.is_empty() => {
                        let (own, other) = (lobe(direction).1, environment.density(direction));
                        environment.radiance(direction) * (own / (own + other).max(1e-9))
                    }
                    None => environment.radiance(direction),
                };
        }
        if self.light.portals.is_empty() {
            let (direction, density) = environment.sample([rng.uniform(), rng.uniform()]);
            let (reflected, own) = lobe(direction);
            if reflected > 0.0 && scene.lit(surface.position, surface.facet, direction) {
                sum += environment.radiance(direction) * (reflected / (own + density));
            }
        }
        for light in 0..self.light.emitters.count() {
            let u = [rng.uniform(), rng.uniform()];
            let Some(drawn) = self.light.emitters.draw(light, surface.position, u) else { continue };
            let (reflected, _) = lobe(drawn.direction);
            if reflected > 0.0 && scene.reached(surface.position, surface.facet, drawn.direction, drawn.distance) {
                sum += drawn.weight * reflected;
            }
        }
        sum
    }
}
