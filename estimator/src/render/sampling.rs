//! Points and directions for Monte Carlo integration, seeded: the same index gives the same direction everywhere.

use crate::numerics::random::{hash, unit};
use glam::Vec3;
use std::f32::consts::{PI, TAU};

/// Point `index` of Roberts' R2 sequence on the unit square, turned by `seed` (a Cranley–Patterson rotation).
#[must_use]
pub fn point(index: u32, seed: u32) -> [f32; 2] {
    let x = index.wrapping_mul(3_242_174_889).wrapping_add(hash(seed, 1));
    let y = index.wrapping_mul(2_447_445_413).wrapping_add(hash(seed, 2));
    [unit(x), unit(y)]
}

/// A cosine-distributed direction about the unit `normal`; its density is cos/π.
#[must_use]
pub fn cosine(normal: Vec3, u: [f32; 2]) -> Vec3 {
    let (s, c) = libm::sincosf(TAU * u[1]);
    let r = u[0].sqrt();
    let (t, b) = normal.any_orthonormal_pair();
    (t * (r * c) + b * (r * s) + normal * (1.0 - u[0]).max(0.0).sqrt()).normalize()
}

/// A cone of directions of equal density.
#[derive(Debug, Clone, Copy)]
pub struct Cone {
    axis: Vec3,
    cos: f32,
    /// 1 − cos, without cancellation.
    cap: f32,
}

impl Cone {
    /// The directions from `point` to a sphere; `None` from inside it.
    #[must_use]
    pub fn towards(point: Vec3, center: Vec3, radius: f32) -> Option<Self> {
        let d = center - point;
        let far2 = d.length_squared();
        let sin2 = radius * radius / far2;
        (sin2 < 0.9).then(|| {
            let cos = (1.0 - sin2).sqrt();
            Self { axis: d / far2.sqrt(), cos, cap: sin2 / (1.0 + cos) }
        })
    }

    /// Solid angle in steradians.
    #[must_use]
    pub fn solid_angle(&self) -> f32 {
        TAU * self.cap
    }

    /// A direction of the cone; its density is 1 / solid angle.
    #[must_use]
    pub fn sample(&self, u: [f32; 2]) -> Vec3 {
        let below = u[0] * self.cap;
        let (z, r) = (1.0 - below, (below * (2.0 - below)).max(0.0).sqrt());
        let (s, c) = libm::sincosf(TAU * u[1]);
        let (t, b) = self.axis.any_orthonormal_pair();
        (t * (r * c) + b * (r * s) + self.axis * z).normalize()
    }

    /// Density of [`Cone::sample`].
    #[must_use]
    pub fn density(&self, direction: Vec3) -> f32 {
        if direction.dot(self.axis) >= self.cos { 1.0 / self.solid_angle().max(1e-9) } else { 0.0 }
    }

    /// Cosine at which the cone's most favourable direction meets `normal`; 0 where all of it is behind the surface.
    #[must_use]
    pub fn highest_cosine(&self, normal: Vec3) -> f32 {
        let c = self.axis.dot(normal).clamp(-1.0, 1.0);
        if c >= self.cos {
            return 1.0;
        }
        // cos(a − b) of the angle to the axis and the half angle.
        let sin = |x: f32| (1.0 - x * x).max(0.0).sqrt();
        (c * self.cos + sin(c) * sin(self.cos)).max(0.0)
    }
}

/// A microfacet normal of the GGX distribution about `normal` (Walter et al. 2007, Eq. 35–36), `alpha` its width.
#[must_use]
pub fn ggx_normal(normal: Vec3, alpha: f32, u: [f32; 2]) -> Vec3 {
    let cos2 = (1.0 - u[0]) / (1.0 + (alpha * alpha - 1.0) * u[0]);
    let r = (1.0 - cos2).max(0.0).sqrt();
    let (s, c) = libm::sincosf(TAU * u[1]);
    let (t, b) = normal.any_orthonormal_pair();
    (t * (r * c) + b * (r * s) + normal * cos2.max(0.0).sqrt()).normalize()
}

/// Density of the GGX distribution at the cosine between a microfacet's normal and the surface's.
#[must_use]
pub fn ggx(cos: f32, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let s = cos * cos * (a2 - 1.0) + 1.0;
    a2 / (PI * s * s)
}

/// Smith's masking of one direction for GGX.
#[must_use]
pub fn smith(cos: f32, alpha: f32) -> f32 {
    let c = cos.clamp(1e-4, 1.0);
    2.0 * c / (c + (alpha * alpha + (1.0 - alpha * alpha) * c * c).sqrt())
}

/// Density of [`cosine`].
#[must_use]
pub fn cosine_density(cos: f32) -> f32 {
    cos.max(0.0) / PI
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cone_covers_its_solid_angle_and_no_more() {
        let cone = Cone::towards(Vec3::ZERO, Vec3::new(0.0, 3.0, 4.0), 2.0).unwrap();
        for i in 0..500 {
            let d = cone.sample(point(i, 7));
            assert!(d.dot(Vec3::new(0.0, 0.6, 0.8)) >= cone.cos - 1e-5);
            assert!(
                (cone.density(d * 0.999_999 + Vec3::new(0.0, 0.6, 0.8) * 1e-6) * cone.solid_angle() - 1.0).abs() < 1e-4
            );
        }
        assert!(Cone::towards(Vec3::ZERO, Vec3::X, 1.5).is_none());
    }

    #[test]
    fn cosine_directions_integrate_the_cosine() {
        let n = Vec3::new(0.36, -0.48, 0.8);
        let mean: Vec3 = (0..2000).map(|i| cosine(n, point(i, 3))).sum::<Vec3>() / 2000.0;
        assert!((mean - n * (2.0 / 3.0)).length() < 5e-3, "{mean}");
    }
}
