//! Rotation of vectors, in the same operations on every architecture.

use glam::{Quat, Vec3};

/// `v` turned by the unit quaternion `q`. The operator of `glam` fuses multiplications and additions on aarch64.
#[must_use]
pub fn rotate(q: Quat, v: Vec3) -> Vec3 {
    let axis = Vec3::new(q.x, q.y, q.z);
    v * (q.w * q.w - axis.dot(axis)) + axis * (v.dot(axis) * 2.0) + axis.cross(v) * (q.w * 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    /// Checksum of a thousand turned vectors' bits: as on x86-64, so on aarch64.
    const SUM: u64 = 0x6e0e_b7ab_4d18_7d95;

    #[test]
    fn the_bits_are_the_same_on_every_architecture() {
        let mut state = 12345u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as f32 / 8_388_608.0 - 1.0
        };
        let mut sum = 0u64;
        for _ in 0..1000 {
            let q = DQuat::from_array([0; 4].map(|_| f64::from(next()))).normalize();
            let v = Vec3::from_array([0; 3].map(|_| next()));
            let turned = rotate(q.as_quat(), v);
            assert!(turned.as_dvec3().distance(q * v.as_dvec3()) < 1e-6);
            for x in turned.to_array() {
                sum = (sum ^ u64::from(x.to_bits())).wrapping_mul(0x100_0000_01b3).rotate_left(17);
            }
        }
        assert_eq!(sum, SUM);
    }
}
