//! Data association (Eqs. 2–5): the keyframes' pictures brought onto the mesh as a surface light field, one robust lit
//! colour per vertex, exposures and poses that make the pictures agree.

pub mod exposure;
pub mod keyframe_image;
pub mod pose;
pub mod predicted_image;
pub mod response;

use crate::api::Progress;
use crate::association::keyframe_image::KeyframeImage;
use crate::mesh::graph::{Graph, vertex_spacing};
use crate::mesh::raster::{MISS, Raster, camera_positions, triangle_normals};
use crate::numerics::robust::{SIGMA_PER_MAD, median, weighted_median};
use crate::rays::RayScene;
use firmware_config::{EstimatorConfig, ExposureChoice, Switch};
use glam::{Quat, Vec3};
use rayon::prelude::*;
use recordings::decision::Decision;
use recordings::types::{Keyframe, Mesh, Pose, Response};

const CHUNK: usize = 4096;

/// What one keyframe says of one vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// The vertex.
    pub vertex: u32,
    /// The keyframe.
    pub keyframe: u16,
    /// e_j f~_ij: linear colour after exposure.
    pub color: [f32; 3],
    /// How much it is to be trusted, 0 to 1: angle, resolution, clipping.
    pub weight: f32,
}

/// A keyframe after association.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    /// Refined pose.
    pub world_from_camera: Pose,
    /// Gain g_j = 1/e_j per channel; geometric mean 1 over keyframes and channels.
    pub gain: [f64; 3],
    /// RMS of the last Lucas–Kanade step in pixels; 0 where the pose was not refined.
    pub residual_px: f64,
}

/// The surface light field and what follows from it.
#[derive(Clone)]
pub struct Association {
    /// f: robust lit colour per vertex, linear RGB.
    pub lit_color: Vec<Vec3>,
    /// Sum of the weights behind it; 0 = never seen.
    pub lit_weight: Vec<f32>,
    /// One per keyframe.
    pub views: Vec<View>,
    /// Every observation, sorted by vertex, then keyframe.
    pub observations: Vec<Observation>,
    /// Row starts in `observations`, one more than there are vertices.
    pub offsets: Vec<u32>,
    /// Exposure model and pose refinement, with their evidence.
    pub decisions: Vec<Decision>,
    /// Linear samples below this tell no exposure.
    pub dark_below: f32,
}

/// Weight of a glossy vertex in exposures where enough matte ones are seen.
const GLOSSY: f32 = 0.003;
/// Share of a keyframe's observations that must be matte for that.
const ENOUGH_MATTE: f64 = 0.03;

impl Association {
    /// Exposures and lit colours anew (Eqs. 2 and 5), now that it is known which vertices are `matte`: gloss brightens
    /// a picture like an exposure does. Returns the RMS change of the log gains; `None`, and nothing changes, where
    /// most keyframes see too little that is matte, or exposures are not estimated at all.
    pub fn expose_by(&mut self, matte: &[bool], mesh: &Mesh, median_edge: f32) -> Option<f64> {
        let estimated = self.views.iter().any(|v| v.gain != [1.0; 3]);
        let rgb = self.views.iter().any(|v| v.gain[0] != v.gain[1] || v.gain[1] != v.gain[2]);
        let mut shares = vec![[0.0f64; 2]; self.views.len()];
        for o in &self.observations {
            shares[o.keyframe as usize][usize::from(matte[o.vertex as usize])] += f64::from(o.weight);
        }
        let enough = shares.iter().filter(|[glossy, matte]| *matte > ENOUGH_MATTE * (glossy + matte)).count();
        if !estimated || 2 * enough <= shares.len() {
            return None;
        }
        let gains: Vec<[f32; 3]> = self.views.iter().map(|v| v.gain.map(|g| g as f32)).collect();
        let raw = |o: &Observation| {
            let weight = if matte[o.vertex as usize] { o.weight } else { GLOSSY * o.weight };
            let gain = gains[o.keyframe as usize];
            Observation { color: std::array::from_fn(|c| o.color[c] * gain[c]), weight, ..*o }
        };
        let mut field =
            LightField { observations: self.observations.iter().map(raw).collect(), offsets: self.offsets.clone() };
        let choice = if rgb { ExposureChoice::Rgb } else { ExposureChoice::Scalar };
        let (new, _) = exposure::solve(&field, mesh, median_edge, self.views.len(), choice, self.dark_below);
        let mut moved = 0.0;
        for (view, new) in self.views.iter_mut().zip(&new) {
            moved += view.gain.iter().zip(new).map(|(a, b)| libm::log(b / a).powi(2)).sum::<f64>() / 3.0;
            view.gain = *new;
        }
        let moved = libm::sqrt(moved / self.views.len() as f64);
        field.observations.iter_mut().zip(&self.observations).for_each(|(raw, o)| raw.weight = o.weight);
        let lit = field.lit_colors(&self.views);
        (self.lit_color, self.lit_weight) = (lit.color, lit.weight);
        for (o, raw) in self.observations.iter_mut().zip(&field.observations) {
            let gain = self.views[o.keyframe as usize].gain;
            o.color = std::array::from_fn(|c| raw.color[c] / gain[c] as f32);
        }
        Some(moved)
    }
}

/// What does not change from round to round.
pub struct Setting<'a> {
    /// The mesh.
    pub mesh: &'a Mesh,
    /// Its edges.
    pub graph: &'a Graph,
    /// Mean edge length per vertex.
    pub spacing: Vec<f32>,
    /// Smooth normal per triangle.
    pub triangle_normals: Vec<Vec3>,
    /// Nothing nearer to a camera is seen.
    pub near: f64,
    /// Linear light of 8-bit values.
    pub table: [f32; 256],
    /// 8-bit values from here on are clipped.
    pub clipped: u8,
}

impl<'a> Setting<'a> {
    /// For pictures of this response on this mesh.
    #[must_use]
    pub fn new(
        mesh: &'a Mesh,
        graph: &'a Graph,
        scene: &RayScene,
        response: &Response,
        config: &EstimatorConfig,
    ) -> Self {
        let edge = scene.median_edge();
        Self {
            mesh,
            graph,
            spacing: vertex_spacing(mesh, graph, edge),
            triangle_normals: triangle_normals(mesh),
            near: f64::from(edge) * 0.1,
            table: response.linear_table(),
            clipped: config.clipped_from.min(255) as u8,
        }
    }

    /// What one picture alone says of every vertex, and how much it is to be trusted; 0 = not seen.
    #[must_use]
    pub fn colors_of(&self, picture: &KeyframeImage, pose: &Pose, config: &EstimatorConfig) -> (Vec<Vec3>, Vec<f32>) {
        let last = Rules::new(config, 1.0);
        let seen = observe(self, picture, pose, 0, &last, Some(last.last_resort()));
        let mut colors = vec![Vec3::ZERO; self.mesh.positions.len()];
        let mut weights = vec![0.0; colors.len()];
        for o in seen.poor.iter().chain(&seen.good) {
            colors[o.vertex as usize] = Vec3::from_array(o.color);
            weights[o.vertex as usize] = o.weight;
        }
        (colors, weights)
    }
}

/// Which observations are eligible; relaxed from round to round.
#[derive(Debug, Clone, Copy)]
struct Rules {
    /// c2 of Eq. (3).
    min_cosine: f32,
    /// c3 of Eq. (4), in edges or footprints.
    edge_distance: f32,
    /// c4 of Eq. (4).
    edge_cosine: f32,
    /// How far around a vertex's pixel Eq. (4) looks.
    edge_pixels: i32,
}

impl Rules {
    /// `relaxed` runs from 0 (first round) to 1 (last).
    fn new(config: &EstimatorConfig, relaxed: f64) -> Self {
        let cosine = config.view_cosine_first + relaxed * (config.view_cosine_last - config.view_cosine_first);
        let angle = (config.edge_angle_deg * (1.0 + 0.5 * relaxed)).min(180.0).to_radians();
        Self {
            min_cosine: cosine as f32,
            edge_distance: (config.edge_distance * (1.0 + relaxed)) as f32,
            edge_cosine: libm::cos(angle) as f32,
            edge_pixels: if relaxed < 0.5 { 3 } else { 2 },
        }
    }

    /// For vertices that have nothing better: seen, however steeply and however near to an edge.
    fn last_resort(&self) -> Self {
        Self {
            min_cosine: 0.5 * self.min_cosine,
            edge_distance: 2.0 * self.edge_distance,
            edge_cosine: -1.0,
            edge_pixels: 1,
        }
    }
}

/// Runs data association (Eqs. 2–5) until it is done.
pub fn associate(
    mesh: &Mesh,
    scene: &RayScene,
    keyframes: &[Keyframe],
    response: &Response,
    config: &EstimatorConfig,
    progress: &dyn Progress,
) -> Association {
    let effort = Effort { rounds: config.association_rounds, stride: 1, go_on: &mut |_| true };
    associate_within(mesh, scene, keyframes, response, config, progress, effort)
}

/// What association may spend.
pub struct Effort<'a> {
    /// Rounds of pose refinement at most.
    pub rounds: u32,
    /// Every so manieth keyframe is looked at.
    pub stride: usize,
    /// Asked before every round.
    pub go_on: &'a mut dyn FnMut(u32) -> bool,
}

/// Runs data association (Eqs. 2–5) with so much effort.
pub fn associate_within(
    mesh: &Mesh,
    scene: &RayScene,
    keyframes: &[Keyframe],
    response: &Response,
    config: &EstimatorConfig,
    progress: &dyn Progress,
    effort: Effort,
) -> Association {
    let graph = Graph::of(mesh);
    let edge = scene.median_edge();
    let setting = Setting::new(mesh, &graph, scene, response, config);
    let pictures: Vec<Option<KeyframeImage>> = keyframes
        .par_iter()
        .enumerate()
        .map(|(j, k)| if j % effort.stride == 0 { KeyframeImage::new(&k.color, &k.camera) } else { None })
        .collect();
    let mut views: Vec<View> = keyframes
        .iter()
        .map(|k| View { world_from_camera: k.world_from_camera, gain: [1.0; 3], residual_px: 0.0 })
        .collect();
    let refine = config.refine_poses != Switch::Off && keyframes.len() >= 2 && effort.rounds > 0;
    let rounds = if refine { effort.rounds } else { 1 };
    let exposures = |field: &LightField| {
        exposure::solve(field, mesh, edge, keyframes.len(), config.exposure, config.dark_below as f32)
    };
    let mut tracker = pose::Tracker::new(keyframes);
    for round in 0..rounds {
        progress.stage("association", f64::from(round) / f64::from(rounds));
        if !refine || !(effort.go_on)(round) {
            break;
        }
        let relaxed = f64::from(round) / f64::from(rounds);
        let field = LightField::gather(&setting, &pictures, &views, &Rules::new(config, relaxed), None);
        let (gains, _) = exposures(&field); // Eq. (5)
        views.iter_mut().zip(gains).for_each(|(v, g)| v.gain = g);
        let lit = field.lit_colors(&views); // Eq. (2)
        if !tracker.step(&setting, &pictures, &field, &lit, &mut views, round) {
            break;
        }
    }
    let last = Rules::new(config, 1.0);
    let field = LightField::gather(&setting, &pictures, &views, &last, Some(last.last_resort()));
    let (gains, decision) = exposures(&field);
    views.iter_mut().zip(gains).for_each(|(v, g)| v.gain = g);
    let lit = field.lit_colors(&views);
    progress.stage("association", 1.0);
    let mut observations = field.observations;
    observations.par_iter_mut().for_each(|o| {
        let gain = views[o.keyframe as usize].gain;
        o.color = std::array::from_fn(|c| o.color[c] / gain[c] as f32);
    });
    Association {
        lit_color: lit.color,
        lit_weight: lit.weight,
        views,
        observations,
        offsets: field.offsets,
        decisions: decision.into_iter().chain([tracker.decision(refine)]).collect(),
        dark_below: config.dark_below as f32,
    }
}

/// Samples of all pictures at all vertices, before exposure.
pub struct LightField {
    /// Sorted by vertex, then keyframe; `color` is the picture's own linear value.
    pub observations: Vec<Observation>,
    /// Row starts, one more than there are vertices.
    pub offsets: Vec<u32>,
}

/// Robust lit colours with the weights they were made with.
pub struct LitColors {
    /// Per vertex; black where never seen.
    pub color: Vec<Vec3>,
    /// Sum of weights per vertex; 0 = never seen.
    pub weight: Vec<f32>,
    /// Weight of every observation after robust reweighting.
    pub used: Vec<f32>,
}

impl LightField {
    /// Observations under `rules`; a vertex that has none but poor ones keeps those.
    fn gather(
        setting: &Setting,
        pictures: &[Option<KeyframeImage>],
        views: &[View],
        rules: &Rules,
        last_resort: Option<Rules>,
    ) -> Self {
        let per_view: Vec<Sightings> = pictures
            .par_iter()
            .zip(views)
            .enumerate()
            .map(|(j, (picture, view))| match picture {
                Some(picture) => observe(setting, picture, &view.world_from_camera, j as u16, rules, last_resort),
                None => Sightings::default(),
            })
            .collect();
        let n = setting.mesh.positions.len();
        let mut well_seen = vec![false; n];
        per_view.iter().flat_map(|v| &v.good).for_each(|o| well_seen[o.vertex as usize] = true);
        let kept = || {
            let poor = per_view.iter().flat_map(|v| &v.poor).filter(|o| !well_seen[o.vertex as usize]);
            per_view.iter().flat_map(|v| &v.good).chain(poor)
        };
        let mut offsets = vec![0_u32; n + 1];
        kept().for_each(|o| offsets[o.vertex as usize + 1] += 1);
        for i in 0..n {
            offsets[i + 1] += offsets[i];
        }
        let mut cursor = offsets.clone();
        let blank = Observation { vertex: 0, keyframe: 0, color: [0.0; 3], weight: 0.0 };
        let mut observations = vec![blank; offsets[n] as usize];
        for o in kept() {
            let at = &mut cursor[o.vertex as usize];
            observations[*at as usize] = *o;
            *at += 1;
        }
        Self { observations, offsets }
    }

    /// Eq. (2) for every vertex.
    pub fn lit_colors(&self, views: &[View]) -> LitColors {
        let factors: Vec<[f32; 3]> = views.iter().map(|v| v.gain.map(|g| (1.0 / g) as f32)).collect();
        let rows = self.offsets.len() - 1;
        let scale = self.noise_scale(&factors);
        let starts: Vec<usize> = (0..rows).step_by(CHUNK).collect();
        let parts: Vec<(Vec<_>, Vec<f32>)> = starts
            .par_iter()
            .map(|&start| {
                let mut used = Vec::new();
                let colors: Vec<(Vec3, f32)> = (start..(start + CHUNK).min(rows))
                    .map(|i| {
                        let row = &self.observations[self.offsets[i] as usize..self.offsets[i + 1] as usize];
                        robust_color(row, &factors, scale, &mut used)
                    })
                    .collect();
                (colors, used)
            })
            .collect();
        let mut lit = LitColors { color: Vec::with_capacity(rows), weight: Vec::with_capacity(rows), used: Vec::new() };
        for (colors, used) in parts {
            lit.color.extend(colors.iter().map(|c| c.0));
            lit.weight.extend(colors.iter().map(|c| c.1));
            lit.used.extend(used);
        }
        lit
    }

    /// Median deviation of the square roots of an observation of full weight from its vertex's median.
    fn noise_scale(&self, factors: &[[f32; 3]]) -> f32 {
        let rows = self.offsets.len() - 1;
        // A few thousand vertices tell the scale.
        let stride = (rows / 4000).max(1);
        let deviations = (0..rows).step_by(stride).flat_map(|i| {
            let row = &self.observations[self.offsets[i] as usize..self.offsets[i + 1] as usize];
            let middle = median_color(row, factors);
            let many = row.len() >= 3;
            row.iter()
                .filter(move |_| many)
                .map(move |o| deviation(o, factors, middle) * o.weight.sqrt())
                .collect::<Vec<f32>>()
        });
        median(deviations).map_or(1e-3, |m| (SIGMA_PER_MAD as f32 * m).max(1e-4))
    }
}

/// RMS difference of square roots over the channels: photon noise is the same at every brightness there.
fn deviation(o: &Observation, factors: &[[f32; 3]], color: Vec3) -> f32 {
    let e = factors[o.keyframe as usize];
    let d = (0..3).map(|c| (o.color[c] * e[c]).max(0.0).sqrt() - color[c].max(0.0).sqrt()).map(|x| x * x);
    (d.sum::<f32>() / 3.0).sqrt()
}

fn median_color(row: &[Observation], factors: &[[f32; 3]]) -> Vec3 {
    let mut values: Vec<(f64, f64)> = Vec::with_capacity(row.len());
    let channels: [f32; 3] = std::array::from_fn(|c| {
        values.clear();
        values.extend(
            row.iter()
                .map(|o| (f64::from(o.color[c] * factors[o.keyframe as usize][c]), f64::from(o.weight.max(1e-6)))),
        );
        weighted_median(&mut values).unwrap_or(0.0) as f32
    });
    Vec3::from_array(channels)
}

/// Huber's estimate from the weighted median on. Eq. (2)
fn robust_color(row: &[Observation], factors: &[[f32; 3]], scale: f32, used: &mut Vec<f32>) -> (Vec3, f32) {
    if row.is_empty() {
        return (Vec3::ZERO, 0.0);
    }
    let mut color = median_color(row, factors);
    let first = used.len();
    used.resize(first + row.len(), 0.0);
    let mut total = 0.0;
    for _ in 0..3 {
        let mut sum = Vec3::ZERO;
        total = 0.0;
        for (o, u) in row.iter().zip(&mut used[first..]) {
            let x = deviation(o, factors, color) * o.weight.sqrt() / (1.5 * scale);
            *u = o.weight / x.max(1.0);
            sum += *u * Vec3::from_array(o.color) * Vec3::from_array(factors[o.keyframe as usize]);
            total += *u;
        }
        if total <= 0.0 {
            break;
        }
        color = sum / total;
    }
    (color, total)
}

/// What one keyframe sees, ascending by vertex.
#[derive(Default)]
struct Sightings {
    good: Vec<Observation>,
    /// Clipped, or under the last resort's rules: for vertices that have nothing better.
    poor: Vec<Observation>,
}

/// Weight of a poor observation against a good one.
const POOR: f32 = 0.02;

/// All observations of one keyframe (Eqs. 3 and 4).
fn observe(
    setting: &Setting,
    picture: &KeyframeImage,
    pose: &Pose,
    keyframe: u16,
    rules: &Rules,
    last_resort: Option<Rules>,
) -> Sightings {
    let mesh = setting.mesh;
    let k = &picture.camera;
    let points = camera_positions(mesh, pose);
    let raster = Raster::new(&points, &mesh.triangles, k, setting.near);
    let camera_from_world = pose.rotation.conjugate().as_quat();
    let focal = 0.5 * (k.fx.abs() + k.fy.abs());
    let mut out = Sightings::default();
    for (i, p) in points.iter().enumerate() {
        if !(p.z > setting.near && p.is_finite()) {
            continue;
        }
        let (u, v) = (k.fx * p.x / p.z + k.cx, k.fy * p.y / p.z + k.cy);
        if !(u > 0.0 && v > 0.0 && u < f64::from(k.width) && v < f64::from(k.height)) {
            continue;
        }
        let normal = camera_from_world * mesh.normals[i];
        let cosine = -normal.dot(p.as_vec3().normalize_or_zero());
        let footprint = (p.z / focal) as f32;
        let site = Site { u, v, point: p.as_vec3(), normal, footprint, cosine, spacing: setting.spacing[i] };
        let is_clear = |rules: &Rules| site.is_clear(setting, &raster, &camera_from_world, rules);
        let well = is_clear(rules);
        if !well && !last_resort.is_some_and(|r| is_clear(&r)) {
            continue;
        }
        // The window covers the vertex's own surface, foreshortened.
        let spacing_px = setting.spacing[i] / footprint;
        let radius = (0.75 * spacing_px * cosine.max(0.3)).clamp(1.0, 4.0);
        let Some(sample) = picture.sample(&setting.table, u, v, f64::from(radius)) else {
            continue;
        };
        // Few pixels on a vertex mix it with its neighbours.
        let resolution = (spacing_px * cosine).min(1.0);
        let angle = (cosine - 0.5 * rules.min_cosine).max(0.1 * cosine) / (1.0 - 0.5 * rules.min_cosine);
        let pixels = sample.pixels / (sample.pixels + 4.0);
        let good = well && sample.brightest < setting.clipped;
        let weight = angle * resolution * pixels * if good { 1.0 } else { POOR };
        let observation = Observation { vertex: i as u32, keyframe, color: sample.color, weight };
        if good { out.good.push(observation) } else { out.poor.push(observation) }
    }
    out
}

/// Where a vertex is seen, in the camera's frame.
struct Site {
    u: f64,
    v: f64,
    point: Vec3,
    normal: Vec3,
    footprint: f32,
    cosine: f32,
    spacing: f32,
}

impl Site {
    /// Visible, not too steep, and no geometric edge within the rules' reach. Eqs. (3) and (4)
    fn is_clear(&self, setting: &Setting, raster: &Raster, camera_from_world: &Quat, rules: &Rules) -> bool {
        if self.cosine.is_nan() || self.cosine <= rules.min_cosine {
            return false;
        }
        let (w, h) = (i64::from(raster.camera.width), i64::from(raster.camera.height));
        let (x, y) = ((self.u + 0.5).floor() as i64, (self.v + 0.5).floor() as i64);
        let reach = i64::from(rules.edge_pixels);
        for dy in [-reach, 0, reach] {
            for dx in [-reach, 0, reach] {
                let (px, py) = (x + dx, y + dy);
                if px < 0 || py < 0 || px >= w || py >= h {
                    return false;
                }
                let triangle = raster.triangle[(py * w + px) as usize];
                if triangle == MISS {
                    return false;
                }
                let Some(seen) = raster.point(px as usize, py as usize) else {
                    return false;
                };
                let offset = seen.as_vec3() - self.point;
                // Along the surface a pixel is longer by 1/cosine.
                let step = self.footprint * (dx.abs().max(dy.abs()) as f32 + 1.0) / self.cosine;
                let limit = rules.edge_distance * self.spacing.max(step * 0.5);
                let normal = *camera_from_world * setting.triangle_normals[triangle as usize];
                if offset.length() > limit.max(1.5 * step) || normal.dot(self.normal) < rules.edge_cosine {
                    return false;
                }
                // At the vertex itself nothing may stand in front.
                if dx == 0 && dy == 0 && offset.dot(self.normal) > 0.5 * self.spacing.max(self.footprint) {
                    return false;
                }
            }
        }
        true
    }
}
