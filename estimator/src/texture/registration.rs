//! Registration of a picture to colours of surface points at the picture's own resolution: Gauss–Newton steps of its pose and of
//! the camera's motion while the rows were read, with Tukey weights and a prior on both.

use crate::association::AssociationContext;
use crate::association::alignment::{MIN_SCALE, Motion, TUKEY, jacobian, tukey_cost};
use crate::association::keyframe_image::KeyframeImage;
use crate::association::moving_camera::MovingCamera;
use crate::numerics::robust::median;
use firmware_config::tuning::RegistrationTuning;
use glam::Vec3;
use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;

/// A step that lowers the cost by a smaller share is the last under its window.
const WORTHWHILE: f64 = 1e-3;
/// Points that one task adds up.
const CHUNK: usize = 1024;

type Unknowns = SVector<f64, 12>;
type Matrix12 = SMatrix<f64, 12, 12>;

/// A surface point and the colour that the picture should have there, linear RGB, with the picture's exposure and veil.
#[derive(Debug, Clone, Copy)]
pub struct Expected {
    /// In the world.
    pub point: Vec3,
    /// Linear RGB.
    pub color: Vec3,
}

/// A camera that fits, and how well.
pub struct Registered {
    /// The camera.
    pub camera: MovingCamera,
    /// RMS motion of the points, pixels.
    pub moved_px: f64,
}

/// Half widths of the window under which pictures are compared, pixels: wide ones lead to where narrow ones tell.
const COARSE_TO_FINE: [f64; 2] = [2.0, 1.0];

/// Those of a round of registration: rounds after the first leave what only the narrowest window tells.
#[must_use]
pub fn windows(round: u32) -> &'static [f64] {
    &COARSE_TO_FINE[(round as usize).min(COARSE_TO_FINE.len() - 1)..]
}

/// The camera with which the picture fits the expected colours best, starting at `camera`, under windows of these half widths in turn;
/// the same camera if none fits better or there are too few points.
#[must_use]
pub fn register(
    context: &AssociationContext,
    image: &KeyframeImage,
    camera: MovingCamera,
    expected: &[Expected],
    windows: &[f64],
) -> Registered {
    let tuning = &context.config.tuning.registration;
    let problem = Problem { context, image, expected, tuning, given: camera };
    let mut best = Registered { camera, moved_px: 0.0 };
    for &radius in windows {
        let mut now = best.camera;
        let Some((mut residuals, scale)) = problem.residuals(&now, radius) else { return best };
        let mut least = tukey_cost(&residuals, scale);
        for _ in 0..tuning.steps {
            let Some(next) = problem.step(&now, &residuals, scale, radius) else { break };
            let Some((after, _)) = problem.residuals(&next, radius) else { break };
            let cost = tukey_cost(&after, scale);
            if cost >= least {
                break;
            }
            let is_settled = cost > least * (1.0 - WORTHWHILE);
            (now, residuals, least) = (next, after, cost);
            best.camera = now;
            if is_settled {
                break;
            }
        }
    }
    best.moved_px = problem.shift_px(&best.camera);
    best
}

struct Problem<'a> {
    context: &'a AssociationContext<'a>,
    image: &'a KeyframeImage,
    expected: &'a [Expected],
    tuning: &'a RegistrationTuning,
    given: MovingCamera,
}

impl Problem<'_> {
    /// Square roots of the picture's light at a pixel; `None` where the window is clipped or leaves the picture.
    fn seen(&self, u: f64, v: f64, radius: f64) -> Option<Vec3> {
        let sample = self.image.sample(&self.context.table, u, v, radius)?;
        (sample.brightest < self.context.clipped).then(|| Vec3::from_array(sample.color).map(f32::sqrt))
    }

    /// RMS difference over the channels, `[point]`, NaN where there is none, and their median; `None` if too few have one.
    fn residuals(&self, camera: &MovingCamera, radius: f64) -> Option<(Vec<f32>, f64)> {
        let residual = |e: &Expected| {
            let p = camera.point(e.point);
            if p.z <= self.context.near {
                return f32::NAN;
            }
            let (u, v) = camera.pixel(p);
            let difference = self.seen(u, v, radius).map(|c| c - e.color.map(f32::sqrt));
            difference.map_or(f32::NAN, |d| (d.length_squared() / 3.0).sqrt())
        };
        let residuals: Vec<f32> = self.expected.par_iter().map(residual).collect();
        let valid = residuals.iter().copied().filter(|r| !r.is_nan());
        let enough = valid.clone().count() >= self.tuning.min_points as usize;
        let scale = enough.then(|| median(valid)).flatten().map(|m| f64::from(m).max(MIN_SCALE))?;
        Some((residuals, scale))
    }

    /// One step; `None` if there is no finite solution.
    fn step(&self, camera: &MovingCamera, residuals: &[f32], scale: f64, radius: f64) -> Option<MovingCamera> {
        let chunk = |(expected, residuals): (&[Expected], &[f32])| {
            let (mut hessian, mut gradient, mut depth) = (Matrix12::zeros(), Unknowns::zeros(), (0.0, 0.0));
            for (e, &r) in expected.iter().zip(residuals) {
                let x = f64::from(r) / (scale * TUKEY);
                if x.is_nan() || x >= 1.0 {
                    continue;
                }
                let p = camera.point(e.point);
                let (u, v) = camera.pixel(p);
                let at = |du: f64, dv: f64| self.seen(u + du, v + dv, radius);
                let around = (at(0.0, 0.0), at(1.0, 0.0), at(-1.0, 0.0), at(0.0, 1.0), at(0.0, -1.0));
                let (Some(color), Some(right), Some(left), Some(below), Some(above)) = around else { continue };
                let (du, dv) = (0.5 * (right - left), 0.5 * (below - above));
                let difference = color - e.color.map(f32::sqrt);
                let weight = (1.0 - x * x) * (1.0 - x * x);
                let (ju, jv) = jacobian(p, &camera.intrinsics);
                let time = camera.time(p);
                let both = |j: Motion| Unknowns::from_fn(|i, _| if i < 6 { j[i] } else { time * j[i - 6] });
                let (ju, jv) = (both(ju), both(jv));
                let (uu, uv, vv) = (f64::from(du.dot(du)), f64::from(du.dot(dv)), f64::from(dv.dot(dv)));
                hessian.ger(weight, &(ju * uu + jv * uv), &ju, 1.0);
                hessian.ger(weight, &(ju * uv + jv * vv), &jv, 1.0);
                let (u, v) = (f64::from(du.dot(difference)), f64::from(dv.dot(difference)));
                gradient += (ju * u + jv * v) * weight;
                depth = (depth.0 + p.z * weight, depth.1 + weight);
            }
            (hessian, gradient, depth)
        };
        let chunks: Vec<_> = self.expected.par_chunks(CHUNK).zip(residuals.par_chunks(CHUNK)).map(chunk).collect();
        let (mut hessian, mut gradient, mut depth) = (Matrix12::zeros(), Unknowns::zeros(), (0.0, 0.0));
        for (h, g, d) in chunks {
            hessian += h;
            gradient += g;
            depth = (depth.0 + d.0, depth.1 + d.1);
        }
        let information = 1.0 / (scale * scale * self.tuning.points_per_observation);
        hessian *= information;
        gradient *= information;
        let (px, mean_depth) = (camera.intrinsics.fx.abs(), depth.0 / f64::max(depth.1, f64::MIN_POSITIVE));
        let apart = self.apart(camera);
        for i in 0..12 {
            let sigma_px = if i < 6 { self.tuning.pose_px } else { self.tuning.sweep_px };
            let sigma = sigma_px / px * if i % 6 < 3 { 1.0 } else { mean_depth };
            hessian[(i, i)] += 1.0 / (sigma * sigma);
            gradient[i] += apart[i] / (sigma * sigma);
        }
        let step = -(hessian.cholesky()?.solve(&gradient));
        let moved = camera.moved(&step.fixed_rows::<6>(0).into_owned(), &step.fixed_rows::<6>(6).into_owned());
        step.iter().all(|x| x.is_finite()).then_some(moved)
    }

    /// What the prior acts on: the motion since the given pose, and the sweep.
    fn apart(&self, camera: &MovingCamera) -> Unknowns {
        let (turn, shift) = camera.camera_from_world.compose(&self.given.camera_from_world.inverse()).log();
        let pose = [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z];
        Unknowns::from_fn(|i, _| if i < 6 { pose[i] } else { camera.sweep[i - 6] })
    }

    /// RMS distance in pixels between the points under the given camera and this one.
    fn shift_px(&self, camera: &MovingCamera) -> f64 {
        let square = |e: &Expected| {
            let (a, b) = (self.given.pixel(self.given.point(e.point)), camera.pixel(camera.point(e.point)));
            (a.0 - b.0).powi(2) + (a.1 - b.1).powi(2)
        };
        let sum: f64 = self.expected.iter().map(square).sum();
        (sum / self.expected.len().max(1) as f64).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::association::vignetting::Vignetting;
    use crate::rays::RayScene;
    use firmware_config::EstimatorConfig;
    use recordings::types::{Intrinsics, Mesh, Pose, Response};

    const CAMERA: Intrinsics = Intrinsics { width: 160, height: 120, fx: 150.0, fy: 150.0, cx: 79.5, cy: 59.5 };

    /// A print on the plane z = 1, linear.
    fn print(p: Vec3) -> Vec3 {
        let wave = |x: f32, y: f32| 0.3 + 0.1 * libm::sinf(x) + 0.1 * libm::cosf(y);
        Vec3::new(wave(25.0 * p.x, 31.0 * p.y), wave(33.0 * p.x, 21.0 * p.y), wave(19.0 * p.y, 27.0 * p.x))
    }

    /// The point of the plane z = 1 that a pixel shows.
    fn behind(camera: &MovingCamera, u: f64, v: f64) -> Vec3 {
        let mut p = Vec3::Z;
        for _ in 0..20 {
            let (x, y) = camera.pixel(camera.point(p));
            p += Vec3::new(((u - x) / CAMERA.fx) as f32, ((v - y) / CAMERA.fy) as f32, 0.0);
        }
        p
    }

    /// RMS distance in pixels to where the points truly are, before and after registration of the picture that `truth` takes.
    fn errors(truth: &MovingCamera, sweep_px: f64) -> (f64, f64) {
        let corners = [(-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)];
        let mesh = Mesh {
            positions: corners.map(|(x, y)| Vec3::new(x, y, 1.0)).to_vec(),
            normals: vec![Vec3::NEG_Z; 4],
            triangles: vec![[0, 2, 1], [0, 3, 2]],
        };
        let mut config = EstimatorConfig::default();
        config.tuning.registration.sweep_px = sweep_px;
        let (scene, response) = (RayScene::new(&mesh), Response::Srgb);
        let context = AssociationContext::new(&mesh, &scene, &response, &config);
        let pixels = (0..CAMERA.height).flat_map(|y| (0..CAMERA.width).map(move |x| (f64::from(x), f64::from(y))));
        let byte = |c: f32| Response::Srgb.encode(c);
        let data = pixels.flat_map(|(u, v)| print(behind(truth, u, v)).to_array().map(byte)).collect();
        let image = KeyframeImage { camera: CAMERA, data, vignetting: Vignetting::default() };
        let given = MovingCamera::still(&Pose::IDENTITY, &CAMERA);
        let points = (0..60 * 44).map(|i| behind(&given, f64::from(20 + 2 * (i % 60)), f64::from(16 + 2 * (i / 60))));
        let expected: Vec<Expected> = points.map(|point| Expected { point, color: print(point) }).collect();
        let off = |camera: &MovingCamera| {
            let square = |e: &Expected| {
                let (a, b) = (camera.pixel(camera.point(e.point)), truth.pixel(truth.point(e.point)));
                (a.0 - b.0).powi(2) + (a.1 - b.1).powi(2)
            };
            (expected.iter().map(square).sum::<f64>() / expected.len() as f64).sqrt()
        };
        (off(&given), off(&register(&context, &image, given, &expected, &COARSE_TO_FINE).camera))
    }

    #[test]
    fn a_pose_that_is_off_is_corrected() {
        let step = Motion::from([0.004, -0.006, 0.003, 0.002, 0.001, -0.003]);
        let truth = MovingCamera::still(&Pose::IDENTITY, &CAMERA).moved(&step, &Motion::zeros());
        let (before, after) = errors(&truth, 3.0);
        assert!(before > 0.7 && after < 0.1, "{before} → {after} px");
    }

    #[test]
    fn a_rolling_shutter_is_undone() {
        let sweep = Motion::from([0.0, 0.02, 0.006, 0.004, -0.008, 0.0]);
        let truth = MovingCamera::still(&Pose::IDENTITY, &CAMERA).moved(&Motion::zeros(), &sweep);
        let (before, after) = errors(&truth, 3.0);
        assert!(before > 0.7 && after < 0.12, "{before} → {after} px");
        // It takes the sweep: the pose alone cannot do it.
        assert!(errors(&truth, 1e-3).1 > 2.0 * after);
    }
}
