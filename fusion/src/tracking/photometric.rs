//! The photometric term: grey values of a reference's points in the frame.

use crate::camera::pinhole::Rigid;
use crate::camera::rig::Rig;
use crate::frame::preprocess::Frame;
use crate::tracking::normal_equations::{System, sum_chunks};
use crate::tracking::reference::PhotoPoint;
use glam::{Vec2, Vec3};
use recordings::types::Pose;

/// Change of brightness from the reference to the frame: grey = gain · reference + offset.
#[derive(Debug, Clone, Copy)]
pub struct Brightness {
    pub gain: f32,
    pub offset: f32,
}

/// What the photometric term compares.
pub struct Comparison<'a> {
    pub frame: &'a Frame,
    pub rig: &'a Rig,
    /// Pyramid level.
    pub level: usize,
    /// Points of the reference.
    pub points: &'a [PhotoPoint],
    pub brightness: Brightness,
    /// Scale of the residuals, grey values.
    pub sigma: f32,
}

/// Normal equations of r = I(π(x)) − (gain · I_ref + offset) over a reference's points, with Student's t weights. `columns`
/// maps the derivatives by pose (6), gain and offset, and the pixel position, to the derivatives by the unknowns.
pub fn photometric<const N: usize>(
    comparison: &Comparison,
    camera_from_reference: &Pose,
    columns: impl Fn([f32; 8], Vec2) -> [f32; N] + Sync,
) -> System {
    let Comparison { frame, rig, level, points, brightness, sigma } = *comparison;
    let t = Rigid::from(camera_from_reference);
    let camera = &rig.grey[level];
    let grey = &frame.grey[level];
    let shutter = frame.motion.of_color(rig);
    sum_chunks(points, |points| {
        let mut system = System::ZERO;
        for point in points {
            let x = t.apply(point.p);
            if x.z < 0.1 {
                continue;
            }
            let (x, q) = shutter.project(camera, x);
            let Some((value, gradient)) = grey.sample(q) else { continue };
            let r = value - (brightness.gain * point.grey + brightness.offset);
            let iz = 1.0 / x.z;
            let (gx, gy) = (gradient.x * camera.fx * iz, gradient.y * camera.fy * iz);
            // ∂r/∂x; moving the camera by δ moves x by −(v + ω × x).
            let a = Vec3::new(gx, gy, -(gx * x.x + gy * x.y) * iz);
            let c = x.cross(a);
            let scaled = r / sigma;
            // Student's t with 5 degrees of freedom (Kerl, Sturm, Cremers 2013).
            let w = 6.0 / (5.0 + scaled * scaled) / (sigma * sigma);
            let j = [-a.x, -a.y, -a.z, -c.x, -c.y, -c.z, -point.grey, -1.0];
            system.add(&columns(j, q), r, w);
            system.count += 1;
            system.inliers += usize::from(scaled.abs() < 3.0);
            system.absolute += f64::from(r.abs());
        }
        system
    })
}
