//! Rotation from image to image, for fast turns.
//!
//! A search over shifts of a reduced image finds large rotations as long as the images overlap; Gauss–Newton on SO(3) at the
//! coarsest pyramid level refines the result.

use crate::camera::pinhole::Pinhole;
use crate::camera::rig::{LEVELS, Rig};
use crate::frame::grey::Grey;
use crate::frame::preprocess::Frame;
use crate::tracking::normal_equations::System;
use firmware_config::FusionConfig;
use glam::{DQuat, DVec3, Mat3, Vec2, Vec3};
use nalgebra::{Matrix3, Vector3};

/// Pixels of the coarsest level per pixel of the reduced image, along each side.
const REDUCTION: usize = 2;
/// Gauss–Newton iterations.
const ITERATIONS: usize = 8;
/// Scale of the robust weight, grey values squared, and cap of a residual in the mean, grey values.
const ROBUST_SCALE2: f32 = 400.0;
const RESIDUAL_CAP: f32 = 40.0;

/// `camera_from_reference` as a rotation, from the coarsest grey level of another frame; `None` unless it explains the image
/// clearly better than the predicted `start` (`rotation_search.max_residual_ratio`, `min_residual_drop`).
pub fn align(frame: &Frame, reference: &Grey, rig: &Rig, start: DQuat, config: &FusionConfig) -> Option<DQuat> {
    let tuning = &config.tuning.rotation_search;
    let (max_ratio, min_drop) = (tuning.max_residual_ratio as f32, tuning.min_residual_drop as f32);
    let camera = &rig.grey[LEVELS - 1];
    let current = &frame.grey[LEVELS - 1];
    let (refined, before, after) = refine(reference, current, camera, start)?;
    let shifted =
        best_shift(&reduced(reference), &reduced(current), &camera.reduced(REDUCTION), tuning.max_shift_share as f32);
    let best = match shifted.and_then(|s| refine(reference, current, camera, s)) {
        Some((rotation, _, error)) if error < max_ratio * after => (rotation, error),
        _ => (refined, after),
    };
    (best.1 < max_ratio * before && best.1 < before - min_drop).then_some(best.0)
}

/// Means of `REDUCTION`² pixels minus the mean of the image; unknown pixels are 0.
fn reduced(grey: &Grey) -> Grey {
    let (width, height) = (grey.width / REDUCTION, grey.height / REDUCTION);
    let mut data = vec![0.0; width * height];
    for (i, t) in data.iter_mut().enumerate() {
        let at = (i / width.max(1)) * REDUCTION * grey.width + (i % width.max(1)) * REDUCTION;
        let cell = [at, at + 1, at + grey.width, at + grey.width + 1].map(|k| grey.data[k]);
        *t = if cell.iter().all(|g| *g >= 0.0) { cell.iter().sum::<f32>() * 0.25 } else { f32::NAN };
    }
    let known: Vec<f32> = data.iter().copied().filter(|t| !t.is_nan()).collect();
    let mean = known.iter().sum::<f32>() / known.len().max(1) as f32;
    data.iter_mut().for_each(|t| *t = if t.is_nan() { 0.0 } else { *t - mean });
    Grey { width, height, data }
}

/// The rotation that corresponds to the image shift with the smallest mean absolute difference.
fn best_shift(reference: &Grey, current: &Grey, camera: &Pinhole, max_shift: f32) -> Option<DQuat> {
    let (w, h) = (reference.width as i32, reference.height as i32);
    let reach = (max_shift * w as f32) as i32;
    let reach_y = reach.min(h / 2);
    let mut best = (f32::INFINITY, 0, 0);
    for dy in -reach_y..=reach_y {
        for dx in -reach..=reach {
            let (x0, x1) = (0.max(-dx) as usize, (w - 0.max(dx)) as usize);
            let mut sum = 0.0;
            let mut n = 0;
            for y in 0.max(-dy)..h - 0.max(dy) {
                let a = &reference.data[(y * w) as usize..][x0..x1];
                let from = ((y + dy) * w) as usize + (x0 as i32 + dx) as usize;
                let b = &current.data[from..from + a.len()];
                sum += a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>();
                n += a.len();
            }
            let mean = sum / n.max(1) as f32;
            if n > 0 && mean < best.0 {
                best = (mean, dx, dy);
            }
        }
    }
    let (dx, dy) = (best.1 as f32, best.2 as f32);
    let (from, to) = (Vec3::Z, Vec3::new(dx / camera.fx, dy / camera.fy, 1.0).normalize());
    best.0.is_finite().then(|| DQuat::from_rotation_arc(from.as_dvec3(), to.as_dvec3()))
}

/// Gauss–Newton on SO(3); returns the rotation, and the mean residual at the start and at the end.
fn refine(reference: &Grey, current: &Grey, camera: &Pinhole, start: DQuat) -> Option<(DQuat, f32, f32)> {
    let mut rotation = start;
    let mut first = None;
    let mut best: Option<(DQuat, f32)> = None;
    for _ in 0..ITERATIONS {
        let system = residuals(reference, current, camera, rotation);
        if system.count * 4 < reference.data.len() {
            break;
        }
        let error = (system.absolute / system.count as f64) as f32;
        first = first.or(Some(error));
        if best.is_some_and(|(_, b)| error >= b) {
            break;
        }
        best = Some((rotation, error));
        let h = Matrix3::from_fn(|a, c| system.h[a.min(c)][a.max(c)] + if a == c { 1e-3 } else { 0.0 });
        let step = h.cholesky()?.solve(&Vector3::new(system.b[0], system.b[1], system.b[2]));
        rotation = (DQuat::from_scaled_axis(DVec3::new(step[0], step[1], step[2])) * rotation).normalize();
        if step.norm() < 1e-4 {
            break;
        }
    }
    best.zip(first).map(|((rotation, error), first)| (rotation, first, error))
}

fn residuals(reference: &Grey, current: &Grey, camera: &Pinhole, rotation: DQuat) -> System {
    let r = Mat3::from_quat(rotation.as_quat());
    let mut system = System::ZERO;
    let mut pairs = Vec::with_capacity(reference.data.len());
    let mut offset = 0.0f64;
    for (i, grey) in reference.data.iter().enumerate().filter(|(_, g)| **g >= 0.0) {
        let x = r * camera.ray((i % reference.width) as f32, (i / reference.width) as f32);
        if x.z < 0.1 {
            continue;
        }
        let Some((value, gradient)) = current.sample(camera.project(x)) else { continue };
        offset += f64::from(value - grey);
        pairs.push((x, value - grey, gradient));
    }
    // The mean difference is a change of exposure, not a residual.
    let offset = (offset / pairs.len().max(1) as f64) as f32;
    for (x, e, gradient) in pairs {
        let e = e - offset;
        let Vec2 { x: gx, y: gy } = gradient * Vec2::new(camera.fx, camera.fy) / x.z;
        let g = Vec3::new(gx, gy, -(gx * x.x + gy * x.y) / x.z);
        // camera_from_reference ← exp(ω) · camera_from_reference moves x by ω × x.
        system.add(&x.cross(g).to_array(), e, 1.0 / (1.0 + e * e * (1.0 / ROBUST_SCALE2)));
        system.count += 1;
        system.absolute += f64::from(e.abs().min(RESIDUAL_CAP));
    }
    system
}
