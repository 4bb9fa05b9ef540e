//! Rotations, in the same operations on every architecture. The operators of `glam` fuse multiplications and additions on aarch64.

use glam::{Quat, Vec3};

/// `v` turned by the unit quaternion `q`.
#[must_use]
pub fn rotate(q: Quat, v: Vec3) -> Vec3 {
    let axis = Vec3::new(q.x, q.y, q.z);
    v * (q.w * q.w - axis.dot(axis)) + axis * (v.dot(axis) * 2.0) + axis.cross(v) * (q.w * 2.0)
}

/// The rotation `b`, then `a`.
#[must_use]
pub fn product(a: Quat, b: Quat) -> Quat {
    Quat::from_xyzw(
        (a.w * b.x + a.x * b.w) + (a.y * b.z - a.z * b.y),
        (a.w * b.y - a.x * b.z) + (a.y * b.w + a.z * b.x),
        (a.w * b.z + a.x * b.y) + (a.z * b.w - a.y * b.x),
        (a.w * b.w - a.x * b.x) - (a.y * b.y + a.z * b.z),
    )
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

    #[test]
    fn a_product_turns_by_the_one_and_then_the_other() {
        let (a, b) = (Quat::from_rotation_x(0.7), Quat::from_rotation_z(-1.9) * Quat::from_rotation_y(0.4));
        let v = Vec3::new(0.3, -0.8, 0.5);
        assert!(rotate(product(a, b), v).distance(rotate(a, rotate(b, v))) < 1e-6);
        assert_eq!(product(a, b).to_array().map(f32::to_bits), (a * b).to_array().map(f32::to_bits));
    }
}
