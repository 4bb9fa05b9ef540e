//! From a result to a [`BeforeAfterScene`] with objects inserted and removed, lit on both sides.

use crate::mesh::graph::Graph;
use crate::numerics::random::hash;
use crate::rays::Hit;
use crate::render::before_after_scene::{BeforeAfterScene, Body, Part, Side};
use crate::render::bounding_sphere::BoundingSphere;
use crate::render::inpainting::geometry::Cut;
use crate::render::inpainting::membrane::inpaint;
use crate::render::inpainting::texture::continue_texture;
use crate::render::lighting::environment::Environment;
use crate::render::lighting::local_sources::LocalSources;
use crate::render::lighting::observed_background::ObservedBackground;
use crate::render::objects::material::Material;
use crate::render::objects::object::Object;
use crate::render::surface_detail::SurfaceDetail;
use firmware_config::RealityConfig;
use firmware_config::tuning::CompositingTuning;
use glam::Vec3;
use rayon::prelude::*;
use recordings::result::Estimate;

/// A scene with a change, and the light on its kept vertices.
#[derive(Debug)]
pub struct Changed {
    /// Both sides.
    pub scene: BeforeAfterScene,
    /// Irradiance over π before the change; zero where the change does not reach.
    pub irradiance: Vec<Vec3>,
    /// Diffuse albedo in the units of this light: radiance = reflectance · irradiance.
    pub reflectance: Vec<Vec3>,
    /// True where `irradiance` and `after / radiance` are known.
    pub reached: Vec<bool>,
    /// True where `reflectance` is continued from the surroundings: no keyframe saw the surface.
    pub filled: Vec<bool>,
    /// Background beyond the scan.
    pub background: ObservedBackground,
    /// The texture of the scan, if it has one.
    pub detail: Option<SurfaceDetail>,
}

impl Changed {
    /// Factor from the colour of the vertices to that of the texture at a hit on this part of the scan.
    #[must_use]
    pub fn detail(&self, body: &Body, part: Part, hit: &Hit) -> Vec3 {
        self.detail.as_ref().map_or(Vec3::ONE, |d| d.ratio(body, part, hit))
    }

    /// Radiance from beyond the scan: the observed background, otherwise the light.
    #[must_use]
    pub fn beyond(&self, direction: Vec3) -> Vec3 {
        let scene = &self.scene;
        let blocks = |o: Vec3, d: Vec3| {
            scene.kept.bvh.occluded(o, d) || scene.removed.as_ref().is_some_and(|b| b.bvh.occluded(o, d))
        };
        self.background.radiance(direction, blocks).unwrap_or_else(|| scene.environment.radiance(direction))
    }
}

/// The reconstructed surface as an object: albedo per vertex, a material per segment.
#[must_use]
pub fn scanned(estimate: &Estimate, config: &RealityConfig) -> Object {
    let alpha = config.tuning.compositing.gloss_alpha as f32;
    let material = |s: &recordings::result::Segment| Material {
        mirror: s.w_s.clamp(0.0, 1.0) as f32,
        roughness: alpha.sqrt(),
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

/// Lights the kept part of a `cut` result with the `inserted` objects in it; the pair is its light and its background.
#[must_use]
pub fn change(
    estimate: &Estimate,
    (environment, background): (Environment, ObservedBackground),
    cut: Cut,
    inserted: &[Object],
    config: &RealityConfig,
) -> Changed {
    let tuning = &config.tuning.compositing;
    let whole = scanned(estimate, config);
    let detail = SurfaceDetail::new(estimate, &cut);
    let Cut { kept, first_patch, removed, removed_from, .. } = cut;
    let graph = Graph::of(&kept);

    let mut radiance = estimate.lit_color.clone();
    radiance.resize(kept.positions.len(), Vec3::ZERO);
    let mut seen: Vec<bool> = radiance.iter().map(|f| f.is_finite() && f.max_element() > 0.0).collect();
    // What an emitting surface reflects is not known: as much as what is around it.
    estimate.local_light.emitters.iter().flat_map(|e| &e.vertices).for_each(|&i| seen[i as usize] = false);
    inpaint(&mut radiance, &seen, &graph);

    let mut object = Object { mesh: kept, ..whole.clone() };
    object.color.resize(object.mesh.positions.len(), Vec3::splat(0.5));
    object.material = object
        .mesh
        .triangles
        .iter()
        .map(|t| t.iter().filter_map(|&i| estimate.segment.get(i as usize)).next().map_or(0, |s| *s))
        .collect();
    let mut changes: Vec<BoundingSphere> = Vec::new();
    let removed = (!removed.triangles.is_empty()).then(|| {
        let light: Vec<Vec3> = removed_from.iter().map(|&i| radiance[i as usize]).collect();
        changes.extend(pieces(&removed));
        let color = removed_from.iter().map(|&i| estimate.albedo[i as usize]).collect();
        Body::new(Object { mesh: removed, color, ..Object::default() }, light)
    });
    let local = LocalSources::new(&estimate.local_light, &object.mesh);
    let kept = Body::new(object, radiance);
    let mut all = Object::default();
    for object in inserted {
        let mut object = object.clone();
        object.subdivide(tuning.longest_edge as f32 * kept.bvh.median_edge(), tuning.max_triangles as usize);
        changes.extend(BoundingSphere::around(object.mesh.positions.iter().copied()));
        all.append(&object);
    }
    let inserted = (!all.mesh.triangles.is_empty()).then(|| {
        let dark = vec![Vec3::ZERO; all.mesh.positions.len()];
        Body::new(all, dark)
    });
    let scene = BeforeAfterScene { kept, removed, inserted, changes, environment, local };
    let (lit, copied) = light(scene, &seen, first_patch, &graph, config);
    let detail = detail.map(|d| d.continued(lit.filled.clone(), copied));
    Changed { background, detail, ..lit }
}

/// A ball around every connected piece: a cone towards each wastes no ray on what is between them.
fn pieces(mesh: &recordings::types::Mesh) -> Vec<BoundingSphere> {
    let graph = Graph::of(mesh);
    let mut done = vec![false; mesh.positions.len()];
    let mut members: Vec<Vec<usize>> = Vec::new();
    for start in 0..done.len() {
        if !done[start] {
            members.push(graph.component(start, &mut done));
        }
    }
    let ball = |list: &[usize]| BoundingSphere::around(list.iter().map(|&v| mesh.positions[v]));
    if members.len() > 8 {
        BoundingSphere::around(mesh.positions.iter().copied()).into_iter().collect()
    } else {
        members.iter().filter_map(|l| ball(l)).collect()
    }
}

/// Computes the light on both sides; also returns where filled vertices were copied from.
fn light(
    mut scene: BeforeAfterScene,
    seen: &[bool],
    first_patch: usize,
    graph: &Graph,
    config: &RealityConfig,
) -> (Changed, Vec<Option<Vec3>>) {
    let n = scene.kept.object.mesh.positions.len();
    let seed = config.seed;
    let tuning = &config.tuning.compositing;
    let used = {
        let mut used = vec![false; n];
        scene.kept.object.mesh.triangles.iter().flatten().for_each(|&i| used[i as usize] = true);
        used
    };
    let reach: Vec<f32> =
        (0..n).into_par_iter().map(|v| if used[v] { scene.reach(&scene.kept.vertex_point(v)) } else { 0.0 }).collect();
    let reached: Vec<bool> = (0..n)
        .into_par_iter()
        .map(|v| {
            reach[v] > tuning.smallest_reach as f32 || (used[v] && scene.reaches_sources(&scene.kept.vertex_point(v)))
        })
        .collect();
    let (irradiance, ambient): (Vec<Vec3>, Vec<Vec3>) = (0..n)
        .into_par_iter()
        .map(|v| {
            if !reached[v] {
                return (Vec3::ZERO, Vec3::ZERO);
            }
            let (spot, seed) = (scene.kept.vertex_point(v), hash(v as u32, seed));
            let rays = rays(reach[v], config.vertex_rays, tuning);
            let ambient = scene.gather_rays(&spot, Side::Before, rays, 0, seed);
            (ambient + scene.local_irradiance(&spot, Side::Before, rays, 0, seed), ambient)
        })
        .unzip();
    // Beside a lamp all else would count as dark: it is left out.
    let open = ambient.iter().fold(Vec3::ZERO, |m, e| m.max(*e)).max_element();

    // Colour is measured only where enough light falls, and not where the removed object touches.
    let removed = scene.removed.is_some();
    let near = near_removed(&scene, config.contact_edges as f32 * scene.kept.bvh.median_edge());
    let known: Vec<bool> = (0..n)
        .map(|v| {
            v < first_patch
                && seen[v]
                && (!reached[v] || (irradiance[v].min_element() > tuning.dark_share as f32 * open && !near[v]))
        })
        .collect();
    let asked: Vec<bool> = (0..n).map(|v| known[v] && reached[v]).collect();
    // Reflectance is albedo with continued texture, times a slowly varying level that many vertices determine.
    let mut albedo = scene.kept.object.color.clone();
    let mut copied = vec![None; n];
    if removed {
        let edge = scene.kept.bvh.median_edge();
        let mesh = &scene.kept.object.mesh;
        copied = continue_texture(&mut albedo, &known, mesh, graph, edge, &config.tuning.inpainting);
    }
    let mut level: Vec<Vec3> = (0..n)
        .map(|v| {
            let expected = (albedo[v] * irradiance[v]).max(Vec3::splat(1e-12));
            let level = scene.kept.radiance[v] / expected;
            if asked[v] { level.clamp(Vec3::splat(0.2), Vec3::splat(5.0)) } else { Vec3::ONE }
        })
        .collect();
    smooth(&mut level, &asked, graph, tuning.level_sweeps);
    inpaint(&mut level, &asked, graph);
    let reflectance: Vec<Vec3> = albedo.iter().zip(&level).map(|(a, l)| *a * *l).collect();
    let filled: Vec<bool> = (0..n).map(|v| reached[v] && !known[v]).collect();

    light_inserted(&mut scene, config, 1);
    let after: Vec<Vec3> = (0..n)
        .into_par_iter()
        .map(|v| {
            let spot = scene.kept.vertex_point(v);
            if !reached[v] {
                scene.kept.radiance[v]
            } else if filled[v] {
                reflectance[v]
                    * scene.gather(&spot, Side::After, config.vertex_rays, 0, hash(v as u32, seed)).max(Vec3::ZERO)
            } else {
                let change =
                    scene.change(&spot, rays(reach[v], config.change_rays, tuning), hash(v as u32, seed ^ 0x51ed));
                scene.kept.radiance[v] * ratio(irradiance[v], change)
            }
        })
        .collect();
    scene.kept.after = after;
    light_inserted(&mut scene, config, 2);
    let background = ObservedBackground::default();
    (Changed { scene, irradiance, reflectance, reached, filled, background, detail: None }, copied)
}

/// Rays, of `most`, that give a change of this reach the same absolute error as `most` give a large one.
#[must_use]
pub fn rays(reach: f32, most: u32, tuning: &CompositingTuning) -> u32 {
    let share = reach / tuning.full_reach as f32;
    // Whole fours: rays take turns in how they are drawn.
    ((most as f32 * (share * share).clamp(tuning.fewest_rays as f32, 1.0)) as u32).next_multiple_of(4)
}

/// Averages `values` repeatedly over neighbours that are `known`.
fn smooth(values: &mut [Vec3], known: &[bool], graph: &Graph, sweeps: u32) {
    for _ in 0..sweeps {
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

/// Kept vertices within `distance` (m) of a removed object.
fn near_removed(scene: &BeforeAfterScene, distance: f32) -> Vec<bool> {
    let positions = &scene.kept.object.mesh.positions;
    let Some(removed) = &scene.removed else {
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
fn light_inserted(scene: &mut BeforeAfterScene, config: &RealityConfig, rounds: u32) {
    let Some(body) = &scene.inserted else {
        return;
    };
    let brdfs = body.object.vertex_brdfs();
    for round in 0..rounds {
        let Some(body) = &scene.inserted else {
            return;
        };
        let radiance: Vec<Vec3> = brdfs
            .par_iter()
            .enumerate()
            .map(|(v, brdf)| {
                if brdf.diffuse == Vec3::ZERO {
                    return Vec3::ZERO;
                }
                let seed = hash(v as u32, config.seed ^ (0xb0d7 + round));
                brdf.diffuse * scene.gather(&body.vertex_point(v), Side::After, config.object_rays, 0, seed)
            })
            .collect();
        if let Some(body) = &mut scene.inserted {
            body.after.clone_from(&radiance);
            body.radiance = radiance;
        }
    }
}
