//! How surfaces reflect: BSDF = (1 − w_s) Lambert(base colour) + w_s GGX mirror lobe of reflectance 1.

use glam::Vec3;
use std::f32::consts::{PI, TAU};

/// The two weights of a blended surface; its base colour comes from the texture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// Weight of the glossy lobe, 0..1.
    pub w_s: f32,
    /// GGX roughness of the lobe.
    pub alpha: f32,
}

impl Material {
    /// Pure Lambert.
    pub const MATTE: Self = Self { w_s: 0.0, alpha: 0.5 };

    /// A glossy blend.
    #[must_use]
    pub const fn glossy(w_s: f32, alpha: f32) -> Self {
        Self { w_s, alpha }
    }

    /// Reflectance · cosine, and the density with which [`Material::sample`] draws `incoming`. All directions leave
    /// the surface; `normal` is the shading normal.
    #[must_use]
    pub fn evaluate(&self, base: Vec3, normal: Vec3, outgoing: Vec3, incoming: Vec3) -> (Vec3, f32) {
        let (cos_i, cos_o) = (normal.dot(incoming), normal.dot(outgoing));
        if cos_i <= 0.0 || cos_o <= 0.0 {
            return (Vec3::ZERO, 0.0);
        }
        let lambert = base * ((1.0 - self.w_s) * cos_i / PI);
        let pick = self.lobe_probability();
        let (gloss, density) = self.evaluate_lobe(normal, outgoing, incoming);
        (lambert + gloss, pick * density + (1.0 - pick) * cos_i / PI)
    }

    /// Reflectance · cosine of the glossy lobe alone, and the density with which [`Material::sample_lobe`] draws
    /// `incoming`.
    #[must_use]
    pub fn evaluate_lobe(&self, normal: Vec3, outgoing: Vec3, incoming: Vec3) -> (f32, f32) {
        let (cos_i, cos_o) = (normal.dot(incoming), normal.dot(outgoing));
        if self.w_s == 0.0 || cos_i <= 0.0 || cos_o <= 0.0 {
            return (0.0, 0.0);
        }
        let d = ggx(normal.dot((incoming + outgoing).normalize()), self.alpha);
        let (lambda_o, lambda_i) = (self.lambda(cos_o), self.lambda(cos_i));
        let scaled = d / (4.0 * cos_o);
        (self.w_s * scaled / (1.0 + lambda_o + lambda_i), scaled / (1.0 + lambda_o))
    }

    /// Draws an incoming direction.
    #[must_use]
    pub fn sample(&self, normal: Vec3, outgoing: Vec3, u: [f32; 2], choose: f32) -> Vec3 {
        if choose < self.lobe_probability() {
            self.sample_lobe(normal, outgoing, u).0
        } else {
            cosine_direction(normal, u)
        }
    }

    /// Draws a direction of the glossy lobe alone, by its visible normals (Heitz 2018), and its weight G2/G1 ≤ 1.
    #[must_use]
    pub fn sample_lobe(&self, normal: Vec3, outgoing: Vec3, u: [f32; 2]) -> (Vec3, f32) {
        let (t, b) = normal.any_orthonormal_pair();
        let o = Vec3::new(t.dot(outgoing), b.dot(outgoing), normal.dot(outgoing).max(1e-4));
        let stretched = Vec3::new(self.alpha * o.x, self.alpha * o.y, o.z).normalize();
        let (t1, t2) = stretched.any_orthonormal_pair();
        let radius = u[0].sqrt();
        let (sine, cosine) = libm::sincosf(TAU * u[1]);
        let p1 = radius * cosine;
        let blend = 0.5 * (1.0 + stretched.z);
        // The lower half of the disc is foreshortened along the projection of the surface normal.
        let up = (Vec3::Z - stretched * stretched.z).try_normalize().unwrap_or(t2);
        let side = up.cross(stretched).try_normalize().unwrap_or(t1);
        let p2 = (1.0 - blend) * (1.0 - p1 * p1).max(0.0).sqrt() + blend * radius * sine;
        let h = side * p1 + up * p2 + stretched * (1.0 - p1 * p1 - p2 * p2).max(0.0).sqrt();
        let h = Vec3::new(self.alpha * h.x, self.alpha * h.y, h.z.max(1e-6)).normalize();
        let i = h * (2.0 * h.dot(o)) - o;
        let weight =
            if i.z <= 0.0 { 0.0 } else { (1.0 + self.lambda(o.z)) / (1.0 + self.lambda(o.z) + self.lambda(i.z)) };
        ((t * i.x + b * i.y + normal * i.z).normalize(), weight)
    }

    fn lobe_probability(&self) -> f32 {
        if self.w_s == 0.0 { 0.0 } else { self.w_s.clamp(0.25, 0.9) }
    }

    /// Smith's Λ for GGX.
    fn lambda(&self, cosine: f32) -> f32 {
        let c2 = cosine * cosine;
        0.5 * ((1.0 + self.alpha * self.alpha * (1.0 - c2) / c2).sqrt() - 1.0)
    }
}

fn ggx(cos_h: f32, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let s = cos_h * cos_h * (a2 - 1.0) + 1.0;
    a2 / (PI * s * s)
}

/// A cosine-distributed direction about a unit normal.
#[must_use]
pub fn cosine_direction(normal: Vec3, u: [f32; 2]) -> Vec3 {
    let (t, b) = normal.any_orthonormal_pair();
    let radius = u[0].sqrt();
    let (sine, cosine) = libm::sincosf(TAU * u[1]);
    (t * (radius * cosine) + b * (radius * sine) + normal * (1.0 - u[0]).max(0.0).sqrt()).normalize()
}
