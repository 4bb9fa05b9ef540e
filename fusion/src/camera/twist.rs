//! Twists as vectors of unknowns: (translation in metres, rotation in radians).

use glam::DVec3;
use nalgebra::Vector6;
use recordings::types::Pose;

/// [`Pose::exp`] of a twist.
pub fn exp(d: &Vector6<f64>) -> Pose {
    Pose::exp(DVec3::new(d[3], d[4], d[5]), DVec3::new(d[0], d[1], d[2]))
}

/// [`Pose::log`] as a twist.
pub fn log(p: &Pose) -> Vector6<f64> {
    let (r, t) = p.log();
    Vector6::new(t.x, t.y, t.z, r.x, r.y, r.z)
}
