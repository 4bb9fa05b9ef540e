//! Lucas–Kanade alignment of one keyframe: Gauss–Newton on the differences between its image and the predicted image at edge
//! pixels, with Tukey weights and a prior on the total motion.

use crate::association::context::AssociationContext;
use crate::association::keyframe_image::KeyframeImage;
use crate::association::observations::RefinedView;
use crate::association::predicted_image::{ImageLevel, PredictedImage};
use crate::mesh::raster::Raster;
use crate::numerics::robust::{median, robust_sigma};
use firmware_config::tuning::PoseTuning;
use glam::{DVec3, Vec3};
use isa::{Hot, Isa, dispatch};
use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;
use recordings::types::{Intrinsics, Pose};

/// Tukey's constant in robust scales.
pub const TUKEY: f64 = 4.685;
/// Lower bound of the robust scale of residuals, in square roots of light.
pub const MIN_SCALE: f64 = 1e-3;

/// Edge pixels that tell by how many pixels a motion shifts all of them, at most.
const SHIFTED: usize = 4096;

/// Edge pixels that one parallel task compares.
const COMPARED: usize = 4096;

/// (rotation vector, translation) in the camera's frame.
pub type Motion = SVector<f64, 6>;
type Matrix6 = SMatrix<f64, 6, 6>;

/// The pose at the end of a motion.
pub fn pose_of(motion: &Motion) -> Pose {
    Pose::exp(DVec3::new(motion[0], motion[1], motion[2]), DVec3::new(motion[3], motion[4], motion[5]))
}

/// The result of one keyframe at one pyramid level.
pub struct Alignment {
    /// `world_from_camera`.
    pub pose: Pose,
    /// Sum of all steps since the given pose.
    pub moved: Motion,
    /// RMS motion of the edge pixels at full resolution.
    pub step_px: f64,
    /// The same since the given pose, and what its translation alone would make it.
    pub moved_px: [f64; 2],
    /// Mean Tukey loss before.
    pub before: f64,
    /// Mean Tukey loss after.
    pub after: f64,
}

/// Aligns the image with its prediction from lit `colors`, starting at the pose of `view`, at which a z-buffer may be known. `moved`
/// is the motion since the given pose, of which `expected` is the prior. `None` if there are too few edge pixels or the system is
/// singular.
pub fn align(
    context: &AssociationContext,
    image: &KeyframeImage,
    (colors, known): (&[Vec3], Option<&Raster>),
    view: &RefinedView,
    moved: &Motion,
    expected: &ExpectedMotion,
    level: f64,
) -> Option<Alignment> {
    let tuning = &context.config.tuning.pose;
    let target = ImageLevel::new(image, context, level);
    let predicted = PredictedImage::new(context, &target, (colors, known), view);
    let (pixels, every) = edge_pixels(&predicted, tuning.min_edge_strength as f32, tuning.edge_pixels as usize);
    if pixels.len() < tuning.min_edge_pixels as usize {
        return None;
    }
    let depth = median(pixels.iter().map(|p| p.point.z))?;
    let prior = Motion::from_fn(|r, _| {
        let given = expected.deviation_px / target.camera.fx.abs() * level * if r < 3 { 1.0 } else { depth };
        let sigma = expected.held.map_or(given, |h| given.min(if r < 3 { h.rotation } else { h.translation }));
        1.0 / (sigma * sigma)
    });
    let observations = every as f64 / tuning.pixels_per_observation;
    let held = expected.held.is_some();
    let problem = Problem { target, pixels, observations, prior, common: expected.common, held, tuning };
    let (mut delta, mut moved_now) = (Pose::IDENTITY, *moved);
    let mut now = problem.compared(&delta);
    let scale = problem.robust_scale(&now.residuals)?;
    let before = problem.cost(&now.residuals, scale, moved);
    let mut best = (before, delta, moved_now);
    for _ in 0..tuning.gauss_newton_steps {
        let (step, step_px) = problem.gauss_newton_step(&now, &moved_now)?;
        delta = pose_of(&step).compose(&delta);
        moved_now += step;
        if step_px < tuning.settled_px {
            break;
        }
        now = problem.compared(&delta);
        let cost = problem.cost(&now.residuals, scale, &moved_now);
        if cost < best.0 {
            best = (cost, delta, moved_now);
        }
    }
    let (after, delta, moved_now) = best;
    if after >= before {
        let moved_px = problem.moved_px(moved, level);
        let pose = view.world_from_camera;
        return Some(Alignment { pose, moved: *moved, step_px: 0.0, moved_px, before, after: before });
    }
    Some(Alignment {
        pose: view.world_from_camera.compose(&delta.inverse()),
        moved: moved_now,
        step_px: problem.rms_shift_px(&delta) / level,
        moved_px: problem.moved_px(&moved_now, level),
        before,
        after,
    })
}

/// What the prior expects of a keyframe's motion.
#[derive(Debug, Clone, Copy)]
pub struct ExpectedMotion {
    /// The motion that the keyframes have in common: zero, or that of a camera which is not where the depth sensor takes it to be.
    pub common: Motion,
    /// Standard deviation about it, in pixels at full resolution.
    pub deviation_px: f64,
    /// A keyframe that ran away is held by the deviation of the others' poses.
    pub held: Option<PoseDeviation>,
}

impl ExpectedMotion {
    /// Of poses whose errors have nothing in common.
    pub fn given(tuning: &PoseTuning) -> Self {
        Self { common: Motion::zeros(), deviation_px: tuning.prior_px, held: None }
    }
}

/// Standard deviation of given poses, per unknown.
#[derive(Debug, Clone, Copy)]
pub struct PoseDeviation {
    /// Radians.
    pub rotation: f64,
    /// World units.
    pub translation: f64,
}

impl PoseDeviation {
    /// Of poses whose translation is right, while their rotation may be off by as much as the prior allows.
    pub const ROTATION_ALONE: Self = Self { rotation: f64::INFINITY, translation: 1e-6 };

    /// From the motions of many keyframes, most of which were aligned well, about what they have in common; `None` if they do not
    /// differ from it.
    pub fn of(off: &[Motion]) -> Option<Self> {
        let sigma = |unknowns: std::ops::Range<usize>| {
            robust_sigma(off.iter().flat_map(|m| unknowns.clone().map(|r| m[r].abs())))
        };
        let own = Self { rotation: sigma(0..3), translation: sigma(3..6) };
        (own.rotation > 0.0 && own.translation > 0.0).then_some(own)
    }

    /// A motion so long, in deviations, is none of a given pose that is off: the keyframe ran away.
    pub fn is_exceeded_by(&self, moved: &Motion, factor: f64) -> bool {
        moved.fixed_rows::<3>(0).norm() > factor * self.rotation
            || moved.fixed_rows::<3>(3).norm() > factor * self.translation
    }
}

/// An edge pixel of the predicted image.
struct EdgePixel {
    /// Surface point in the camera's frame.
    point: DVec3,
    /// Gradient of every channel per pixel.
    du: Vec3,
    dv: Vec3,
    color: Vec3,
}

/// Edge pixels of a predicted image, and how many of them each of those stands for: no more than twice `most`, evenly chosen.
fn edge_pixels(predicted: &PredictedImage, min_strength: f32, most: usize) -> (Vec<EdgePixel>, usize) {
    let (w, h) = (predicted.width, predicted.height);
    let gradient = |i: usize| {
        let du = 0.5 * (predicted.color[i + 1] - predicted.color[i - 1]);
        let dv = 0.5 * (predicted.color[i + w] - predicted.color[i - w]);
        (du, dv)
    };
    let mut edges = Vec::new();
    for y in 1..h.saturating_sub(1) {
        for i in y * w + 1..(y * w + w).saturating_sub(1) {
            let (du, dv) = gradient(i);
            // Written so that NaN fails too.
            if du.length_squared() + dv.length_squared() > min_strength && predicted.depth[i].is_finite() {
                edges.push(i);
            }
        }
    }
    let every = (edges.len() / most).max(1);
    let pixel = |i: usize| {
        let (k, z) = (&predicted.camera, f64::from(predicted.depth[i]));
        let point = DVec3::new(((i % w) as f64 - k.cx) / k.fx * z, ((i / w) as f64 - k.cy) / k.fy * z, z);
        let (du, dv) = gradient(i);
        EdgePixel { point, du, dv, color: predicted.color[i] }
    };
    (edges.into_iter().step_by(every).map(pixel).collect(), every)
}

/// The edge pixels under one pose.
struct Compared {
    /// Those that the image shows.
    seen: Vec<Seen>,
    /// RMS difference over the channels, `[edge pixel]`; NaN where there is none.
    residuals: Vec<f32>,
}

/// An edge pixel that the image shows.
struct Seen {
    /// Number of the edge pixel.
    index: u32,
    /// Where its point is in the camera's frame.
    point: DVec3,
    /// Image minus prediction.
    difference: Vec3,
}

/// The least-squares problem of one keyframe at one level.
struct Problem<'a> {
    target: ImageLevel,
    pixels: Vec<EdgePixel>,
    /// Independent observations that a pixel counts as: errors of neighbouring ones are correlated, and it may stand for several.
    observations: f64,
    /// Information of the prior on the total motion, per unknown.
    prior: Motion,
    /// Mean of the prior.
    common: Motion,
    /// The prior counts among the cost, too: the keyframe ran away.
    held: bool,
    tuning: &'a PoseTuning,
}

impl Problem<'_> {
    /// Image minus prediction at an edge pixel's point, once it is moved to `q`; `None` outside the image or where it is
    /// clipped.
    fn difference(&self, q: DVec3, pixel: &EdgePixel) -> Option<Vec3> {
        if q.z <= 0.0 {
            return None;
        }
        let (u, v) = self.target.camera.project(q);
        let d = self.target.sample(u, v)? - pixel.color;
        (!d.is_nan()).then_some(d)
    }

    /// The edge pixels moved by `delta`, compared with the image.
    fn compared(&self, delta: &Pose) -> Compared {
        let chunk = |(task, pixels): (usize, &[EdgePixel])| {
            let mut compared = Compared { seen: Vec::new(), residuals: Vec::with_capacity(pixels.len()) };
            for (index, pixel) in ((task * COMPARED) as u32..).zip(pixels) {
                let point = delta.transform(pixel.point);
                let difference = self.difference(point, pixel);
                compared.residuals.push(difference.map_or(f32::NAN, |d| (d.length_squared() / 3.0).sqrt()));
                compared.seen.extend(difference.map(|difference| Seen { index, point, difference }));
            }
            compared
        };
        let chunks: Vec<Compared> = self.pixels.par_chunks(COMPARED).enumerate().map(chunk).collect();
        let mut compared = Compared { seen: Vec::with_capacity(self.pixels.len()), residuals: Vec::new() };
        for chunk in chunks {
            compared.seen.extend(chunk.seen);
            compared.residuals.extend(chunk.residuals);
        }
        compared
    }

    /// Median residual; `None` if too few pixels have one.
    fn robust_scale(&self, residuals: &[f32]) -> Option<f64> {
        let valid = residuals.iter().copied().filter(|r| !r.is_nan());
        let enough = valid.clone().count() >= self.tuning.min_edge_pixels as usize;
        enough.then(|| median(valid)).flatten().map(|m| f64::from(m).max(MIN_SCALE))
    }

    /// What a step lowers: the mean Tukey loss and, for a keyframe that is held, the prior in the same units.
    fn cost(&self, residuals: &[f32], scale: f64, moved: &Motion) -> f64 {
        let loss = tukey_cost(residuals, scale);
        if !self.held {
            return loss;
        }
        // The loss of a pixel, over three channels, is TUKEY² / 6 · 3 of the quadratic form's units at most.
        let unit = self.pixels.len() as f64 * self.observations * TUKEY * TUKEY / 2.0;
        let off = moved - self.common;
        loss + 0.5 * self.prior.component_mul(&off).dot(&off) / unit
    }

    /// One step of Gauss–Newton and the RMS motion of pixels that it makes; `None` if there is no finite solution.
    fn gauss_newton_step(&self, now: &Compared, moved: &Motion) -> Option<(Motion, f64)> {
        let scale = self.robust_scale(&now.residuals)?;
        let sums = dispatch(Isa::detect(), Summed { problem: self, now, scale });
        // The Cholesky decomposition reads no entry above the diagonal.
        let mut hessian = Matrix6::from_fn(|r, c| if c <= r { sums.hessian[r * (r + 1) / 2 + c] } else { 0.0 });
        let mut gradient = Motion::from(sums.gradient);
        let information = self.observations / (scale * scale);
        hessian *= information;
        gradient *= information;
        hessian += Matrix6::from_diagonal(&self.prior);
        gradient += self.prior.component_mul(&(moved - self.common));
        let step = -(hessian.cholesky()?.solve(&gradient));
        step.iter().all(|x| x.is_finite()).then(|| (step, self.rms_shift_px(&pose_of(&step))))
    }

    /// RMS motion in pixels at full resolution of the edge pixels, to the first order, under the total motion and under its
    /// translation alone.
    fn moved_px(&self, moved: &Motion, level: f64) -> [f64; 2] {
        let translation = Motion::from_fn(|r, _| if r < 3 { 0.0 } else { moved[r] });
        [*moved, translation].map(|motion| self.rms_shift_px(&pose_of(&motion)) / level)
    }

    /// RMS motion in pixels of the edge pixels under `delta`, by some of them.
    fn rms_shift_px(&self, delta: &Pose) -> f64 {
        let k = &self.target.camera;
        let square = |p: &EdgePixel| {
            let q = delta.transform(p.point);
            let (du, dv) = (k.fx * (q.x / q.z - p.point.x / p.point.z), k.fy * (q.y / q.z - p.point.y / p.point.z));
            du * du + dv * dv
        };
        let some = self.pixels.iter().step_by(self.pixels.len().div_ceil(SHIFTED));
        let count = some.len();
        (some.map(square).sum::<f64>() / count as f64).sqrt()
    }
}

/// Edge pixels that are summed side by side.
const LANES: usize = 8;
type Lanes = [f64; LANES];
/// Entries of a symmetric matrix on and below its diagonal, row by row.
const LOWER: usize = 21;

/// Sums over the edge pixels.
struct NormalSums {
    /// Σ w Jᵀ ∇I ∇Iᵀ J.
    hessian: [f64; LOWER],
    /// Σ w Jᵀ ∇I d.
    gradient: [f64; 6],
}

/// What the edge pixels sum up to.
struct Summed<'a> {
    problem: &'a Problem<'a>,
    now: &'a Compared,
    scale: f64,
}

impl Hot for Summed<'_> {
    type Output = NormalSums;

    #[inline(always)]
    fn run(self) -> NormalSums {
        let Self { problem, now, scale } = self;
        let camera = &problem.target.camera;
        let (mut hessian, mut gradient) = ([Lanes::default(); LOWER], [Lanes::default(); 6]);
        for seen in now.seen.chunks(LANES) {
            // Points in front of the camera, and ∇I ∇Iᵀ and ∇I d with their weights; zero for outliers and past the end.
            let [mut x, mut y, mut uu, mut uv, mut vv, mut gu, mut gv] = [Lanes::default(); 7];
            let mut z = [1.0; LANES];
            for (l, &Seen { index, point, difference }) in seen.iter().enumerate() {
                let off = f64::from(now.residuals[index as usize]) / (scale * TUKEY);
                // Written so that NaN fails too.
                let weight = if off < 1.0 { (1.0 - off * off) * (1.0 - off * off) } else { 0.0 };
                let EdgePixel { du, dv, .. } = problem.pixels[index as usize];
                (x[l], y[l], z[l]) = (point.x, point.y, point.z);
                (uu[l], uv[l], vv[l]) =
                    (f64::from(du.dot(du)) * weight, f64::from(du.dot(dv)) * weight, f64::from(dv.dot(dv)) * weight);
                (gu[l], gv[l]) = (f64::from(du.dot(difference)) * weight, f64::from(dv.dot(difference)) * weight);
            }
            let (mut ju, mut jv) = ([Lanes::default(); 6], [Lanes::default(); 6]);
            for l in 0..LANES {
                let (u, v) = jacobian(DVec3::new(x[l], y[l], z[l]), camera);
                for r in 0..6 {
                    (ju[r][l], jv[r][l]) = (u[r], v[r]);
                }
            }
            for r in 0..6 {
                let (mut a, mut b) = (Lanes::default(), Lanes::default());
                for l in 0..LANES {
                    (a[l], b[l]) = (ju[r][l] * uu[l] + jv[r][l] * uv[l], ju[r][l] * uv[l] + jv[r][l] * vv[l]);
                    gradient[r][l] += ju[r][l] * gu[l] + jv[r][l] * gv[l];
                }
                for c in 0..=r {
                    for l in 0..LANES {
                        hessian[r * (r + 1) / 2 + c][l] += a[l] * ju[c][l] + b[l] * jv[c][l];
                    }
                }
            }
        }
        let sum = |lanes: Lanes| lanes.iter().sum();
        NormalSums { hessian: hessian.map(sum), gradient: gradient.map(sum) }
    }
}

/// Derivatives of (u, v) by a [`Motion`] of the point q in the camera's frame.
#[inline(always)]
pub fn jacobian(q: DVec3, k: &Intrinsics) -> (Motion, Motion) {
    let (fx, fy) = (k.fx, k.fy);
    let (x, y, z) = (q.x / q.z, q.y / q.z, 1.0 / q.z);
    (
        Motion::from([-fx * x * y, fx * (1.0 + x * x), -fx * y, fx * z, 0.0, -fx * x * z]),
        Motion::from([-fy * (1.0 + y * y), fy * x * y, fy * x, 0.0, fy * z, -fy * y * z]),
    )
}

/// Mean Tukey loss, 0 to 1; pixels without a residual have the full loss, so that leaving the image is no gain.
pub fn tukey_cost(residuals: &[f32], scale: f64) -> f64 {
    let loss = |&r: &f32| {
        let x = f64::from(r) / (scale * TUKEY);
        if x < 1.0 { 1.0 - (1.0 - x * x) * (1.0 - x * x) * (1.0 - x * x) } else { 1.0 }
    };
    residuals.iter().map(loss).sum::<f64>() / residuals.len() as f64
}
