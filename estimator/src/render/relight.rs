//! The scan under other light: primary hits and transfer are kept, a new light costs a product.

use crate::numerics::random::hash;
use crate::numerics::sh;
use crate::rays::RayScene;
use crate::render::before_after_scene::{Part, RayTarget, Side};
use crate::render::change::Changed;
use crate::render::compose::{Picture, Viewpoint};
use crate::render::lighting::environment::Environment;
use crate::render::objects::material::Brdf;
use crate::render::objects::object::weights;
use crate::render::sampling::point;
use crate::transfer::{Tracer, Transfer, bounce};
use firmware_config::RealityConfig;
use glam::Vec3;
use rayon::prelude::*;

/// Samples per pixel, on a grid of this side.
const GRID: u32 = 2;
/// Looks smoother than this are lit by the panorama itself, others by its spherical harmonics.
const SMOOTH: f32 = 0.01;

/// New light.
#[derive(Debug, Clone)]
pub struct NewLight {
    /// Coefficients, [`BANDS`]² rows.
    pub coefficients: Vec<[f64; 3]>,
    /// Radiance over directions: background and mirrors.
    pub environment: Environment,
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
}

/// One sample of a pixel.
#[derive(Debug, Clone, Copy)]
enum Sample {
    /// A surface: vertices and the weights of the second and the third; true if the photo shows the same surface.
    Surface([u32; 3], [f32; 2], bool),
    /// The light itself.
    Beyond(Vec3),
}

/// Transfer of a changed world.
#[derive(Debug)]
pub struct Relight {
    transfer: Transfer,
    albedo: Vec<Vec3>,
    /// Diffuse light as scanned, for pictures over photos: `[vertex]`.
    scanned: Vec<Vec3>,
    scene: RayScene,
    mesh: recordings::types::Mesh,
    brdfs: Vec<Brdf>,
    kept: usize,
}

/// Kept hits of one view.
#[derive(Debug)]
pub struct CachedView {
    samples: Vec<Sample>,
    gloss: Vec<Gloss>,
}

impl Relight {
    /// Traces the transfer of what is there after the change.
    #[must_use]
    pub fn new(changed: &Changed, config: &RealityConfig, report: &(dyn Fn(f64) + Sync)) -> Self {
        let before_after = &changed.scene;
        let mut object = before_after.kept.object.clone();
        let kept = object.mesh.positions.len();
        for v in 0..kept {
            if changed.filled[v] && changed.reflectance[v].max_element() > 0.0 {
                object.color[v] = changed.reflectance[v].clamp(Vec3::ZERO, Vec3::ONE);
            }
        }
        let mut scanned = before_after.kept.radiance.clone();
        if let Some(inserted) = &before_after.inserted {
            object.append(&inserted.object);
            scanned.resize(object.mesh.positions.len(), Vec3::ZERO);
        }
        let scene = RayScene::new(&object.mesh);
        let tracer = Tracer { mesh: &object.mesh, scene: &scene, bands: BANDS, seed: config.seed };
        let traced = tracer.trace(config.relight_rays, report);
        let brdfs = object.vertex_brdfs();
        let albedo: Vec<Vec3> = brdfs.iter().map(|l| l.diffuse).collect();
        let bounced = Some(bounce(&traced, &albedo, 0));
        Self {
            transfer: Transfer { traced: traced.into(), bounced },
            albedo,
            scanned,
            scene,
            mesh: object.mesh,
            brdfs,
            kept,
        }
    }

    /// Finds what a view shows.
    #[must_use]
    pub fn view(&self, changed: &Changed, view: &Viewpoint, config: &RealityConfig) -> CachedView {
        let (width, height) = view.size();
        let eye = view.world_from_camera.translation.as_vec3();
        let per_pixel = (GRID * GRID) as usize;
        let samples: Vec<Sample> = (0..width * height * per_pixel)
            .into_par_iter()
            .map(|s| {
                let (i, k) = (s / per_pixel, (s % per_pixel) as u32);
                let jitter = point(k, hash(i as u32, config.seed));
                let at = |cell: u32, j: f32| (cell as f32 + j) / GRID as f32 - 0.5;
                let d = view
                    .ray((i % width) as f32 + at(k % GRID, jitter[0]), (i / width) as f32 + at(k / GRID, jitter[1]));
                let Some(hit) = self.scene.closest_hit(eye, d) else {
                    return Sample::Beyond(d);
                };
                let t = self.mesh.triangles[hit.triangle as usize];
                let in_photo = (t[0] as usize) < self.kept
                    && changed.scene.removed.as_ref().is_none_or(|_| {
                        matches!(changed.scene.meet(eye, d, Side::Before), RayTarget::Body(_, _, Part::Kept))
                    });
                let w = weights(&hit);
                Sample::Surface(t, [w[1], w[2]], in_photo)
            })
            .collect();
        let mut shown = vec![false; self.mesh.positions.len()];
        for s in &samples {
            if let Sample::Surface(t, ..) = s {
                t.iter().for_each(|&v| shown[v as usize] = true);
            }
        }
        let gloss = (0..shown.len())
            .into_par_iter()
            .filter(|&v| shown[v] && !self.brdfs[v].is_diffuse())
            .map(|v| {
                let (p, n) = (self.mesh.positions[v], self.mesh.normals[v]);
                let o = (eye - p).normalize_or(n);
                let n = if n.dot(o) < 0.0 { -n } else { n };
                let r = n * (2.0 * n.dot(o)) - o;
                let mirrored = match self.scene.closest_hit(self.scene.offset_origin(p, n), r) {
                    Some(hit) => Mirrored::Vertex(self.mesh.triangles[hit.triangle as usize][0]),
                    None => Mirrored::Light(r),
                };
                let brdf = &self.brdfs[v];
                Gloss {
                    vertex: v as u32,
                    reflectance: brdf.reflectance(n.dot(o)),
                    smooth: brdf.alpha < SMOOTH,
                    mirrored,
                }
            })
            .collect();
        CachedView { samples, gloss }
    }

    /// Light that leaves every vertex towards the view under a new light.
    fn vertices(&self, view: &CachedView, light: &NewLight) -> Vec<Vec3> {
        let irradiance = self.transfer.irradiance(&light.coefficients);
        let mut out: Vec<Vec3> =
            irradiance.par_iter().zip(&self.albedo).map(|(e, a)| (*a * *e).max(Vec3::ZERO)).collect();
        let mirrored: Vec<Vec3> = view
            .gloss
            .par_iter()
            .map(|g| {
                let light = match g.mirrored {
                    Mirrored::Vertex(v) => out[v as usize],
                    Mirrored::Light(r) if g.smooth => light.environment.radiance(r),
                    Mirrored::Light(r) => Vec3::from(sh::radiance(&light.coefficients, r.as_dvec3()).map(|x| x as f32)),
                };
                g.reflectance * light.max(Vec3::ZERO)
            })
            .collect();
        for (g, m) in view.gloss.iter().zip(mirrored) {
            out[g.vertex as usize] += m;
        }
        out
    }

    /// The view under a new light, over `photo` if there is one (linear); `gain` is the view's.
    #[must_use]
    pub fn picture(&self, view: &CachedView, light: &NewLight, gain: Vec3, photo: Option<&[Vec3]>) -> Picture {
        let vertices = self.vertices(view, light);
        let per_pixel = (GRID * GRID) as usize;
        let at = |values: &[Vec3], t: &[u32; 3], w: &[f32; 2]| {
            values[t[0] as usize] * (1.0 - w[0] - w[1]) + values[t[1] as usize] * w[0] + values[t[2] as usize] * w[1]
        };
        let linear: Vec<Vec3> = view
            .samples
            .par_chunks(per_pixel)
            .enumerate()
            .map(|(i, samples)| {
                let (mut new, mut rendered, mut old, mut shared) = (Vec3::ZERO, Vec3::ZERO, Vec3::ZERO, 0u32);
                for s in samples {
                    match s {
                        Sample::Beyond(d) => rendered += light.environment.radiance(*d),
                        Sample::Surface(t, w, true) if photo.is_some() => {
                            new += at(&vertices, t, w);
                            old += at(&self.scanned, t, w);
                            shared += 1;
                        }
                        Sample::Surface(t, w, _) => rendered += at(&vertices, t, w),
                    }
                }
                let n = per_pixel as f32;
                let mut value = gain * rendered / n;
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
