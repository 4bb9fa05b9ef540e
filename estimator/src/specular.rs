//! Specular weights per segment (Eq. 13), and lit colours without their gloss.
//!
//! f_i of Eq. (2) is a median over views and holds some gloss itself, so w_s is found from what changes between the views
//! of one vertex: `e_j f~_ij − f_i = w_s (f_s,ij − median over j of f_s,ij)`. The diffuse part, whatever its albedo, drops
//! out, and f and f_s cannot be collinear. w_d then follows from Eq. (13) as it stands.

use crate::association::{Association, Observation};
use crate::scene::Scene;
use crate::sh;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use recordings::types::Mesh;

/// Observations of a segment that are looked at, at most.
const MOST_OBSERVATIONS: usize = 60_000;
/// Views a vertex needs before its changes say anything.
const LEAST_VIEWS: usize = 3;
/// Residuals beyond this many robust standard deviations count less (Huber).
const HUBER: f64 = 1.5;
/// Rounds of reweighting.
const ROUNDS: usize = 5;
/// Observations of neighbouring vertices in one picture err together: so many count as one.
const CORRELATED: f64 = 30.0;
/// A weight below this many standard errors is none.
const SIGNIFICANT: f64 = 3.0;

/// What Eq. (13) says of one segment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gloss {
    /// Diffuse weight.
    pub w_d: f64,
    /// Specular weight, ≥ 0.
    pub w_s: f64,
    /// Standard error of `w_s`; infinite where no observation tells it.
    pub error: f64,
    /// True if the weight stands out of its error.
    pub significant: bool,
}

impl Gloss {
    /// Matte.
    pub const NONE: Self = Self { w_d: 1.0, w_s: 0.0, error: f64::INFINITY, significant: false };
}

/// What is needed to predict the reflected light.
#[derive(Clone, Copy)]
pub struct Reflection<'a> {
    /// Mesh with unit normals.
    pub mesh: &'a Mesh,
    /// The same for rays.
    pub scene: &'a Scene,
    /// Coefficients of the light.
    pub light: &'a [[f64; 3]],
}

impl Reflection<'_> {
    /// f_s at a surface point seen along the unit vector `to_camera`: light in the mirror direction; `None` if the scene
    /// is in the way, or the surface is seen from behind.
    #[must_use]
    pub fn at(&self, position: Vec3, normal: Vec3, to_camera: Vec3) -> Option<[f64; 3]> {
        let cosine = normal.dot(to_camera);
        if cosine <= 0.0 || !cosine.is_finite() {
            return None;
        }
        let mirror = (normal * (2.0 * cosine) - to_camera).normalize_or_zero();
        if mirror == Vec3::ZERO || self.scene.occluded(self.scene.offset_origin(position, normal), mirror) {
            return None;
        }
        Some(sh::radiance(self.light, mirror.as_dvec3()).map(|x| x.max(0.0)))
    }
}

/// One observation beside what is predicted for it.
#[derive(Debug, Clone, Copy)]
struct Pair {
    seen: [f64; 3],
    lit: [f64; 3],
    /// f_s and f_s less its median over the vertex's views.
    mirror: [f64; 3],
    change: [f64; 3],
    weight: f64,
}

/// Specular weights of every segment.
#[must_use]
pub fn fit(reflection: &Reflection, association: &Association, segment: &[u32], segments: usize) -> Vec<Gloss> {
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
            let pairs: Vec<Pair> = chosen.par_iter().flat_map_iter(|&i| pairs(reflection, association, i)).collect();
            fit_segment(&pairs)
        })
        .collect()
}

/// The observations of one vertex whose mirror direction is free.
fn pairs(reflection: &Reflection, association: &Association, vertex: usize) -> Vec<Pair> {
    let (position, normal) = (reflection.mesh.positions[vertex], reflection.mesh.normals[vertex]);
    let lit = association.lit_color[vertex].to_array().map(f64::from);
    let range = association.offsets[vertex] as usize..association.offsets[vertex + 1] as usize;
    let observations: &[Observation] = &association.observations[range];
    let mut pairs: Vec<Pair> = observations
        .iter()
        .filter_map(|o| {
            let camera = association.views[o.keyframe as usize].world_from_camera.translation;
            let to_camera = (camera - position.as_dvec3()).normalize_or(DVec3::Z).as_vec3();
            let mirror = reflection.at(position, normal, to_camera)?;
            Some(Pair { seen: o.color.map(f64::from), lit, mirror, change: mirror, weight: f64::from(o.weight) })
        })
        .collect();
    if pairs.len() < LEAST_VIEWS {
        return Vec::new();
    }
    for c in 0..3 {
        let middle = median(pairs.iter().map(|p| p.mirror[c]).collect());
        pairs.iter_mut().for_each(|p| p.change[c] -= middle);
    }
    pairs
}

/// One channel of one observation, in units of its own error.
struct Sample {
    seen: f64,
    lit: f64,
    mirror: f64,
    change: f64,
    robust: f64,
}

fn fit_segment(pairs: &[Pair]) -> Gloss {
    // Errors of a picture grow with its brightness; all channels of a segment count alike.
    let size = median(pairs.iter().map(|p| (p.lit[0] + p.lit[1] + p.lit[2]) / 3.0).collect());
    if pairs.is_empty() || size.is_nan() || size <= 0.0 {
        return Gloss::NONE;
    }
    let sample = |p: &Pair, c: usize| {
        let scale = libm::sqrt(p.weight.max(1e-3)) / (p.lit[c] + 0.1 * size);
        let [seen, lit, mirror, change] = [p.seen, p.lit, p.mirror, p.change].map(|x| x[c] * scale);
        Sample { seen, lit, mirror, change, robust: 1.0 }
    };
    let mut samples: Vec<Sample> = pairs.iter().flat_map(|p| [0, 1, 2].map(|c| sample(p, c))).collect();
    let (mut w_s, mut error) = (0.0, f64::INFINITY);
    for _ in 0..ROUNDS {
        let (square, cross) = samples.iter().fold((0.0, 0.0), |(square, cross), s| {
            (square + s.robust * s.change * s.change, cross + s.robust * s.change * (s.seen - s.lit))
        });
        if square <= 0.0 {
            return Gloss::NONE;
        }
        w_s = cross / square;
        let off = |s: &Sample| (s.seen - s.lit - w_s.max(0.0) * s.change).abs();
        let sigma = 1.4826 * median(samples.iter().map(off).collect()) + 1e-9;
        samples.iter_mut().for_each(|s| s.robust = HUBER * sigma / off(s).max(HUBER * sigma));
        error = sigma * libm::sqrt(CORRELATED / square);
    }
    let significant = w_s > SIGNIFICANT * error;
    let w_s = w_s.max(0.0);
    // w_d of Eq. (13) for this w_s.
    let (square, cross) = samples.iter().fold((0.0, 0.0), |(square, cross), s| {
        (square + s.robust * s.lit * s.lit, cross + s.robust * s.lit * (s.seen - w_s * s.mirror))
    });
    let w_d = if square > 0.0 { (cross / square).max(0.0) } else { 1.0 };
    Gloss { w_d, w_s, error, significant }
}

/// Lit colours without the gloss that their median holds.
#[must_use]
pub fn clean(reflection: &Reflection, association: &Association, segment: &[u32], gloss: &[Gloss]) -> Vec<Vec3> {
    (0..segment.len())
        .into_par_iter()
        .map(|i| {
            let lit = association.lit_color[i];
            let gloss = gloss[segment[i] as usize];
            if !gloss.significant {
                return lit;
            }
            let pairs = pairs(reflection, association, i);
            if pairs.is_empty() {
                return lit;
            }
            let held = [0, 1, 2].map(|c| {
                let middle = median(pairs.iter().map(|p| p.mirror[c]).collect());
                // At least a tenth stays: nothing is all gloss to the median of its views.
                (f64::from(lit[c]) - gloss.w_s * middle).max(0.1 * f64::from(lit[c])) as f32
            });
            Vec3::from_array(held)
        })
        .collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
