//! How a surface reflects: materials of glTF's metallic-roughness model, their textures, and the lobes they become.

use crate::render::sampling::{ggx, smith};
use glam::{Vec2, Vec3};
use recordings::types::RgbImage;
use std::sync::Arc;

/// A picture on a surface, repeated in both directions; linear RGB.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    width: usize,
    height: usize,
    pixels: Vec<Vec3>,
}

impl Texture {
    /// From 8-bit values and what each stands for.
    #[must_use]
    pub fn new(image: &RgbImage, table: &[f32; 256]) -> Self {
        let linear = |p: &[u8]| Vec3::new(table[p[0] as usize], table[p[1] as usize], table[p[2] as usize]);
        let pixels = image.data.chunks_exact(3).map(linear).collect();
        Self { width: image.width as usize, height: image.height as usize, pixels }
    }

    /// Bilinear colour at texture coordinates.
    pub fn at(&self, uv: Vec2) -> Vec3 {
        if self.pixels.is_empty() || !uv.is_finite() {
            return Vec3::ONE;
        }
        let wrap = |x: f32, n: usize| {
            let x = (x - libm::floorf(x)) * n as f32 - 0.5;
            let low = libm::floorf(x);
            let i = (low as i64).rem_euclid(n as i64) as usize;
            (i, (i + 1) % n, x - low)
        };
        let (x0, x1, fx) = wrap(uv.x, self.width);
        let (y0, y1, fy) = wrap(uv.y, self.height);
        let row = |y: usize| self.pixels[y * self.width + x0].lerp(self.pixels[y * self.width + x1], fx);
        row(y0).lerp(row(y1), fy)
    }
}

/// A material of glTF's metallic-roughness model; `mirror` is a recovered w_s, which knows no Fresnel term.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// Linear base colour.
    pub base_color: Vec3,
    /// 0 = dielectric, 1 = metal.
    pub metallic: f32,
    /// Perceptual roughness; the GGX width is its square.
    pub roughness: f32,
    /// Strength of the dielectric's reflection (KHR_materials_specular).
    pub specular: f32,
    /// Share of light that is mirrored at every angle (w_s of Eq. 13).
    pub mirror: f32,
    /// Base colour picture.
    pub texture: Option<Arc<Texture>>,
    /// Roughness (green) and metalness (blue).
    pub metallic_roughness: Option<Arc<Texture>>,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            base_color: Vec3::ONE,
            metallic: 0.0,
            roughness: 1.0,
            specular: 0.0,
            mirror: 0.0,
            texture: None,
            metallic_roughness: None,
        }
    }
}

/// Reflection at a point of a surface: Lambert of `diffuse` and a GGX lobe of width `alpha` whose reflectance goes
/// from `f0` head-on to `f90` at grazing angles.
#[derive(Debug, Clone, Copy)]
pub struct Brdf {
    /// Diffuse albedo.
    pub diffuse: Vec3,
    /// Reflectance of the lobe head-on.
    pub f0: Vec3,
    /// Reflectance at grazing angles.
    pub f90: f32,
    /// GGX width.
    pub alpha: f32,
}

impl Brdf {
    /// A diffuse surface without a lobe.
    #[must_use]
    pub fn lambertian(diffuse: Vec3) -> Self {
        Self { diffuse, f0: Vec3::ZERO, f90: 0.0, alpha: 1.0 }
    }

    /// True if the lobe reflects nothing.
    #[must_use]
    pub fn is_diffuse(&self) -> bool {
        self.f90 <= 0.0 && self.f0.max_element() <= 0.0
    }

    /// Reflectance of the lobe per steradian, times the cosine of the unit direction `out`; 0 from behind.
    #[must_use]
    pub fn lobe(&self, normal: Vec3, view: Vec3, out: Vec3) -> Vec3 {
        let half = (view + out).normalize_or(normal);
        let (nv, no) = (normal.dot(view).max(1e-3), normal.dot(out));
        if no <= 0.0 || self.is_diffuse() {
            return Vec3::ZERO;
        }
        let masked = smith(nv, self.alpha) * smith(no, self.alpha);
        self.reflectance(view.dot(half).abs()) * (ggx(normal.dot(half), self.alpha) * masked / (4.0 * nv))
    }

    /// Schlick's approximation at the cosine between view and microfacet.
    #[must_use]
    pub fn reflectance(&self, cos: f32) -> Vec3 {
        let w = libm::powf((1.0 - cos).clamp(0.0, 1.0), 5.0);
        self.f0 + (Vec3::splat(self.f90) - self.f0) * w
    }
}
