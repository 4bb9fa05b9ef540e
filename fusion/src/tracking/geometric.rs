//! The geometric term: association of the frame's points with planes, and point-to-plane residuals.

use crate::camera::pinhole::Rigid;
use crate::tracking::normal_equations::{CHUNK, System, sum_chunks};
use crate::tracking::problem::AlignmentProblem;
use crate::tsdf::sampling::Cursor;
use firmware_config::tuning::DepthNoise;
use glam::Vec3;
use rayon::prelude::*;
use recordings::types::Pose;

/// A point of the frame with its associated plane.
#[derive(Debug, Clone, Copy)]
pub struct Association {
    /// Point, camera axes, metres.
    pub p: Vec3,
    /// Plane n · x = d in the world, n towards free space.
    pub n: Vec3,
    pub d: f32,
}

/// How far a point is from its plane.
pub struct Residual {
    /// Distance, metres.
    pub r: f32,
    /// Standard deviation of the depth noise, metres.
    pub sigma: f32,
    /// Tukey's weight over the variance; 0 from `cut` standard deviations on.
    pub weight: f32,
}

/// The residuals at a pose.
pub fn residual(world_from_camera: &Pose, cut: f32, noise: &DepthNoise) -> impl Fn(&Association) -> Residual {
    let t = Rigid::from(world_from_camera);
    move |a| {
        let r = a.n.dot(t.apply(a.p)) - a.d;
        let sigma = noise.sigma_m(a.p.z);
        let scaled = r / (cut * sigma);
        let taper = (1.0 - scaled * scaled).max(0.0);
        Residual { r, sigma, weight: taper * taper / (sigma * sigma) }
    }
}

/// Normal equations of r = n · (T p) − d, with Tukey's weights that vanish at `cut` standard deviations of the depth noise.
/// `columns` maps the derivatives by the pose (6), and the point, to the derivatives by the unknowns.
pub fn geometric<const N: usize>(
    associations: &[Association],
    world_from_camera: &Pose,
    cut: f32,
    noise: &DepthNoise,
    columns: impl Fn([f32; 6], Vec3) -> [f32; N] + Sync,
) -> System {
    let back = Rigid::from(world_from_camera).r.transpose();
    let residual = residual(world_from_camera, cut, noise);
    sum_chunks(associations, |associations| {
        let mut system = System::ZERO;
        for a in associations {
            let Residual { r, sigma, weight } = residual(a);
            system.count += 1;
            if weight <= 0.0 {
                continue;
            }
            let m = back * a.n;
            let c = a.p.cross(m);
            system.add(&columns([m.x, m.y, m.z, c.x, c.y, c.z], a.p), r, weight);
            system.inliers += usize::from(r.abs() < 3.0 * sigma);
            system.absolute += f64::from(r.abs());
        }
        system
    })
}

/// Frame to frame: projective association with the reference's grid (KinectFusion). Fills `out`, and `tilts` with the squared
/// sines of the angles between the normals of frame and reference; returns the number of points of the frame that were tested.
pub fn associate_reference(
    problem: &AlignmentProblem,
    pose: &Pose,
    out: &mut Vec<Association>,
    tilts: &mut Vec<f32>,
) -> usize {
    let AlignmentProblem { frame, rig, reference, config, .. } = *problem;
    let tuning = &config.tuning.tracking;
    let (max_share, min_cos) = (tuning.frame_distance_share as f32, tuning.frame_normal_cos as f32);
    out.clear();
    tilts.clear();
    let mut tested = 0;
    let world_from_reference = Rigid::from(&reference.world_from_camera);
    let reference_from_camera = Rigid::from(&reference.world_from_camera.inverse().compose(pose));
    let to_depth = Rigid::from(&rig.depth_from_color);
    let columns = rig.grid.width.div_ceil(2);
    for y in (0..rig.grid.height).step_by(2) {
        for x in (0..rig.grid.width).step_by(2) {
            let s = frame.grid[y * rig.grid.width + x];
            if !s.is_valid() {
                continue;
            }
            tested += 1;
            let p = reference_from_camera.apply(s.p);
            let Some(pixel) = rig.grid.pixel(to_depth.apply(p)) else { continue };
            let (u, v) = (pixel % rig.grid.width / 2, pixel / rig.grid.width / 2);
            let Some(m) = reference.coarse.get(v * columns + u).filter(|m| m.is_valid()) else { continue };
            let distance2 = (m.p - p).length_squared();
            let max_distance = max_share * p.z;
            let cos = (reference_from_camera.r * s.n).dot(m.n);
            if distance2 > max_distance * max_distance || cos < min_cos {
                continue;
            }
            let n = world_from_reference.r * m.n;
            out.push(Association { p: s.p, n, d: n.dot(world_from_reference.apply(m.p)) });
            tilts.push(1.0 - cos * cos);
        }
    }
    tested
}

/// Frame to model: the plane through the point of the TSDF's surface nearest to every `stride`-th point of the frame. Fills
/// `out`; returns the number of points of the frame that were tested.
pub fn associate_volume(problem: &AlignmentProblem, pose: &Pose, stride: usize, out: &mut Vec<Association>) -> usize {
    let AlignmentProblem { frame, volume, config, .. } = *problem;
    let tuning = &config.tuning.tracking;
    let t = Rigid::from(pose);
    let limit = tuning.model_distance_share as f32 * volume.truncation_m();
    let steep = tuning.min_gradient as f32..tuning.max_gradient as f32;
    let min_cos = tuning.model_normal_cos as f32;
    let parts: Vec<(Vec<Association>, usize)> = frame
        .grid
        .par_chunks(CHUNK)
        .map(|surfels| {
            let mut found = Vec::with_capacity(surfels.len() / stride);
            let mut tested = 0;
            let mut cursor = Cursor::default();
            for s in surfels.iter().step_by(stride).filter(|s| s.is_valid()) {
                tested += 1;
                let p = t.apply(s.p);
                let Some(sample) = volume.sample(p, &mut cursor) else { continue };
                let steepness = sample.gradient.length();
                if sample.distance.abs() > limit || !steep.contains(&steepness) {
                    continue;
                }
                let n = sample.gradient / steepness;
                if (t.r * s.n).dot(n) < min_cos {
                    continue;
                }
                found.push(Association { p: s.p, n, d: n.dot(p) - sample.distance / steepness });
            }
            (found, tested)
        })
        .collect();
    out.clear();
    let mut tested = 0;
    for (found, n) in parts {
        out.extend(found);
        tested += n;
    }
    tested
}
