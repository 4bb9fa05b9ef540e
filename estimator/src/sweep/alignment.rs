//! Rigid alignment of point sets (Umeyama 1991, without scale).

use glam::{DMat3, DVec3};
use nalgebra::{Matrix3, Vector3};

/// Rotation R and translation t that minimise Σ |R a + t − b|² over pairs (a, b); `None` without pairs.
#[must_use]
pub fn rigid_alignment(pairs: &[(DVec3, DVec3)]) -> Option<(DMat3, DVec3)> {
    let n = pairs.len() as f64;
    let (from, to) = pairs.iter().fold((DVec3::ZERO, DVec3::ZERO), |(a, b), p| (a + p.0 / n, b + p.1 / n));
    let mut cross = Matrix3::<f64>::zeros();
    for (a, b) in pairs {
        let (a, b) = ((*a - from).to_array(), (*b - to).to_array());
        cross += Vector3::from(b) * Vector3::from(a).transpose();
    }
    let svd = cross.svd(true, true);
    let (u, v) = (svd.u?, svd.v_t?);
    let sign = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v).determinant().signum()));
    let r = u * sign * v;
    let rotation = DMat3::from_cols_array(&std::array::from_fn(|i| r[(i % 3, i / 3)]));
    (!pairs.is_empty()).then(|| (rotation, to - rotation * from))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    #[test]
    fn a_motion_is_found_again() {
        let rotation = DMat3::from_quat(DQuat::from_xyzw(0.1, -0.4, 0.2, 0.9).normalize());
        let translation = DVec3::new(1.0, -2.0, 0.5);
        let points = [DVec3::ZERO, DVec3::X, DVec3::new(0.0, 2.0, 0.1), DVec3::new(1.0, 1.0, 3.0)];
        let pairs = points.map(|p| (p, rotation * p + translation));
        let (r, t) = rigid_alignment(&pairs).unwrap();
        assert!((r - rotation).to_cols_array().iter().all(|e| e.abs() < 1e-12) && t.distance(translation) < 1e-12);
        assert_eq!(rigid_alignment(&[]), None);
    }
}
