//! One picture of a changed scene: differential rendering (Debevec, SIGGRAPH 1998) over a photo, or over the model's own
//! picture.
//!
//! `picture = photo · (render with) / (render without)` where a surface stays in view: the same as
//! `photo + gain · (with − without)` when the photo itself gives the surface's colour, so that texture and noise
//! of the photo scale with its light. What was not in view before is rendered with the keyframe's gain.

use crate::numerics::random::hash;
use crate::rays::Hit;
use crate::render::before_after_scene::{Body, Part, Side, SurfacePoint};
use crate::render::change::{Changed, ratio, rays};
use crate::render::objects::object::interpolate;
use crate::render::sampling::point;
use firmware_config::RealityConfig;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use recordings::types::{CameraModel, Pose};
use std::f32::consts::TAU;

/// Largest factor of the texture where something was removed.
const MOST_UNCOVERED: f32 = 1.5;

/// A camera with a pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Viewpoint {
    /// The camera.
    pub camera: CameraModel,
    /// Camera-to-world pose.
    pub world_from_camera: Pose,
    /// Picture = gain · radiance, per channel.
    pub gain: Vec3,
}

impl Viewpoint {
    /// Pixels per row and rows.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.camera.intrinsics.width as usize, self.camera.intrinsics.height as usize)
    }

    fn eye(&self) -> Vec3 {
        self.world_from_camera.translation.as_vec3()
    }

    /// Unit direction through a pixel.
    #[must_use]
    pub fn ray(&self, u: f32, v: f32) -> Vec3 {
        let d = self.world_from_camera.rotation * self.camera.unproject(f64::from(u), f64::from(v));
        d.normalize().as_vec3()
    }
}

/// A rendered picture: linear, gain applied, row-major; `touched` where it is not what it was put over.
#[derive(Debug, Clone)]
pub struct Picture {
    /// Pixels.
    pub linear: Vec<Vec3>,
    /// Changed pixels.
    pub touched: Vec<bool>,
}

/// The kept and the removed surface at a pixel's centre.
#[derive(Debug, Clone, Copy)]
struct Ground {
    kept: Option<(Hit, SurfacePoint)>,
    removed: bool,
}

/// The model as scanned: the base picture where there is no photo.
#[must_use]
pub fn model(changed: &Changed, view: &Viewpoint, config: &RealityConfig) -> Vec<Vec3> {
    let (width, height) = view.size();
    let tuning = &config.tuning.compositing;
    (0..width * height)
        .into_par_iter()
        .map(|i| {
            let seed = hash(i as u32, config.seed ^ 0x30de);
            let mut sum = Vec3::ZERO;
            for s in 0..tuning.model_samples {
                let p = within_pixel(i, width, s, seed, config);
                sum += surface(changed, view.eye(), view.ray(p.x, p.y), Side::Before, hash(seed, s), tuning.gloss_rays);
            }
            view.gain * sum / tuning.model_samples as f32
        })
        .collect()
}

/// Light that comes back along a view ray, gloss of reconstructed surfaces included.
fn surface(changed: &Changed, eye: Vec3, d: Vec3, side: Side, seed: u32, gloss_rays: u32) -> Vec3 {
    use crate::render::before_after_scene::RayTarget;
    let scene = &changed.scene;
    if let Some(source) = scene.source_along(eye, d, side) {
        return source;
    }
    match scene.meet(eye, d, side) {
        RayTarget::Beyond => changed.beyond(d),
        RayTarget::Body(body, hit, part) => {
            let t = body.object.mesh.triangles[hit.triangle as usize];
            let light = interpolate(if side == Side::After { &body.after } else { &body.radiance }, t, &hit);
            let light = light * changed.detail(body, part, &hit);
            let brdf = body.object.brdf(&hit);
            if brdf.is_diffuse() {
                return light;
            }
            let spot = body.surface_point(eye, d, &hit);
            light + scene.reflected(&spot, &brdf, d, side, 1, seed, gloss_rays, 0)
        }
    }
}

/// A position within the footprint of pixel `i`: Gaussian, as the lens and the pixel blur.
fn within_pixel(i: usize, width: usize, sample: u32, seed: u32, config: &RealityConfig) -> Vec2 {
    let center = Vec2::new((i % width) as f32, (i / width) as f32);
    let [u, v] = point(sample, seed);
    let r = config.camera_blur_px as f32 * (-2.0 * libm::logf(1.0 - u)).sqrt();
    let (s, c) = libm::sincosf(TAU * v);
    center + Vec2::new(c, s) * r
}

/// Renders the change over `base` (linear, `[pixel]`, as the camera gave it).
#[must_use]
pub fn compose(changed: &Changed, view: &Viewpoint, base: &[Vec3], config: &RealityConfig) -> Picture {
    let (width, height) = view.size();
    let eye = view.eye();
    let scene = &changed.scene;
    let ground: Vec<Ground> = (0..width * height)
        .into_par_iter()
        .map(|i| {
            let d = view.ray((i % width) as f32, (i / width) as f32);
            let kept = scene.kept.bvh.closest_hit(eye, d);
            let removed = scene.removed.as_ref().and_then(|b| b.bvh.closest_hit(eye, d));
            let removed = removed.is_some_and(|r| kept.is_none_or(|k| r.distance < k.distance));
            Ground { kept: kept.map(|k| (k, scene.kept.surface_point(eye, d, &k))), removed }
        })
        .collect();
    let uncovered = uncovered(&ground, width, height, config.removal_margin_px);
    let light = lighting(changed, &ground, &uncovered, width, height, config);
    let tuning = &config.tuning.compositing;
    let (fade_from, fade_to) = (tuning.fade_from as f32, tuning.fade_to as f32);
    let linear: Vec<(Vec3, bool)> = (0..width * height)
        .into_par_iter()
        .map(|i| {
            let mut value = base[i];
            let mut touched = false;
            // Where light changes by much, the photo mostly shows the contact itself: the surface is rendered instead.
            let deep =
                light.ratio[i].map_or(0.0, |r| ((r.max_element() - fade_from) / (fade_to - fade_from)).clamp(0.0, 1.0));
            let share = uncovered[i].max(deep);
            if let Some(ratio) = light.ratio[i].filter(|r| (*r - 1.0).abs().max_element() > tuning.no_change as f32) {
                value *= ratio;
                touched = true;
            }
            if share > 0.0 {
                let behind = match &ground[i].kept {
                    Some((hit, _)) => {
                        let t = scene.kept.object.mesh.triangles[hit.triangle as usize];
                        // Texels beside what was removed may show it.
                        let (least, most) = (Vec3::splat(1.0 / MOST_UNCOVERED), Vec3::splat(MOST_UNCOVERED));
                        let detail = changed.detail(&scene.kept, Part::Kept, hit).clamp(least, most);
                        interpolate(&changed.reflectance, t, hit) * detail * light.irradiance[i]
                    }
                    None => changed.beyond(view.ray((i % width) as f32, (i / width) as f32)),
                };
                value = value.lerp(view.gain * behind, share);
                touched = true;
            }
            let (color, cover) = inserted_radiance(changed, view, i, config);
            if cover > 0.0 {
                value = value * (1.0 - cover) + view.gain * color;
                touched = true;
            }
            (value, touched)
        })
        .collect();
    Picture { linear: linear.iter().map(|p| p.0).collect(), touched: linear.iter().map(|p| p.1).collect() }
}

/// Share `[pixel]` that a removed object covered, blur included: 1 inside, falling off over the margin (pixels).
fn uncovered(ground: &[Ground], width: usize, height: usize, margin: u32) -> Vec<f32> {
    let mut share: Vec<f32> = ground.iter().map(|g| f32::from(u8::from(g.removed))).collect();
    if !ground.iter().any(|g| g.removed) {
        return share;
    }
    let reach = margin as i32;
    let outline: Vec<f32> = (0..share.len())
        .into_par_iter()
        .map(|i| {
            let (x, y) = ((i % width) as i32, (i / width) as i32);
            let mut nearest = f32::INFINITY;
            for dy in -reach..=reach {
                for dx in -reach..=reach {
                    let (qx, qy) = (x + dx, y + dy);
                    if qx >= 0
                        && qy >= 0
                        && qx < width as i32
                        && qy < height as i32
                        && ground[qy as usize * width + qx as usize].removed
                    {
                        nearest = nearest.min(((dx * dx + dy * dy) as f32).sqrt());
                    }
                }
            }
            (1.5 * (1.0 - nearest / (reach as f32 + 1.0))).clamp(0.0, 1.0)
        })
        .collect();
    share.iter_mut().zip(outline).for_each(|(s, o)| *s = s.max(o));
    share
}

/// Light on the kept surface behind every pixel.
struct Lighting {
    /// Irradiance after / before; `None` where the change does not reach.
    ratio: Vec<Option<Vec3>>,
    /// Irradiance over π after, where the surface was uncovered or its light changes.
    irradiance: Vec<Vec3>,
}

fn lighting(
    changed: &Changed,
    ground: &[Ground],
    uncovered: &[f32],
    width: usize,
    height: usize,
    config: &RealityConfig,
) -> Lighting {
    let scene = &changed.scene;
    let triangles = &scene.kept.object.mesh.triangles;
    let reached = |hit: &Hit| {
        let t = triangles[hit.triangle as usize];
        t.iter().all(|&v| changed.reached[v as usize])
    };
    let raw: Vec<(Option<Vec3>, Vec3)> = ground
        .par_iter()
        .enumerate()
        .map(|(i, g)| {
            let Some((hit, spot)) = &g.kept else {
                return (None, Vec3::ZERO);
            };
            let seed = hash(i as u32, config.seed ^ 0x9a7e);
            let after = if uncovered[i] > 0.0 {
                scene.gather(spot, Side::After, config.pixel_rays / 4, 0, seed)
            } else {
                Vec3::ZERO
            };
            if g.removed || !reached(hit) {
                return (None, after);
            }
            let before = interpolate(&changed.irradiance, triangles[hit.triangle as usize], hit);
            let change =
                scene.change(spot, rays(scene.reach(spot), config.pixel_change_rays, &config.tuning.compositing), seed);
            let after = if uncovered[i] > 0.0 { after } else { (before + change).max(Vec3::ZERO) };
            (Some(ratio(before, change)), after)
        })
        .collect();
    let half = config.tuning.compositing.filter_px as i32;
    let small = config.tuning.compositing.small_change as f32;
    // Light varies slowly along a surface: neighbours on the same plane share their samples.
    let filtered: Vec<(Option<Vec3>, Vec3)> = (0..raw.len())
        .into_par_iter()
        .map(|i| {
            let Some((_, spot)) = &ground[i].kept else {
                return (None, Vec3::ZERO);
            };
            if raw[i].0.is_none() && uncovered[i] <= 0.0 {
                return (None, Vec3::ZERO);
            }
            let (x, y) = ((i % width) as i32, (i / width) as i32);
            let (mut r, mut wr, mut e, mut we) = (Vec3::ZERO, 0.0, Vec3::ZERO, 0.0);
            for dy in -half..=half {
                for dx in -half..=half {
                    let (qx, qy) = (x + dx, y + dy);
                    if qx < 0 || qy < 0 || qx >= width as i32 || qy >= height as i32 {
                        continue;
                    }
                    let j = qy as usize * width + qx as usize;
                    let Some((hit, other)) = &ground[j].kept else {
                        continue;
                    };
                    let off = (other.origin - spot.origin).dot(spot.normal).abs();
                    if other.normal.dot(spot.normal) < 0.9 || off > 0.004 * hit.distance {
                        continue;
                    }
                    if let Some(ratio) = raw[j].0 {
                        (r, wr) = (r + ratio, wr + 1.0);
                    }
                    if uncovered[j] > 0.0 || raw[j].0.is_some() {
                        (e, we) = (e + raw[j].1, we + 1.0);
                    }
                }
            }
            (
                raw[i].0.filter(|_| wr > 0.0).map(|_| shrink_small_change(r / wr, small)),
                if we > 0.0 { e / we } else { raw[i].1 },
            )
        })
        .collect();
    Lighting { ratio: filtered.iter().map(|f| f.0).collect(), irradiance: filtered.iter().map(|f| f.1).collect() }
}

/// A ratio of light with small changes shrunk towards 1.
fn shrink_small_change(ratio: Vec3, small: f32) -> Vec3 {
    let d = ratio - 1.0;
    d * d * d / (d * d + small * small) + 1.0
}

/// Inserted objects in a pixel: their radiance times the share of the pixel they cover, and that share.
fn inserted_radiance(changed: &Changed, view: &Viewpoint, i: usize, config: &RealityConfig) -> (Vec3, f32) {
    let Some(body) = &changed.scene.inserted else {
        return (Vec3::ZERO, 0.0);
    };
    let (width, _) = view.size();
    let seed = hash(i as u32, config.seed ^ 0xf407);
    let rays = (config.pixel_rays / config.pixel_samples).max(2);
    let (mut color, mut cover) = (Vec3::ZERO, 0u32);
    for s in 0..config.pixel_samples {
        let p = within_pixel(i, width, s, seed, config);
        let d = view.ray(p.x, p.y);
        let Some(hit) = visible(changed, body, view.eye(), d) else {
            // Most pixels are far from every object: a few samples suffice.
            if s == 3 && cover == 0 && !near(changed, view, p) {
                break;
            }
            continue;
        };
        cover += 1;
        let brdf = body.object.brdf(&hit);
        let spot = body.surface_point(view.eye(), d, &hit);
        let mut sample = Vec3::ZERO;
        if brdf.diffuse != Vec3::ZERO {
            sample += brdf.diffuse * changed.scene.gather(&spot, Side::After, rays, s * rays, seed);
        }
        if !brdf.is_diffuse() {
            sample += changed.scene.reflected(&spot, &brdf, d, Side::After, 0, seed, rays, s * rays);
        }
        color += recordable(sample, view.gain, config.tuning.compositing.brightest as f32);
    }
    let n = config.pixel_samples as f32;
    (color / n, cover as f32 / n)
}

/// Light that a camera with `gain` can record, at most `brightest` times white: at the rim of a mirror the whole scene shrinks to
/// less than a pixel, and one of its samples that meets a lamp, or the light behind a gap of the scan, would make all of it white.
fn recordable(sample: Vec3, gain: Vec3, brightest: f32) -> Vec3 {
    let most = (sample * gain).max_element();
    if most > brightest { sample * (brightest / most) } else { sample }
}

/// The hit of a view ray on an inserted object that no kept surface and no lamp hides.
fn visible(changed: &Changed, body: &Body, eye: Vec3, d: Vec3) -> Option<Hit> {
    let hit = body.bvh.closest_hit(eye, d)?;
    let lamp = changed.scene.local.lamp_along(eye, d).is_some_and(|(distance, _)| distance < hit.distance);
    (!lamp && !changed.scene.kept.bvh.occluded_within(eye, d, hit.distance)).then_some(hit)
}

/// True if an inserted object is near the ray of pixel `p`.
fn near(changed: &Changed, view: &Viewpoint, p: Vec2) -> bool {
    let d = view.ray(p.x, p.y);
    let slack = 4.0 / view.camera.intrinsics.fx as f32;
    changed.scene.changes.iter().any(|b| {
        let to = b.center - view.eye();
        let along = to.dot(d);
        let radius = b.radius + slack * along.max(0.0);
        to.length_squared() <= radius * radius
            || (along > 0.0 && to.length_squared() - along * along <= radius * radius)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::tiny;
    use crate::numerics::sh::even_directions;
    use crate::render::change::change;
    use crate::render::inpainting::geometry::cut;
    use crate::render::lighting::environment::Environment;
    use crate::render::lighting::observed_background::ObservedBackground;
    use crate::render::objects::material::Material;
    use crate::render::objects::object::Object;
    use glam::{DQuat, DVec3};
    use recordings::types::{Distortion, Intrinsics, Mesh};

    /// A mirror ball of radius 0.15 m, 0.3 m above the origin.
    fn mirror_ball() -> Object {
        const ROWS: u32 = 24;
        const COLUMNS: u32 = 48;
        let normal = |i: u32| {
            let (st, ct) = libm::sincosf(std::f32::consts::PI * (i / COLUMNS) as f32 / ROWS as f32);
            let (sp, cp) = libm::sincosf(TAU * (i % COLUMNS) as f32 / COLUMNS as f32);
            Vec3::new(st * cp, st * sp, ct)
        };
        let normals: Vec<Vec3> = (0..(ROWS + 1) * COLUMNS).map(normal).collect();
        let quad = |i: u32| {
            let right = i - i % COLUMNS + (i + 1) % COLUMNS;
            [[i, i + COLUMNS, right], [right, i + COLUMNS, right + COLUMNS]]
        };
        let positions = normals.iter().map(|n| *n * 0.15 + Vec3::Z * 0.3).collect();
        let mesh = Mesh { positions, normals, triangles: (0..ROWS * COLUMNS).flat_map(quad).collect() };
        let material = vec![0; mesh.triangles.len()];
        let mirror = Material { metallic: 1.0, roughness: 0.0, specular: 1.0, ..Material::default() };
        Object { mesh, material, materials: vec![mirror], ..Object::default() }
    }

    /// White pixels whose neighbours are all darker than mid-grey.
    fn specks(config: &RealityConfig) -> usize {
        let mut estimate = tiny();
        estimate.keyframes.clear();
        // Lamps of a third of a degree all around: a mirror shows each in less than a pixel.
        let lamps: Vec<Vec3> = even_directions(150).iter().map(|d| d.as_vec3()).collect();
        let light =
            Environment::from_fn(|d| Vec3::splat(if lamps.iter().any(|l| l.dot(d) > 0.99998) { 900.0 } else { 0.2 }));
        let whole = cut(&estimate.mesh, &[false; 3], &config.tuning.inpainting);
        let changed = change(&estimate, (light, ObservedBackground::default()), whole, &[mirror_ball()], config);
        let intrinsics = Intrinsics { width: 60, height: 60, fx: 150.0, fy: 150.0, cx: 29.5, cy: 29.5 };
        let view = Viewpoint {
            camera: CameraModel { intrinsics, distortion: Distortion::default() },
            world_from_camera: Pose::new(
                DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2),
                DVec3::new(0.0, -1.0, 0.3),
            ),
            gain: Vec3::ONE,
        };
        let picture = compose(&changed, &view, &vec![Vec3::splat(0.2); 3600], config).linear;
        let inside = (0..3600usize).filter(|i| (1..59).contains(&(i % 60)) && (1..59).contains(&(i / 60)));
        let lone = |i: usize| {
            let around = [i - 61, i - 60, i - 59, i - 1, i + 1, i + 59, i + 60, i + 61];
            picture[i].y >= 1.0 && around.iter().all(|j| picture[*j].y < 0.5)
        };
        inside.filter(|i| lone(*i)).count()
    }

    #[test]
    fn small_lamps_make_no_white_specks_in_a_mirror() {
        let mut config = RealityConfig::default();
        assert_eq!(specks(&config), 0);
        config.tuning.compositing.brightest = 1e9;
        assert!(specks(&config) > 0, "these lamps make specks where they are not held back");
    }
}
