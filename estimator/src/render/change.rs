//! From a result to a world with something inserted and something removed, lit on both sides.

use crate::mesh::graph::Graph;
use crate::numerics::random::hash;
use crate::render::before_after_scene::{Ball, Body, Side, World};
use crate::render::inpainting::geometry::Cut;
use crate::render::inpainting::texture::carry_on;
use crate::render::lighting::environment::Environment;
use crate::render::lighting::observed_background::Backdrop;
use crate::render::objects::material::Material;
use crate::render::objects::object::Object;
use crate::render::removal::inpaint;
use firmware_config::RealityConfig;
use glam::Vec3;
use rayon::prelude::*;
use recordings::result::Estimate;

/// GGX width of a recovered glossy surface, whose roughness Eq. (13) does not tell.
const GLOSS_ALPHA: f32 = 0.2;
/// Share of irradiance below which a change is not followed: an eighth of a level in a bright 8-bit picture.
pub const SMALLEST_REACH: f32 = 1e-3;
/// Share of irradiance from which on a change is followed with all rays; the error of a smaller one shrinks with it.
const FULL_REACH: f32 = 0.1;
/// No fewer rays than this share.
const FEWEST_RAYS: f32 = 0.4;
/// A surface that gets less than this share of the light it would get in the open is not asked for its colour.
const DARK: f32 = 0.1;
/// Rounds of averaging over neighbours of the level between albedo × light and what was seen.
const LEVEL_SWEEPS: usize = 8;
/// Things inserted keep their light per vertex: edges longer than this many edges of the scene are split.
const LONGEST_EDGE: f32 = 3.0;
/// Triangles up to which they are split.
const MOST_TRIANGLES: usize = 60_000;

/// A world with a change, and what is known of each of its kept vertices.
#[derive(Debug)]
pub struct Changed {
    /// Both sides.
    pub world: World,
    /// Irradiance over π before the change; zero where the change does not reach.
    pub irradiance: Vec<Vec3>,
    /// Diffuse albedo in the units of this light: radiance = reflectance · irradiance.
    pub reflectance: Vec<Vec3>,
    /// True where `irradiance` and `after / radiance` are known.
    pub reached: Vec<bool>,
    /// True where `reflectance` stands in for what no keyframe saw.
    pub filled: Vec<bool>,
    /// What is behind the scan.
    pub backdrop: Backdrop,
}

impl Changed {
    /// Radiance from beyond the scan: what keyframes saw there, otherwise the light.
    #[must_use]
    pub fn beyond(&self, direction: Vec3) -> Vec3 {
        let world = &self.world;
        let blocks = |o: Vec3, d: Vec3| {
            world.kept.bvh.occluded(o, d) || world.removed.as_ref().is_some_and(|b| b.bvh.occluded(o, d))
        };
        self.backdrop.radiance(direction, blocks).unwrap_or_else(|| world.environment.radiance(direction))
    }
}

/// The reconstructed surface as an object: albedo per vertex, a material per segment.
#[must_use]
pub fn scanned(estimate: &Estimate) -> Object {
    let material = |s: &recordings::result::Segment| Material {
        mirror: s.w_s.clamp(0.0, 1.0) as f32,
        roughness: GLOSS_ALPHA.sqrt(),
        ..Material::default()
    };
    Object {
        mesh: estimate.mesh.clone(),
        color: estimate.albedo.clone(),
        uv: Vec::new(),
        material: estimate.mesh.triangles.iter().map(|t| estimate.segment[t[0] as usize]).collect(),
        materials: estimate.segments.iter().map(material).collect(),
    }
}

/// Lights a world (its light, what is behind it) of what a `cut` of the result leaves, and in which `inserted` stands.
#[must_use]
pub fn change(
    estimate: &Estimate,
    (environment, backdrop): (Environment, Backdrop),
    cut: Cut,
    inserted: &[Object],
    config: &RealityConfig,
) -> Changed {
    let whole = scanned(estimate);
    let Cut { kept, first_patch, removed, removed_from } = cut;
    let graph = Graph::of(&kept);

    let mut radiance = estimate.lit_color.clone();
    radiance.resize(kept.positions.len(), Vec3::ZERO);
    let seen: Vec<bool> = radiance.iter().map(|f| f.is_finite() && f.max_element() > 0.0).collect();
    inpaint(&mut radiance, &seen, &graph);

    let mut object = Object { mesh: kept, ..whole.clone() };
    object.color.resize(object.mesh.positions.len(), Vec3::splat(0.5));
    object.material = object
        .mesh
        .triangles
        .iter()
        .map(|t| t.iter().filter_map(|&i| estimate.segment.get(i as usize)).next().map_or(0, |s| *s))
        .collect();
    let mut changes: Vec<Ball> = Vec::new();
    let removed = (!removed.triangles.is_empty()).then(|| {
        let light: Vec<Vec3> = removed_from.iter().map(|&i| radiance[i as usize]).collect();
        changes.extend(pieces(&removed));
        let color = removed_from.iter().map(|&i| estimate.albedo[i as usize]).collect();
        Body::new(Object { mesh: removed, color, ..Object::default() }, light)
    });
    let kept = Body::new(object, radiance);
    let mut all = Object::default();
    for object in inserted {
        let mut object = object.clone();
        object.subdivide(LONGEST_EDGE * kept.bvh.median_edge(), MOST_TRIANGLES);
        changes.extend(Ball::around(object.mesh.positions.iter().copied()));
        all.append(&object);
    }
    let inserted = (!all.mesh.triangles.is_empty()).then(|| {
        let dark = vec![Vec3::ZERO; all.mesh.positions.len()];
        Body::new(all, dark)
    });
    let world = World { kept, removed, inserted, changes, environment };
    Changed { backdrop, ..light(world, &seen, first_patch, &graph, config) }
}

/// A ball around every connected piece: a cone towards each wastes no ray on what is between them.
fn pieces(mesh: &recordings::types::Mesh) -> Vec<Ball> {
    let graph = Graph::of(mesh);
    let mut done = vec![false; mesh.positions.len()];
    let mut members: Vec<Vec<usize>> = Vec::new();
    for start in 0..done.len() {
        if !done[start] {
            members.push(graph.component(start, &mut done));
        }
    }
    let ball = |list: &[usize]| Ball::around(list.iter().map(|&v| mesh.positions[v]));
    if members.len() > 8 {
        Ball::around(mesh.positions.iter().copied()).into_iter().collect()
    } else {
        members.iter().filter_map(|l| ball(l)).collect()
    }
}

/// Fills in what light does on both sides.
fn light(mut world: World, seen: &[bool], first_patch: usize, graph: &Graph, config: &RealityConfig) -> Changed {
    let n = world.kept.object.mesh.positions.len();
    let seed = config.seed;
    let used = {
        let mut used = vec![false; n];
        world.kept.object.mesh.triangles.iter().flatten().for_each(|&i| used[i as usize] = true);
        used
    };
    let reach: Vec<f32> =
        (0..n).into_par_iter().map(|v| if used[v] { world.reach(&world.kept.vertex_spot(v)) } else { 0.0 }).collect();
    let reached: Vec<bool> = reach.iter().map(|r| *r > SMALLEST_REACH).collect();
    let irradiance: Vec<Vec3> = (0..n)
        .into_par_iter()
        .map(|v| {
            if !reached[v] {
                return Vec3::ZERO;
            }
            let rays = rays(reach[v], config.vertex_rays);
            world.gather(&world.kept.vertex_spot(v), Side::Before, rays, 0, hash(v as u32, seed))
        })
        .collect();
    let open = irradiance.iter().fold(Vec3::ZERO, |m, e| m.max(*e)).max_element();

    // Colour is asked only where it was seen in enough light, and not where the removed thing touches.
    let removed = world.removed.is_some();
    let near = near_removed(&world, config.contact_edges as f32 * world.kept.bvh.median_edge());
    let known: Vec<bool> = (0..n)
        .map(|v| v < first_patch && seen[v] && (!reached[v] || (irradiance[v].min_element() > DARK * open && !near[v])))
        .collect();
    let asked: Vec<bool> = (0..n).map(|v| known[v] && reached[v]).collect();
    // Reflectance is albedo, texture continued, times a level that varies slowly and so is told by many vertices.
    let mut albedo = world.kept.object.color.clone();
    if removed {
        carry_on(&mut albedo, &known, &world.kept.object.mesh, graph, world.kept.bvh.median_edge());
    }
    let mut level: Vec<Vec3> = (0..n)
        .map(|v| {
            let expected = (albedo[v] * irradiance[v]).max(Vec3::splat(1e-12));
            let level = world.kept.radiance[v] / expected;
            if asked[v] { level.clamp(Vec3::splat(0.2), Vec3::splat(5.0)) } else { Vec3::ONE }
        })
        .collect();
    smooth(&mut level, &asked, graph);
    inpaint(&mut level, &asked, graph);
    let reflectance: Vec<Vec3> = albedo.iter().zip(&level).map(|(a, l)| *a * *l).collect();
    let filled: Vec<bool> = (0..n).map(|v| reached[v] && !known[v]).collect();

    light_inserted(&mut world, config, 1);
    let after: Vec<Vec3> = (0..n)
        .into_par_iter()
        .map(|v| {
            let spot = world.kept.vertex_spot(v);
            if !reached[v] {
                world.kept.radiance[v]
            } else if filled[v] {
                reflectance[v]
                    * world.gather(&spot, Side::After, config.vertex_rays, 0, hash(v as u32, seed)).max(Vec3::ZERO)
            } else {
                let change = world.change(&spot, rays(reach[v], config.change_rays), hash(v as u32, seed ^ 0x51ed));
                world.kept.radiance[v] * ratio(irradiance[v], change)
            }
        })
        .collect();
    world.kept.after = after;
    light_inserted(&mut world, config, 2);
    Changed { world, irradiance, reflectance, reached, filled, backdrop: Backdrop::default() }
}

/// How many of `most` rays tell a change of this reach as exactly as `most` tell a large one.
#[must_use]
pub fn rays(reach: f32, most: u32) -> u32 {
    let share = reach / FULL_REACH;
    // Whole fours: rays take turns in how they are drawn.
    ((most as f32 * (share * share).clamp(FEWEST_RAYS, 1.0)) as u32).next_multiple_of(4)
}

/// Averages `values` over neighbours that are `known`, again and again.
fn smooth(values: &mut [Vec3], known: &[bool], graph: &Graph) {
    for _ in 0..LEVEL_SWEEPS {
        let mean = |v: usize| {
            let around = graph.neighbours(v).iter().map(|&i| i as usize).filter(|&i| known[i]);
            let (sum, count) = around.fold((values[v], 1.0), |(s, c), i| (s + values[i], c + 1.0));
            if known[v] { sum / count } else { values[v] }
        };
        let next: Vec<Vec3> = (0..values.len()).into_par_iter().map(mean).collect();
        values.copy_from_slice(&next);
    }
}

/// (E + ΔE) / E per channel.
#[must_use]
pub fn ratio(irradiance: Vec3, change: Vec3) -> Vec3 {
    ((irradiance + change) / irradiance.max(Vec3::splat(1e-12))).clamp(Vec3::ZERO, Vec3::splat(20.0))
}

/// Kept vertices within `distance` of something removed.
fn near_removed(world: &World, distance: f32) -> Vec<bool> {
    let positions = &world.kept.object.mesh.positions;
    let Some(removed) = &world.removed else {
        return vec![false; positions.len()];
    };
    let cell = |p: Vec3| (p / distance.max(f32::MIN_POSITIVE)).floor().as_ivec3().to_array();
    let mut grid: std::collections::BTreeMap<[i32; 3], Vec<Vec3>> = std::collections::BTreeMap::new();
    for p in &removed.object.mesh.positions {
        grid.entry(cell(*p)).or_default().push(*p);
    }
    positions
        .par_iter()
        .map(|p| {
            let [x, y, z] = cell(*p);
            (0..27).any(|i| {
                let key = [x + i % 3 - 1, y + i / 3 % 3 - 1, z + i / 9 - 1];
                grid.get(&key).is_some_and(|list| list.iter().any(|q| q.distance(*p) < distance))
            })
        })
        .collect()
}

/// Diffuse light of what is inserted; each round adds a bounce between its own parts.
fn light_inserted(world: &mut World, config: &RealityConfig, rounds: u32) {
    let Some(body) = &world.inserted else {
        return;
    };
    let looks = body.object.vertex_looks();
    for round in 0..rounds {
        let Some(body) = &world.inserted else {
            return;
        };
        let radiance: Vec<Vec3> = looks
            .par_iter()
            .enumerate()
            .map(|(v, look)| {
                if look.diffuse == Vec3::ZERO {
                    return Vec3::ZERO;
                }
                let seed = hash(v as u32, config.seed ^ (0xb0d7 + round));
                look.diffuse * world.gather(&body.vertex_spot(v), Side::After, config.object_rays, 0, seed)
            })
            .collect();
        if let Some(body) = &mut world.inserted {
            body.after.clone_from(&radiance);
            body.radiance = radiance;
        }
    }
}
