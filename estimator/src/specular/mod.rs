//! Specular weights per segment (Eq. 13), and lit colours without their gloss.
//!
//! f_i of Eq. (2) is a median over views and holds some gloss itself, so w_s is found from what changes between the views
//! of one vertex: `e_j f~_ij − f_i = w_s (f_s,ij − median over j of f_s,ij)`. The diffuse part, whatever its albedo, drops
//! out, and f and f_s cannot be collinear. w_d then follows from Eq. (13) as it stands.

pub mod material;
pub mod refit;

use crate::association::Association;
use crate::numerics::robust::{SampleMean, median, robust_sigma};
use crate::numerics::sh;
use crate::rays::{Hit, RayScene};
use glam::{DVec3, Vec3};
use nalgebra::{Matrix4, Vector4};
use rayon::prelude::*;
use recordings::types::Mesh;

/// Observations of a segment that are looked at, at most.
const MOST_OBSERVATIONS: usize = 60_000;
/// Vertices that are looked at to judge a whole answer.
const JUDGED_VERTICES: usize = 5_000;
/// Views a vertex needs before its changes say anything.
const LEAST_VIEWS: usize = 3;
/// Residuals beyond this many robust standard deviations count less (Huber).
const HUBER: f64 = 1.5;
/// Rounds of reweighting.
const ROUNDS: usize = 5;
/// Errors of a picture grow with its brightness, from this share of the segment's own on.
const DARK_FLOOR: f64 = 0.03;
/// Observations of neighbouring vertices in one picture err together: so many count as one.
const CORRELATED: f64 = 30.0;
/// A weight below this many standard errors is none.
pub(crate) const SIGNIFICANT: f64 = 3.0;

/// Share of 1 that the determinant of Eq. (13) must reach, else f and f_s are collinear and all goes to w_d.
const NEARLY_COLLINEAR: f64 = 1e-3;
/// The level of the colours may raise the weight that the changes tell by this factor.
const MOST_MISSED: f64 = 4.0;
/// Share of a lit colour that is matte at least.
const LEAST_MATTE: f64 = 0.1;
/// Widths of the lobes that are tried: band l of the light is damped by exp(−width l), the Poisson kernel, whose long tail
/// is that of rough surfaces; 0 is the mirror of Eq. (13).
const LOBES: [f64; 6] = [0.0, 0.15, 0.25, 0.4, 0.6, 0.8];

/// What Eq. (13) says of one segment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gloss {
    /// Diffuse weight.
    pub w_d: f64,
    /// Specular weight for light in the mirror direction, ≥ 0.
    pub w_s: f64,
    /// Standard error of the specular weight; infinite where no observation tells it.
    pub error: f64,
    /// True if the weight stands out of its error.
    pub significant: bool,
    /// The lobe that explains the changes between views best, as an index into the widths …
    pub(crate) lobe: usize,
    /// … and its weight. A rough surface blurs the light; with a mirror in its place the weight comes out too small.
    pub(crate) lobe_weight: f64,
}

impl Gloss {
    /// Matte.
    pub const NONE: Self =
        Self { w_d: 1.0, w_s: 0.0, error: f64::INFINITY, significant: false, lobe: 0, lobe_weight: 0.0 };
}

/// What is needed to predict the reflected light.
#[derive(Clone, Copy)]
pub struct Reflection<'a> {
    /// Mesh with unit normals.
    pub mesh: &'a Mesh,
    /// The same for rays.
    pub scene: &'a RayScene,
    /// Coefficients of the light.
    pub light: &'a [[f64; 3]],
    /// Irradiance over π per vertex.
    pub irradiance: &'a [Vec3],
}

impl Reflection<'_> {
    /// The mirror direction at a surface point seen along the unit vector `to_camera`, and what stands in it; `None` if
    /// the surface is seen from behind.
    fn mirror(&self, position: Vec3, normal: Vec3, to_camera: Vec3) -> Option<(Vec3, Option<Hit>)> {
        let cosine = normal.dot(to_camera);
        if cosine <= 0.0 || !cosine.is_finite() {
            return None;
        }
        let mirror = (normal * (2.0 * cosine) - to_camera).normalize_or_zero();
        let hit = self.scene.closest_hit(self.scene.offset_origin(position, normal), mirror);
        (mirror != Vec3::ZERO).then_some((mirror, hit))
    }

    /// f_s of Eq. (13): light in the mirror direction; `None` if the scene is in the way.
    #[must_use]
    pub fn at(&self, position: Vec3, normal: Vec3, to_camera: Vec3) -> Option<[f64; 3]> {
        match self.mirror(position, normal, to_camera)? {
            (mirror, None) => Some(sh::radiance(self.light, mirror.as_dvec3()).map(|x| x.max(0.0))),
            _ => None,
        }
    }

    /// Lit colour of what stands in a mirror direction; `None` where nobody saw it from its lit side.
    fn lit_at(&self, association: &Association, mirror: Vec3, hit: &Hit) -> Option<[f64; 3]> {
        let corners = self.mesh.triangles[hit.triangle as usize].map(|i| i as usize);
        let weights = [1.0 - hit.u - hit.v, hit.u, hit.v];
        let mix = |values: &[Vec3]| corners.iter().zip(weights).map(|(&i, w)| values[i] * w).sum::<Vec3>();
        let seen = corners.iter().all(|&i| association.lit_weight[i] > 0.0);
        (seen && mix(&self.mesh.normals).dot(mirror) < 0.0)
            .then(|| mix(&association.lit_color).to_array().map(f64::from))
    }

    /// The light as each lobe blurs it.
    fn blurred(&self) -> [Vec<[f64; 3]>; LOBES.len()] {
        LOBES.map(|width| {
            let window = |k: usize| {
                let l = sh::band(k) as f64;
                libm::exp(-width * l)
            };
            self.light.iter().enumerate().map(|(k, c)| c.map(|x| x * window(k))).collect()
        })
    }
}

/// One channel of one observation beside what is predicted for it, in units of its own error.
#[derive(Debug, Clone, Copy)]
struct Sample {
    /// e_j f~_ij.
    seen: f64,
    /// f_i.
    lit: f64,
    /// Irradiance E_i.
    irradiance: f64,
    channel: usize,
    /// f_s for every lobe.
    mirror: [f64; LOBES.len()],
    /// The same less its median over the vertex's views.
    change: [f64; LOBES.len()],
    robust: f64,
}

/// Specular weights of every segment.
#[must_use]
pub fn fit(reflection: &Reflection, association: &Association, segment: &[u32], segments: usize) -> Vec<Gloss> {
    let lights = reflection.blurred();
    let mut of_segment: Vec<Vec<usize>> = vec![Vec::new(); segments];
    for (i, s) in segment.iter().enumerate() {
        let views = association.offsets[i + 1] - association.offsets[i];
        if views as usize >= LEAST_VIEWS && association.lit_weight[i] > 0.0 {
            of_segment[*s as usize].push(i);
        }
    }
    of_segment
        .into_iter()
        .map(|vertices| {
            let total: usize =
                vertices.iter().map(|&i| (association.offsets[i + 1] - association.offsets[i]) as usize).sum();
            let stride = total.div_ceil(MOST_OBSERVATIONS).max(1);
            let chosen: Vec<usize> = vertices.into_iter().step_by(stride).collect();
            let seen: Vec<View> =
                chosen.par_iter().flat_map_iter(|&i| views(reflection, &lights, association, i, false)).collect();
            fit_segment(&seen)
        })
        .collect()
}

/// One observation of a vertex whose mirror direction is free: what is seen, f_i, f_s for every lobe and its change.
struct View {
    seen: [f64; 3],
    lit: [f64; 3],
    irradiance: [f64; 3],
    mirror: [[f64; 3]; LOBES.len()],
    change: [[f64; 3]; LOBES.len()],
    weight: f64,
}

/// The observations of one vertex whose mirror direction is free; with `blocked`, those too whose mirror shows the scene,
/// as far as it was seen itself. Eq. (13) drops these, but they hold gloss like the others.
fn views(
    reflection: &Reflection,
    lights: &[Vec<[f64; 3]>; LOBES.len()],
    association: &Association,
    vertex: usize,
    blocked: bool,
) -> Vec<View> {
    let (position, normal) = (reflection.mesh.positions[vertex], reflection.mesh.normals[vertex]);
    let lit = association.lit_color[vertex].to_array().map(f64::from);
    let irradiance = reflection.irradiance[vertex].to_array().map(f64::from);
    let range = association.offsets[vertex] as usize..association.offsets[vertex + 1] as usize;
    let mut views: Vec<View> = association.observations[range]
        .iter()
        .filter_map(|o| {
            let camera = association.views[o.keyframe as usize].world_from_camera.translation;
            let to_camera = (camera - position.as_dvec3()).normalize_or(DVec3::Z).as_vec3();
            let mirror = match reflection.mirror(position, normal, to_camera)? {
                (direction, None) => {
                    lights.each_ref().map(|l| sh::radiance(l, direction.as_dvec3()).map(|x| x.max(0.0)))
                }
                (direction, Some(hit)) if blocked => [reflection.lit_at(association, direction, &hit)?; LOBES.len()],
                _ => return None,
            };
            Some(View {
                seen: o.color.map(f64::from),
                lit,
                irradiance,
                mirror,
                change: mirror,
                weight: f64::from(o.weight),
            })
        })
        .collect();
    if views.len() < LEAST_VIEWS {
        return Vec::new();
    }
    for b in 0..LOBES.len() {
        for c in 0..3 {
            let middle = median(views.iter().map(|p| p.mirror[b][c])).unwrap_or(0.0);
            views.iter_mut().for_each(|p| p.change[b][c] -= middle);
        }
    }
    views
}

/// How well the keyframes are predicted at evenly strided vertices.
#[derive(Debug, Clone)]
pub struct Prediction {
    /// Sum of the relative errors of a vertex's views, large ones capped, and their number.
    vertices: Vec<(f64, f64)>,
}

impl Prediction {
    /// Mean relative error of all views.
    #[must_use]
    pub fn error(&self) -> f64 {
        let (sum, views) = self.vertices.iter().fold((0.0, 0.0), |(s, n), v| (s + v.0, n + v.1));
        sum / f64::max(views, 1.0)
    }

    /// How much lower the mean error of a vertex is than in `other`, in standard errors of that difference.
    #[must_use]
    pub fn gain_over(&self, other: &Self) -> f64 {
        let both = self.vertices.iter().zip(&other.vertices).filter(|(a, _)| a.1 > 0.0);
        let gains: Vec<f64> = both.map(|(a, b)| (b.0 - a.0) / a.1).collect();
        let SampleMean { mean, error } = SampleMean::of(&gains);
        if error > 0.0 { mean / error } else { 0.0 }
    }
}

/// How well `albedo E + gloss` per segment predicts what the keyframes show.
#[must_use]
pub fn predict(
    reflection: &Reflection,
    association: &Association,
    segment: &[u32],
    albedo: &[[f64; 3]],
    gloss: &[Gloss],
) -> Prediction {
    let lights = reflection.blurred();
    let stride = segment.len().div_ceil(JUDGED_VERTICES).max(1);
    let judged: Vec<usize> = (0..segment.len()).step_by(stride).collect();
    let vertices = judged.par_iter().map(|&i| {
        let (gloss, albedo) = (gloss[segment[i] as usize], albedo[segment[i] as usize]);
        let weight = if gloss.significant { gloss.lobe_weight } else { 0.0 };
        let (mut sum, mut count) = (0.0, 0.0);
        for v in views(reflection, &lights, association, i, true) {
            let size = (v.lit[0] + v.lit[1] + v.lit[2]) / 3.0;
            for (c, albedo) in albedo.iter().enumerate() {
                let predicted = albedo * v.irradiance[c] + weight * v.mirror[gloss.lobe][c];
                sum += ((v.seen[c] - predicted).abs() / size.max(f64::MIN_POSITIVE)).min(1.0);
                count += 1.0;
            }
        }
        (sum, count)
    });
    Prediction { vertices: vertices.collect() }
}

fn fit_segment(views: &[View]) -> Gloss {
    // Errors of a picture grow with its brightness; all channels of a segment count alike.
    let size = median(views.iter().map(|p| (p.lit[0] + p.lit[1] + p.lit[2]) / 3.0));
    let Some(size) = size.filter(|s| *s > 0.0) else { return Gloss::NONE };
    let sample = |p: &View, c: usize| {
        let scale = libm::sqrt(p.weight.max(1e-3)) / (p.lit[c] + DARK_FLOOR * size);
        Sample {
            seen: p.seen[c] * scale,
            lit: p.lit[c] * scale,
            irradiance: p.irradiance[c] * scale,
            channel: c,
            mirror: p.mirror.map(|m| m[c] * scale),
            change: p.change.map(|m| m[c] * scale),
            robust: 1.0,
        }
    };
    let mut samples: Vec<Sample> = views.iter().flat_map(|p| [0, 1, 2].map(|c| sample(p, c))).collect();
    let spread = robust_sigma(samples.iter().map(|s| (s.seen - s.lit).abs())) + 1e-9;
    let mut best: Option<(f64, Gloss)> = None;
    for lobe in 0..LOBES.len() {
        let Some((weight, error)) = change_weight(&mut samples, lobe) else { continue };
        // Loss in units that are the same for every lobe.
        let loss: f64 =
            samples.iter().map(|s| huber((s.seen - s.lit - weight.max(0.0) * s.change[lobe]).abs() / spread)).sum();
        let gloss = Gloss {
            error,
            significant: weight > SIGNIFICANT * error,
            lobe,
            lobe_weight: weight.max(0.0),
            ..Gloss::NONE
        };
        if best.is_none_or(|(least, _)| loss < least) {
            best = Some((loss, gloss));
        }
    }
    let Some((_, mut gloss)) = best else { return Gloss::NONE };
    if gloss.significant {
        let mut least = f64::INFINITY;
        let told = gloss;
        for lobe in 0..LOBES.len() {
            let Some((level, error, loss)) = level_weight(&mut samples, lobe, spread) else { continue };
            if loss < least && level > told.lobe_weight + SIGNIFICANT * error {
                least = loss;
                gloss.lobe = lobe;
                gloss.lobe_weight = level.min(MOST_MISSED * told.lobe_weight);
            }
        }
    }
    let (w_d, w_s) = mirror_weights(&samples, &gloss);
    Gloss { w_d, w_s, ..gloss }
}

/// Huber's loss of a residual in standard deviations.
fn huber(residual: f64) -> f64 {
    let r = residual / HUBER;
    if r < 1.0 { r * r } else { 2.0 * r - 1.0 }
}

/// Robust weight of a lobe from what changes between views, with its standard error.
fn change_weight(samples: &mut [Sample], lobe: usize) -> Option<(f64, f64)> {
    samples.iter_mut().for_each(|s| s.robust = 1.0);
    let (mut weight, mut error) = (0.0, f64::INFINITY);
    for _ in 0..ROUNDS {
        let (square, cross) = samples.iter().fold((0.0, 0.0), |(square, cross), s| {
            let change = s.change[lobe];
            (square + s.robust * change * change, cross + s.robust * change * (s.seen - s.lit))
        });
        if square <= 0.0 {
            return None;
        }
        weight = cross / square;
        let off = |s: &Sample| (s.seen - s.lit - weight.max(0.0) * s.change[lobe]).abs();
        let sigma = robust_sigma(samples.iter().map(off)) + 1e-9;
        samples.iter_mut().for_each(|s| s.robust = HUBER * sigma / off(s).max(HUBER * sigma));
        error = sigma * libm::sqrt(CORRELATED / square);
    }
    Some((weight, error))
}

/// Robust weight of a lobe from the level of the colours: `e_j f~_ij = a_c E_i + w f_s,ij` with one albedo per channel. What
/// is the same in all views shows here only, and dark channels show it best. Light that is too smooth for the changes
/// between views makes their weight too small; the level hardly minds.
fn level_weight(samples: &mut [Sample], lobe: usize, spread: f64) -> Option<(f64, f64, f64)> {
    samples.iter_mut().for_each(|s| s.robust = 1.0);
    let (mut weight, mut error, mut loss) = (0.0, f64::INFINITY, f64::INFINITY);
    for _ in 0..ROUNDS {
        let (mut normal, mut target) = (Matrix4::<f64>::zeros(), Vector4::<f64>::zeros());
        for s in samples.iter() {
            let (c, e, m) = (s.channel, s.irradiance, s.mirror[lobe]);
            normal[(c, c)] += s.robust * e * e;
            normal[(c, 3)] += s.robust * e * m;
            normal[(3, 3)] += s.robust * m * m;
            target[c] += s.robust * e * s.seen;
            target[3] += s.robust * m * s.seen;
        }
        for c in 0..3 {
            normal[(3, c)] = normal[(c, 3)];
        }
        let inverse = normal.try_inverse()?;
        let x = inverse * target;
        let off = |s: &Sample| (s.seen - x[s.channel] * s.irradiance - x[3] * s.mirror[lobe]).abs();
        let sigma = robust_sigma(samples.iter().map(off)) + 1e-9;
        samples.iter_mut().for_each(|s| s.robust = HUBER * sigma / off(s).max(HUBER * sigma));
        (weight, error) = (x[3], sigma * libm::sqrt(CORRELATED * inverse[(3, 3)].max(0.0)));
        loss = samples.iter().map(|s| huber(off(s) / spread)).sum::<f64>() / samples.len() as f64;
    }
    Some((weight, error, loss))
}

/// w_d and w_s of Eq. (13), both ≥ 0, for what the lobe predicts: light that is known smoother than it is makes the weight
/// of a mirror too small against noisy colours, but the lobe's own weight has been told by level and change together.
fn mirror_weights(samples: &[Sample], gloss: &Gloss) -> (f64, f64) {
    let (mut ff, mut fs, mut ss, mut fy, mut sy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for s in samples {
        let (mirror, seen) = (s.mirror[0], s.lit + gloss.lobe_weight * s.mirror[gloss.lobe]);
        ff += s.lit * s.lit;
        fs += s.lit * mirror;
        ss += mirror * mirror;
        fy += s.lit * seen;
        sy += mirror * seen;
    }
    let determinant = ff * ss - fs * fs;
    if ff <= 0.0 || determinant <= NEARLY_COLLINEAR * ff * ss {
        return (if ff > 0.0 { fy / ff } else { 1.0 }, 0.0);
    }
    let (w_d, w_s) = ((fy * ss - sy * fs) / determinant, (sy * ff - fy * fs) / determinant);
    if w_s < 0.0 {
        (fy / ff, 0.0)
    } else if w_d < 0.0 {
        (0.0, sy / ss)
    } else {
        (w_d, w_s)
    }
}

/// Lit colours without the gloss that their median holds: the median over views of what is seen less its gloss.
#[must_use]
pub fn clean(reflection: &Reflection, association: &Association, segment: &[u32], gloss: &[Gloss]) -> Vec<Vec3> {
    let lights = reflection.blurred();
    (0..segment.len())
        .into_par_iter()
        .map(|i| {
            let lit = association.lit_color[i];
            let gloss = gloss[segment[i] as usize];
            if !gloss.significant {
                return lit;
            }
            let views = views(reflection, &lights, association, i, true);
            if views.is_empty() {
                return lit;
            }
            let matte = [0, 1, 2].map(|c| {
                let left = |p: &View| p.seen[c] - gloss.lobe_weight * p.mirror[gloss.lobe][c];
                // Something stays: nothing is all gloss to the median of its views.
                median(views.iter().map(left)).unwrap_or(0.0).max(LEAST_MATTE * f64::from(lit[c])) as f32
            });
            Vec3::from_array(matte)
        })
        .collect()
}
