//! The scan under other light: primary hits and transfer are kept, a new distant light costs a product. Lamps and emitting
//! surfaces keep one state, with shadows and bounces.

use crate::mesh::graph::Graph;
use crate::numerics::random::hash;
use crate::numerics::sh;
use crate::render::before_after_scene::{Body, Part, RayTarget, Side};
use crate::render::change::Changed;
use crate::render::compose::{Picture, Viewpoint};
use crate::render::lighting::environment::Environment;
use crate::render::lighting::local_sources::LocalSources;
use crate::render::objects::material::Brdf;
use crate::render::objects::object::{interpolate, weights};
use crate::render::sampling::point;
use crate::transfer::{Tracer, Transfer, bounce, bounce_light};
use firmware_config::RealityConfig;
use glam::Vec3;
use rayon::prelude::*;
use recordings::local_light::LocalLight;

/// Samples per pixel, on a grid of this side.
const GRID: u32 = 2;
/// Looks smoother than this are lit by the panorama itself, others by its spherical harmonics.
const SMOOTH: f32 = 0.01;
/// Rays to every lamp for one ray of the transfer.
const AIMED_SHARE: u32 = 4;

/// New distant light.
#[derive(Debug, Clone)]
pub struct NewLight {
    /// Coefficients, [`BANDS`]² rows.
    pub coefficients: Vec<[f64; 3]>,
    /// Radiance over directions: background and mirrors.
    pub environment: Environment,
    /// True for the scan's own: over a photo, what lies beyond the scan stays the photo's.
    pub scanned: bool,
}

/// Bands of new light: what diffuse surfaces and soft shadows can show.
pub const BANDS: usize = 7;

/// What a glossy vertex mirrors.
#[derive(Debug, Clone, Copy)]
enum Mirrored {
    /// Light from this direction.
    Light(Vec3),
    /// The light that leaves this vertex.
    Vertex(u32),
}

#[derive(Debug, Clone, Copy)]
struct Gloss {
    vertex: u32,
    reflectance: Vec3,
    smooth: bool,
    mirrored: Mirrored,
    /// What it shows of lamps and emitting surfaces.
    sources: Vec3,
}

/// One sample of a pixel.
#[derive(Debug, Clone, Copy)]
enum Sample {
    /// A surface: vertices and the weights of the second and the third; true if the photo shows the same surface.
    Surface([u32; 3], [f32; 2], bool),
    /// A lamp, and its radiance.
    Lamp(Vec3),
    /// The light itself; true if the photo shows a lamp there.
    Beyond(Vec3, bool),
}

/// Transfer of a changed world.
#[derive(Debug)]
pub struct Relight {
    transfer: Transfer,
    albedo: Vec<Vec3>,
    /// Diffuse light as scanned, for pictures over photos: `[vertex]`.
    scanned: Vec<Vec3>,
    body: Body,
    brdfs: Vec<Brdf>,
    kept: usize,
    sources: LocalSources,
    /// Irradiance over π straight from lamps and emitting surfaces: `[vertex]`.
    direct: Vec<Vec3>,
    /// The same with bounces.
    local: Vec<Vec3>,
}

/// Kept hits of one view.
#[derive(Debug)]
pub struct CachedView {
    samples: Vec<Sample>,
    /// What sources add to the light of the vertices, whose shadows are as coarse as the mesh: `[sample]`; empty without
    /// sources.
    sharp: Vec<Vec3>,
    /// Factor from the colour of the vertices to that of the texture: `[sample]`; empty without a texture.
    detail: Vec<Vec3>,
    gloss: Vec<Gloss>,
}

impl Relight {
    /// Traces the transfer of what is there after the change, and the light of the lamps and emitting surfaces of `near`.
    #[must_use]
    pub fn new(changed: &Changed, near: &LocalLight, config: &RealityConfig, report: &(dyn Fn(f64) + Sync)) -> Self {
        let before_after = &changed.scene;
        let mut object = before_after.kept.object.clone();
        let kept = object.mesh.positions.len();
        for v in 0..kept {
            if changed.filled[v] && changed.reflectance[v].max_element() > 0.0 {
                object.color[v] = changed.reflectance[v].clamp(Vec3::ZERO, Vec3::ONE);
            }
        }
        let mut scanned = before_after.kept.radiance.clone();
        (0..).zip(&mut scanned).for_each(|(v, radiance)| *radiance += before_after.local.emission(v));
        if let Some(inserted) = &before_after.inserted {
            object.append(&inserted.object);
            scanned.resize(object.mesh.positions.len(), Vec3::ZERO);
        }
        let body = Body::new(object, Vec::new());
        let (mesh, scene) = (&body.object.mesh, &body.bvh);
        let tracer = Tracer { mesh, graph: &Graph::of(mesh), scene, bands: BANDS, seed: config.seed };
        let traced = tracer.trace(config.relight_rays, report);
        let brdfs = body.object.vertex_brdfs();
        let albedo: Vec<Vec3> = brdfs.iter().map(|l| l.diffuse).collect();
        let bounced = Some(bounce(&traced, &albedo, 0));
        let sources = LocalSources::new(near, &body.object.mesh);
        let arriving = |v: usize| {
            let rays = config.relight_rays / AIMED_SHARE;
            let spot = body.vertex_point(v);
            sources.irradiance_in(&body.bvh, (spot.origin, spot.normal), 0..rays, hash(v as u32, config.seed))
        };
        let direct: Vec<Vec3> = (0..albedo.len()).into_par_iter().map(arriving).collect();
        let local = bounce_light(&traced, &albedo, &direct);
        Self {
            transfer: Transfer { traced: traced.into(), bounced },
            albedo,
            scanned,
            body,
            brdfs,
            kept,
            sources,
            direct,
            local,
        }
    }

    /// Finds what a view shows.
    #[must_use]
    pub fn view(&self, changed: &Changed, view: &Viewpoint, config: &RealityConfig) -> CachedView {
        let (width, height) = view.size();
        let eye = view.world_from_camera.translation.as_vec3();
        let per_pixel = (GRID * GRID) as usize;
        let direction = |s: usize| {
            let (i, k) = (s / per_pixel, (s % per_pixel) as u32);
            let jitter = point(k, hash(i as u32, config.seed));
            let at = |cell: u32, j: f32| (cell as f32 + j) / GRID as f32 - 0.5;
            view.ray((i % width) as f32 + at(k % GRID, jitter[0]), (i / width) as f32 + at(k / GRID, jitter[1]))
        };
        let all = (0..width * height * per_pixel).into_par_iter();
        let samples: Vec<Sample> = all.clone().map(|s| self.sample(changed, eye, direction(s))).collect();
        let sharp = |s: usize| self.sharp((eye, direction(s)), (s / per_pixel, s % per_pixel), config);
        let sharp: Vec<Vec3> = if self.sources.is_empty() { Vec::new() } else { all.clone().map(sharp).collect() };
        let detail = |s: usize| self.detail(changed, eye, direction(s));
        let detail: Vec<Vec3> = if changed.detail.is_none() { Vec::new() } else { all.map(detail).collect() };
        let mut shown = vec![false; self.body.object.mesh.positions.len()];
        for s in &samples {
            if let Sample::Surface(t, ..) = s {
                t.iter().for_each(|&v| shown[v as usize] = true);
            }
        }
        let gloss = (0..shown.len())
            .into_par_iter()
            .filter(|&v| shown[v] && !self.brdfs[v].is_diffuse())
            .map(|v| {
                let (p, n) = (self.body.object.mesh.positions[v], self.body.object.mesh.normals[v]);
                let o = (eye - p).normalize_or(n);
                let n = if n.dot(o) < 0.0 { -n } else { n };
                let r = n * (2.0 * n.dot(o)) - o;
                let mirrored = match self.body.bvh.closest_hit(self.body.bvh.offset_origin(p, n), r) {
                    Some(hit) => Mirrored::Vertex(self.body.object.mesh.triangles[hit.triangle as usize][0]),
                    None => Mirrored::Light(r),
                };
                let brdf = &self.brdfs[v];
                let sources = self.mirrored_sources(v, (n, o, r), config);
                Gloss {
                    vertex: v as u32,
                    reflectance: brdf.reflectance(n.dot(o)),
                    smooth: brdf.alpha < SMOOTH,
                    mirrored,
                    sources,
                }
            })
            .collect();
        CachedView { samples, sharp, detail, gloss }
    }

    /// How the texture differs from the vertices where a ray from the eye meets the scan.
    fn detail(&self, changed: &Changed, eye: Vec3, d: Vec3) -> Vec3 {
        let hit = self.body.bvh.closest_hit(eye, d);
        // The scan's triangles stand before those of inserted things.
        let scanned = changed.scene.kept.object.mesh.triangles.len();
        let hit = hit.filter(|h| (h.triangle as usize) < scanned);
        hit.map_or(Vec3::ONE, |h| changed.detail(&changed.scene.kept, Part::Kept, &h))
    }

    /// What a ray from the eye shows.
    fn sample(&self, changed: &Changed, eye: Vec3, d: Vec3) -> Sample {
        let hit = self.body.bvh.closest_hit(eye, d);
        if let Some((distance, radiance)) = self.sources.lamp_along(eye, d)
            && hit.as_ref().is_none_or(|h| distance < h.distance)
        {
            return Sample::Lamp(radiance);
        }
        let Some(hit) = hit else {
            return Sample::Beyond(d, changed.scene.local.lamp_along(eye, d).is_some());
        };
        let t = self.body.object.mesh.triangles[hit.triangle as usize];
        let in_photo =
            (t[0] as usize) < self.kept
                && changed.scene.removed.as_ref().is_none_or(|_| {
                    matches!(changed.scene.meet(eye, d, Side::Before), RayTarget::Body(_, _, Part::Kept))
                });
        let w = weights(&hit);
        Sample::Surface(t, [w[1], w[2]], in_photo)
    }

    /// What sources add to the light of the vertices at a ray's hit, for a sample of a pixel.
    fn sharp(&self, (eye, d): (Vec3, Vec3), (pixel, sample): (usize, usize), config: &RealityConfig) -> Vec3 {
        let Some(hit) = self.body.bvh.closest_hit(eye, d) else {
            return Vec3::ZERO;
        };
        let spot = self.body.surface_point(eye, d, &hit);
        // One sequence for all samples of a pixel.
        let (rays, first) = (config.pixel_change_rays.div_ceil(GRID * GRID), sample as u32);
        let seed = hash(pixel as u32, config.seed);
        let (at, rays) = ((spot.origin, spot.normal), first * rays..(first + 1) * rays);
        let here = self.sources.irradiance_in(&self.body.bvh, at, rays, seed);
        let coarse = interpolate(&self.direct, self.body.object.mesh.triangles[hit.triangle as usize], &hit);
        self.body.object.brdf(&hit).diffuse * (here - coarse)
    }

    /// What a glossy vertex shows of lamps and emitting surfaces; `n` its normal, `o` towards the eye, `r` mirrored.
    fn mirrored_sources(&self, vertex: usize, (n, o, r): (Vec3, Vec3, Vec3), config: &RealityConfig) -> Vec3 {
        let (brdf, origin) =
            (&self.brdfs[vertex], self.body.bvh.offset_origin(self.body.object.mesh.positions[vertex], n));
        if brdf.alpha < SMOOTH {
            let lamp = self.sources.lamp_along(origin, r);
            let seen = lamp.filter(|(distance, _)| !self.body.bvh.occluded_within(origin, r, *distance));
            return seen.map_or(Vec3::ZERO, |(_, radiance)| brdf.reflectance(n.dot(o)) * radiance);
        }
        let rays = 0..config.relight_rays / AIMED_SHARE;
        self.sources.integrate(origin, rays, hash(vertex as u32, config.seed ^ 0x6105), |drawn| {
            let lobe = brdf.lobe(n, o, drawn.direction);
            if lobe == Vec3::ZERO || !drawn.is_seen_from(origin, &self.body.bvh) {
                Vec3::ZERO
            } else {
                lobe * drawn.weight
            }
        })
    }

    /// Light that leaves every vertex towards the view under a new light: what it scatters, and what it mirrors.
    fn vertices(&self, view: &CachedView, light: &NewLight) -> (Vec<Vec3>, Vec<Vec3>) {
        let irradiance = self.transfer.irradiance(&light.coefficients);
        let shown = |v: usize| {
            (self.albedo[v] * (irradiance[v] + self.local[v])).max(Vec3::ZERO) + self.sources.emission(v as u32)
        };
        let out: Vec<Vec3> = (0..irradiance.len()).into_par_iter().map(shown).collect();
        let mirrored: Vec<Vec3> = view
            .gloss
            .par_iter()
            .map(|g| {
                let light = match g.mirrored {
                    Mirrored::Vertex(v) => out[v as usize],
                    Mirrored::Light(r) if g.smooth => light.environment.radiance(r),
                    Mirrored::Light(r) => Vec3::from(sh::radiance(&light.coefficients, r.as_dvec3()).map(|x| x as f32)),
                };
                g.reflectance * light.max(Vec3::ZERO) + g.sources
            })
            .collect();
        let mut shine = vec![Vec3::ZERO; out.len()];
        for (g, m) in view.gloss.iter().zip(mirrored) {
            shine[g.vertex as usize] = m;
        }
        (out, shine)
    }

    /// The view under a new light, over `photo` if there is one (linear); `gain` is the view's.
    #[must_use]
    pub fn picture(&self, view: &CachedView, light: &NewLight, gain: Vec3, photo: Option<&[Vec3]>) -> Picture {
        let (scattered, shine) = self.vertices(view, light);
        let per_pixel = (GRID * GRID) as usize;
        let at = |values: &[Vec3], t: &[u32; 3], w: &[f32; 2]| {
            values[t[0] as usize] * (1.0 - w[0] - w[1]) + values[t[1] as usize] * w[0] + values[t[2] as usize] * w[1]
        };
        let linear: Vec<Vec3> = view
            .samples
            .par_chunks(per_pixel)
            .enumerate()
            .map(|(i, samples)| {
                let (mut new, mut rendered, mut old) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO);
                let (mut shared, mut beyond) = (0u32, 0u32);
                for (s, k) in samples.iter().zip(i * per_pixel..) {
                    let sharp = view.sharp.get(k).copied().unwrap_or_default();
                    let detail = view.detail.get(k).copied().unwrap_or(Vec3::ONE);
                    match s {
                        Sample::Lamp(radiance) => rendered += *radiance,
                        Sample::Beyond(_, false) if light.scanned && photo.is_some() => beyond += 1,
                        Sample::Beyond(d, _) => rendered += light.environment.radiance(*d),
                        Sample::Surface(t, w, true) if photo.is_some() => {
                            new += (at(&scattered, t, w) + at(&shine, t, w) + sharp).max(Vec3::ZERO);
                            old += at(&self.scanned, t, w);
                            shared += 1;
                        }
                        Sample::Surface(t, w, _) => {
                            let diffuse = (at(&scattered, t, w) + sharp) * detail;
                            rendered += (diffuse + at(&shine, t, w)).max(Vec3::ZERO);
                        }
                    }
                }
                let n = per_pixel as f32;
                let mut value = gain * rendered / n;
                if let Some(photo) = photo {
                    value += photo[i] * (beyond as f32 / n);
                }
                if let (Some(photo), true) = (photo, shared > 0) {
                    // The photo's own colour of the surface, under the ratio of the two lights.
                    let ratio = (new / old.max(Vec3::splat(1e-9))).clamp(Vec3::ZERO, Vec3::splat(100.0));
                    value += photo[i] * ratio * (shared as f32 / n);
                }
                value
            })
            .collect();
        let touched = vec![true; linear.len()];
        Picture { linear, touched }
    }
}
