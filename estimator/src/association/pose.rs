//! Pose refinement by Lucas–Kanade against the re-rendered keyframe: all poses against common lit colours, each
//! keyframe against colours that it had no part in.

use crate::association::keyframe_image::KeyframeImage;
use crate::association::predicted_image::{Plate, Template};
use crate::association::{LightField, LitColors, Setting, View};
use crate::numerics::robust::median;
use glam::{DVec3, Vec3};
use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;
use recordings::decision::Decision;
use recordings::types::{Keyframe, Pose};

/// Gauss–Newton steps at one level.
const STEPS: usize = 8;
/// A step below this many pixels ends a level.
const SETTLED_PX: f64 = 0.01;
/// Tukey's constant.
const TUKEY: f64 = 4.685;
/// Neighbouring pixels err together: so many count as one observation.
const PIXELS_PER_OBSERVATION: f64 = 25.0;
/// Deviation of the given poses that is thought possible where the picture does not tell, in pixels.
const PRIOR_PX: f64 = 5.0;
/// Rings of vertices around the seen ones that take their neighbours' colour for rendering.
const FILL_RINGS: usize = 8;

type Vector6 = SVector<f64, 6>;
type Matrix6 = SMatrix<f64, 6, 6>;

/// Refines all poses, round by round.
pub struct Tracker {
    /// Sum of the steps (rotation vector, translation; camera frame) since the given pose.
    moved: Vec<Vector6>,
    history: Vec<f64>,
    first_residual: f64,
    last_residual: f64,
}

/// One keyframe's refinement at one level.
struct Outcome {
    pose: Pose,
    moved: Vector6,
    step_px: f64,
    before: f64,
    after: f64,
}

impl Tracker {
    /// Starts at the given poses.
    pub fn new(keyframes: &[Keyframe]) -> Self {
        Self {
            moved: vec![Vector6::zeros(); keyframes.len()],
            history: vec![],
            first_residual: 0.0,
            last_residual: 0.0,
        }
    }

    /// One round over all keyframes. False when nothing moves any more.
    pub fn step(
        &mut self,
        setting: &Setting,
        pictures: &[Option<KeyframeImage>],
        field: &LightField,
        lit: &LitColors,
        views: &mut [View],
        round: u32,
    ) -> bool {
        let levels: &[f64] = match round {
            0 => &[0.25, 0.5],
            1 => &[0.5, 1.0],
            _ => &[1.0],
        };
        let filled = fill(setting, &lit.color, &lit.weight);
        let outcomes: Vec<Option<Outcome>> = (0..views.len())
            .into_par_iter()
            .map(|j| {
                let picture = pictures[j].as_ref()?;
                let colors = left_out(field, lit, &filled, views, j);
                let mut total: Option<Outcome> = None;
                for &level in levels {
                    let mut view = views[j];
                    let mut moved = self.moved[j];
                    if let Some(o) = &total {
                        view.world_from_camera = o.pose;
                        moved = o.moved;
                    }
                    if let Some(next) = align(setting, picture, &colors, &view, &moved, level) {
                        let step_px = total.as_ref().map_or(0.0, |t| t.step_px).hypot(next.step_px);
                        total = Some(Outcome { step_px, ..next });
                    }
                }
                total
            })
            .collect();
        let mut squares = 0.0;
        let mut residuals = [0.0, 0.0];
        let mut count = 0.0;
        for (j, outcome) in outcomes.into_iter().enumerate() {
            let Some(o) = outcome else { continue };
            views[j].world_from_camera = o.pose;
            views[j].residual_px = o.step_px;
            self.moved[j] = o.moved;
            squares += o.step_px * o.step_px;
            residuals[0] += o.before;
            residuals[1] += o.after;
            count += 1.0;
        }
        if count == 0.0 {
            return false;
        }
        if self.history.is_empty() {
            self.first_residual = residuals[0] / count;
        }
        self.last_residual = residuals[1] / count;
        let rms = f64::sqrt(squares / count);
        self.history.push(rms);
        rms > 0.05 || round < 2
    }

    /// What was decided, and why.
    pub fn decision(&self, refined: bool) -> Decision {
        Decision::Pose {
            refined,
            steps_px: self.history.clone(),
            first_residual: self.first_residual,
            last_residual: self.last_residual,
        }
    }
}

/// The pose from which a picture that had no part in these lit colours shows them best, starting at the view's.
#[must_use]
pub fn located(setting: &Setting, picture: &KeyframeImage, color: &[Vec3], weight: &[f32], view: &View) -> Pose {
    let colors = fill(setting, color, weight);
    let mut found = *view;
    let mut moved = Vector6::zeros();
    for level in [0.25, 0.5, 1.0, 1.0] {
        if let Some(o) = align(setting, picture, &colors, &found, &moved, level) {
            (found.world_from_camera, moved) = (o.pose, o.moved);
        }
    }
    found.world_from_camera
}

/// Lit colours with the vertices around the seen ones filled in; NaN where nothing is near.
fn fill(setting: &Setting, color: &[Vec3], weight: &[f32]) -> Vec<Vec3> {
    let mut colors: Vec<Vec3> = color.iter().zip(weight).map(|(&c, &w)| if w > 0.0 { c } else { Vec3::NAN }).collect();
    let mut open: Vec<u32> = (0..colors.len() as u32).filter(|&i| colors[i as usize].is_nan()).collect();
    for _ in 0..FILL_RINGS {
        let news: Vec<(u32, Vec3)> = open
            .iter()
            .filter_map(|&i| {
                let row = setting.graph.neighbours(i as usize);
                let known = row.iter().map(|&k| colors[k as usize]).filter(|c| !c.is_nan());
                let (sum, count) = known.fold((Vec3::ZERO, 0.0), |(s, n), c| (s + c, n + 1.0));
                (count > 0.0).then(|| (i, sum / count))
            })
            .collect();
        if news.is_empty() {
            break;
        }
        for &(i, c) in &news {
            colors[i as usize] = c;
        }
        open.retain(|&i| colors[i as usize].is_nan());
    }
    colors
}

/// The colours without keyframe `j`'s own observations; NaN where it alone saw the vertex.
fn left_out(field: &LightField, lit: &LitColors, filled: &[Vec3], views: &[View], j: usize) -> Vec<Vec3> {
    let mut colors = filled.to_vec();
    let factor = Vec3::from_array(views[j].gain.map(|g| (1.0 / g) as f32));
    for (o, &used) in field.observations.iter().zip(&lit.used) {
        if o.keyframe as usize == j {
            let i = o.vertex as usize;
            let rest = lit.weight[i] - used;
            colors[i] = if rest > 0.05 * lit.weight[i] {
                (lit.color[i] * lit.weight[i] - Vec3::from_array(o.color) * factor * used) / rest
            } else {
                Vec3::NAN
            };
        }
    }
    colors
}

/// What an edge pixel of the template says: its surface point, the gradient of every channel, its colour.
struct EdgePixel {
    point: DVec3,
    du: Vec3,
    dv: Vec3,
    color: Vec3,
}

fn align(
    setting: &Setting,
    picture: &KeyframeImage,
    colors: &[Vec3],
    view: &View,
    moved: &Vector6,
    level: f64,
) -> Option<Outcome> {
    let plate = Plate::new(picture, setting, level);
    let template = Template::new(setting, &plate, colors, view);
    let pixels = edge_pixels(&template);
    if pixels.len() < 50 {
        return None;
    }
    let k = plate.camera;
    let mut delta = Pose::IDENTITY;
    let mut moved_now = *moved;
    let mut residuals = vec![f32::NAN; pixels.len()];
    let mut best = (f64::INFINITY, delta, moved_now);
    let mut before = None;
    let mut scale = 0.0;
    let mut squares = 0.0;
    let depth = median_depth(&pixels);
    let prior = Vector6::from_fn(|r, _| {
        let sigma = PRIOR_PX / k.fx.abs() * level * if r < 3 { 1.0 } else { depth };
        1.0 / (sigma * sigma)
    });
    for step in 0..=STEPS {
        let mut hessian = Matrix6::zeros();
        let mut gradient = Vector6::zeros();
        let mut steepness = Matrix6::zeros();
        // Residuals first: their scale sets the weights.
        for (p, r) in pixels.iter().zip(&mut residuals) {
            *r = residual(&plate, &delta, p).map_or(f32::NAN, |d| (d.length_squared() / 3.0).sqrt());
        }
        if before.is_none() {
            scale = robust_scale(&residuals)?;
        }
        let cost = tukey_cost(&residuals, scale);
        before.get_or_insert(cost);
        if cost < best.0 {
            best = (cost, delta, moved_now);
        }
        if step == STEPS {
            break;
        }
        let local = robust_scale(&residuals)?;
        for (p, &r) in pixels.iter().zip(&residuals) {
            let x = f64::from(r) / (local * TUKEY);
            if x.is_nan() || x >= 1.0 {
                continue;
            }
            let weight = (1.0 - x * x) * (1.0 - x * x);
            let Some(difference) = residual(&plate, &delta, p) else { continue };
            let q = delta.transform(p.point);
            let (ju, jv) = jacobian(q, k.fx, k.fy);
            let (uu, uv, vv) = (p.du.dot(p.du), p.du.dot(p.dv), p.dv.dot(p.dv));
            let (gu, gv) = (p.du.dot(difference), p.dv.dot(difference));
            let (uu, uv, vv) = (f64::from(uu) * weight, f64::from(uv) * weight, f64::from(vv) * weight);
            let (gu, gv) = (f64::from(gu) * weight, f64::from(gv) * weight);
            let (a, b) = (ju * uu + jv * uv, ju * uv + jv * vv);
            hessian += a * ju.transpose() + b * jv.transpose();
            gradient += ju * gu + jv * gv;
            steepness += ju * ju.transpose() + jv * jv.transpose();
        }
        let information = 1.0 / (local * local * PIXELS_PER_OBSERVATION);
        hessian *= information;
        gradient *= information;
        hessian += Matrix6::from_diagonal(&prior);
        gradient += prior.component_mul(&moved_now);
        let dx = -(hessian.cholesky()?.solve(&gradient));
        if dx.iter().any(|x| !x.is_finite()) {
            return None;
        }
        delta = Pose::exp(DVec3::new(dx[0], dx[1], dx[2]), DVec3::new(dx[3], dx[4], dx[5])).compose(&delta);
        moved_now += dx;
        squares = (dx.transpose() * steepness * dx)[0] / pixels.len() as f64;
        if squares.sqrt() < SETTLED_PX {
            break;
        }
    }
    let _ = squares;
    let before = before?;
    if best.0 >= before {
        return Some(Outcome { pose: view.world_from_camera, moved: *moved, step_px: 0.0, before, after: before });
    }
    let (after, delta, moved_now) = best;
    let mean_px = pixels
        .iter()
        .map(|p| {
            let q = delta.transform(p.point);
            let (du, dv) = (k.fx * (q.x / q.z - p.point.x / p.point.z), k.fy * (q.y / q.z - p.point.y / p.point.z));
            du * du + dv * dv
        })
        .sum::<f64>()
        / pixels.len() as f64;
    Some(Outcome {
        pose: view.world_from_camera.compose(&delta.inverse()),
        moved: moved_now,
        step_px: mean_px.sqrt() / level,
        before,
        after,
    })
}

fn edge_pixels(template: &Template) -> Vec<EdgePixel> {
    let (w, h) = (template.width, template.height);
    let mut pixels = Vec::new();
    for y in 1..h.saturating_sub(1) {
        for x in 1..w.saturating_sub(1) {
            let i = y * w + x;
            let du = 0.5 * (template.color[i + 1] - template.color[i - 1]);
            let dv = 0.5 * (template.color[i + w] - template.color[i - w]);
            let strength = du.length_squared() + dv.length_squared();
            let depth = template.depth[i];
            // Written so that NaN fails too.
            if !(strength > 3e-5 && depth.is_finite()) {
                continue;
            }
            let k = &template.camera;
            let z = f64::from(depth);
            let point = DVec3::new((x as f64 - k.cx) / k.fx * z, (y as f64 - k.cy) / k.fy * z, z);
            pixels.push(EdgePixel { point, du, dv, color: template.color[i] });
        }
    }
    pixels
}

/// KeyframeImage minus template at an edge pixel's point under `delta`; `None` outside the picture or where it is clipped.
fn residual(plate: &Plate, delta: &Pose, pixel: &EdgePixel) -> Option<Vec3> {
    let q = delta.transform(pixel.point);
    if q.z <= 0.0 {
        return None;
    }
    let k = &plate.camera;
    let d = plate.sample(k.fx * q.x / q.z + k.cx, k.fy * q.y / q.z + k.cy)? - pixel.color;
    (!d.is_nan()).then_some(d)
}

/// Derivatives of (u, v) by a rotation vector and a translation applied to the camera-frame point q.
fn jacobian(q: DVec3, fx: f64, fy: f64) -> (Vector6, Vector6) {
    let (x, y, z) = (q.x / q.z, q.y / q.z, 1.0 / q.z);
    (
        Vector6::from([-fx * x * y, fx * (1.0 + x * x), -fx * y, fx * z, 0.0, -fx * x * z]),
        Vector6::from([-fy * (1.0 + y * y), fy * x * y, fy * x, 0.0, fy * z, -fy * y * z]),
    )
}

fn robust_scale(residuals: &[f32]) -> Option<f64> {
    let valid = residuals.iter().copied().filter(|r| !r.is_nan());
    (valid.clone().count() >= 50).then(|| f64::from(median(valid).unwrap_or(0.0)).max(1e-3))
}

/// Mean Tukey loss; pixels without a residual count in full, so that leaving the picture is no gain.
fn tukey_cost(residuals: &[f32], scale: f64) -> f64 {
    let sum: f64 = residuals
        .iter()
        .map(|&r| {
            let x = f64::from(r) / (scale * TUKEY);
            if x < 1.0 { 1.0 - (1.0 - x * x) * (1.0 - x * x) * (1.0 - x * x) } else { 1.0 }
        })
        .sum();
    sum / residuals.len() as f64
}

fn median_depth(pixels: &[EdgePixel]) -> f64 {
    median(pixels.iter().map(|p| p.point.z)).unwrap_or(0.0)
}
