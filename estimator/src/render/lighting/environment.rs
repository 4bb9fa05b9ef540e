//! Distant light as radiance over all directions: what rays that leave the scene see, and where to send them.
//!
//! Directions are kept on an octahedral square (Cigolle et al., "A Survey of Efficient Representations for Independent
//! Unit Vectors", JCGT 2014): cheap to look up, without poles.

use crate::numerics::cielab::luminance;
use crate::numerics::sh;
use glam::{Vec2, Vec3};
use rayon::prelude::*;
use recordings::result::Light;

/// Texels along a side: 0.7° each, finer than the light that a scan can recover.
pub const SIDE: usize = 256;
/// Texels along a side of a light that is known by few directions or coefficients.
const SMOOTH_SIDE: usize = 64;

/// Distant light.
#[derive(Debug, Clone)]
pub struct Environment {
    /// RGB radiance per texel: `[row][column]`.
    radiance: Vec<Vec3>,
    /// Share of the luminance in rows up to and including each.
    rows: Vec<f32>,
    /// The same within each row: `[row][column]`.
    columns: Vec<f32>,
    /// ∫ luminance dω.
    flux: f32,
}

/// Unit direction of a point of the square [-1, 1]², and dω/dA there.
fn unfold(p: Vec2) -> (Vec3, f32) {
    let z = 1.0 - p.x.abs() - p.y.abs();
    let xy = if z >= 0.0 {
        p
    } else {
        Vec2::new((1.0 - p.y.abs()) * 1f32.copysign(p.x), (1.0 - p.x.abs()) * 1f32.copysign(p.y))
    };
    let d = xy.extend(z);
    let length = d.length();
    (d / length, 1.0 / (length * length * length))
}

/// The inverse of [`unfold`].
fn fold(d: Vec3) -> Vec2 {
    let p = d / (d.x.abs() + d.y.abs() + d.z.abs());
    if p.z >= 0.0 {
        Vec2::new(p.x, p.y)
    } else {
        Vec2::new((1.0 - p.y.abs()) * 1f32.copysign(p.x), (1.0 - p.x.abs()) * 1f32.copysign(p.y))
    }
}

fn texel_center(index: usize, side: usize) -> Vec2 {
    let at = |i: usize| (2 * i + 1) as f32 / side as f32 - 1.0;
    Vec2::new(at(index % side), at(index / side))
}

/// Texel that holds `direction`, row-major.
#[must_use]
pub fn texel(direction: Vec3) -> usize {
    let p = (fold(direction) * 0.5 + 0.5) * SIDE as f32;
    (p.y as usize).min(SIDE - 1) * SIDE + (p.x as usize).min(SIDE - 1)
}

/// Unit direction of a texel's centre.
#[must_use]
pub fn direction(texel: usize) -> Vec3 {
    unfold(texel_center(texel, SIDE)).0
}

/// Bilinear lookup in an octahedral map; beyond a border the square goes on mirrored along that border.
fn lookup(map: &[Vec3], side: usize, direction: Vec3) -> Vec3 {
    let p = (fold(direction) * 0.5 + 0.5) * side as f32 - 0.5;
    let (x0, y0) = (libm::floorf(p.x), libm::floorf(p.y));
    let (fx, fy) = (p.x - x0, p.y - y0);
    let n = side as i32;
    let at = |x: i32, y: i32| {
        let (mut x, mut y) = (x, y);
        if x < 0 || x >= n {
            (x, y) = (x.clamp(0, n - 1), n - 1 - y);
        }
        if y < 0 || y >= n {
            (x, y) = (n - 1 - x, y.clamp(0, n - 1));
        }
        map[y.clamp(0, n - 1) as usize * side + x.clamp(0, n - 1) as usize]
    };
    let (x, y) = (x0 as i32, y0 as i32);
    at(x, y) * ((1.0 - fx) * (1.0 - fy))
        + at(x + 1, y) * (fx * (1.0 - fy))
        + at(x, y + 1) * ((1.0 - fx) * fy)
        + at(x + 1, y + 1) * (fx * fy)
}

impl Environment {
    /// Light whose radiance from a unit direction is `radiance(direction)`; negative and non-finite values count as 0.
    #[must_use]
    pub fn from_fn(radiance: impl Fn(Vec3) -> Vec3 + Sync) -> Self {
        Self::from_texels((0..SIDE * SIDE).into_par_iter().map(|i| radiance(unfold(texel_center(i, SIDE)).0)).collect())
    }

    /// The same for radiance with details smaller than a texel.
    #[must_use]
    pub fn averaged(radiance: impl Fn(Vec3) -> Vec3 + Sync) -> Self {
        const GRID: usize = 3;
        let point = |texel: usize, i: usize| {
            let fine = SIDE * GRID;
            let (x, y) = ((texel % SIDE) * GRID + i % GRID, (texel / SIDE) * GRID + i / GRID);
            unfold(texel_center(y * fine + x, fine)).0
        };
        Self::from_texels(
            (0..SIDE * SIDE)
                .into_par_iter()
                .map(|t| (0..GRID * GRID).map(|i| radiance(point(t, i))).sum::<Vec3>() / (GRID * GRID) as f32)
                .collect(),
        )
    }

    /// The light of a result: its non-negative radiance if that was kept, otherwise its spherical harmonics where positive.
    #[must_use]
    pub fn from_light(light: &Light) -> Self {
        let n = light.directions.len().min(light.radiance.len());
        let coarse: Vec<Vec3> = (0..SMOOTH_SIDE * SMOOTH_SIDE)
            .into_par_iter()
            .map(|i| {
                let d = unfold(texel_center(i, SMOOTH_SIDE)).0;
                if n > 0 {
                    smoothed(&light.directions[..n], &light.radiance[..n], d)
                } else {
                    Vec3::from(sh::radiance(&light.coefficients, d.as_dvec3()).map(|x| x as f32)).max(Vec3::ZERO)
                }
            })
            .collect();
        Self::from_fn(|d| lookup(&coarse, SMOOTH_SIDE, d))
    }

    /// From RGB radiance per texel: `[SIDE][SIDE]`.
    #[must_use]
    pub fn from_texels(mut radiance: Vec<Vec3>) -> Self {
        radiance.iter_mut().for_each(|r| *r = if r.is_finite() { r.max(Vec3::ZERO) } else { Vec3::ZERO });
        let area = 4.0 / (SIDE * SIDE) as f32;
        let mut columns = vec![0.0f32; SIDE * SIDE];
        let mut rows = vec![0.0f32; SIDE];
        let mut flux = 0.0f64;
        for y in 0..SIDE {
            let mut sum = 0.0f64;
            for x in 0..SIDE {
                let i = y * SIDE + x;
                sum += f64::from(luminance(radiance[i]) * unfold(texel_center(i, SIDE)).1 * area);
                columns[i] = sum as f32;
            }
            flux += sum;
            rows[y] = flux as f32;
            let scale = if sum > 0.0 { (1.0 / sum) as f32 } else { 0.0 };
            columns[y * SIDE..(y + 1) * SIDE].iter_mut().for_each(|c| *c *= scale);
        }
        let scale = if flux > 0.0 { (1.0 / flux) as f32 } else { 0.0 };
        rows.iter_mut().for_each(|r| *r *= scale);
        Self { radiance, rows, columns, flux: flux as f32 }
    }

    /// The same light with texels replaced: `known(texel, radiance there)` is the new radiance.
    #[must_use]
    pub fn overlaid(&self, known: impl Fn(usize, Vec3) -> Vec3) -> Self {
        Self::from_texels(self.radiance.iter().enumerate().map(|(i, r)| known(i, *r)).collect())
    }

    /// Radiance that arrives from the unit `direction`.
    #[must_use]
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        lookup(&self.radiance, SIDE, direction)
    }

    /// A direction, drawn in proportion to luminance.
    #[must_use]
    pub fn sample(&self, u: [f32; 2]) -> Vec3 {
        let pick = |shares: &[f32], u: f32| {
            let i = shares.partition_point(|s| *s <= u).min(shares.len() - 1);
            let before = if i == 0 { 0.0 } else { shares[i - 1] };
            let width = shares[i] - before;
            (i, if width > 0.0 { ((u - before) / width).clamp(0.0, 1.0) } else { 0.5 })
        };
        let (y, v) = pick(&self.rows, u[0]);
        let (x, u) = pick(&self.columns[y * SIDE..(y + 1) * SIDE], u[1]);
        let at = |i: usize, f: f32| 2.0 * (i as f32 + f) / SIDE as f32 - 1.0;
        unfold(Vec2::new(at(x, u), at(y, v))).0
    }

    /// Density of [`Environment::sample`] per steradian.
    #[must_use]
    pub fn density(&self, direction: Vec3) -> f32 {
        if self.flux <= 0.0 {
            return 0.0;
        }
        let i = texel(direction);
        // Within a texel the density is even over the square, not over the sphere.
        let here = 1.0 / unfold(fold(direction)).1;
        luminance(self.radiance[i]) * unfold(texel_center(i, SIDE)).1 * here / self.flux
    }

    /// Spherical harmonics of the light: `bands²` rows of RGB coefficients.
    #[must_use]
    pub fn project(&self, bands: usize) -> Vec<[f64; 3]> {
        let area = 4.0 / (SIDE * SIDE) as f64;
        let rows: Vec<Vec<[f64; 3]>> = (0..SIDE)
            .into_par_iter()
            .map(|row| {
                let mut sum = vec![[0.0; 3]; bands * bands];
                let mut y = [0.0; sh::MAX_COEFFICIENTS];
                for i in row * SIDE..(row + 1) * SIDE {
                    let (d, weight) = unfold(texel_center(i, SIDE));
                    sh::eval(d.as_dvec3(), &mut y[..bands * bands]);
                    let l = self.radiance[i].as_dvec3() * (f64::from(weight) * area);
                    for (s, y) in sum.iter_mut().zip(&y) {
                        *s = [s[0] + l.x * y, s[1] + l.y * y, s[2] + l.z * y];
                    }
                }
                sum
            })
            .collect();
        let mut sum = vec![[0.0; 3]; bands * bands];
        for row in rows {
            sum.iter_mut().zip(row).for_each(|(s, r)| *s = [s[0] + r[0], s[1] + r[1], s[2] + r[2]]);
        }
        sum
    }
}

/// Radiance known at directions that each stand for 4π/n steradians, smoothed over about their spacing.
fn smoothed(directions: &[[f32; 3]], radiance: &[[f32; 3]], d: Vec3) -> Vec3 {
    let sharpness = directions.len() as f32 * 0.35;
    let (mut sum, mut weight) = (Vec3::ZERO, 0.0);
    for (at, r) in directions.iter().zip(radiance) {
        let w = libm::expf(sharpness * (d.dot(Vec3::from(*at)) - 1.0));
        sum += Vec3::from(*r) * w;
        weight += w;
    }
    if weight > 0.0 { sum / weight } else { Vec3::ZERO }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::sampling::point;
    use std::f32::consts::PI;

    #[test]
    fn texels_cover_the_sphere_once() {
        let total: f32 = (0..SIDE * SIDE).map(|i| unfold(texel_center(i, SIDE)).1 * 4.0 / (SIDE * SIDE) as f32).sum();
        assert!((total - 4.0 * PI).abs() < 1e-2, "{total}");
        for d in sh::even_directions(97) {
            let d = d.as_vec3();
            assert!((unfold(fold(d)).0 - d).length() < 1e-5);
        }
    }

    #[test]
    fn sampling_is_unbiased_and_its_density_integrates_to_one() {
        let light = Environment::from_fn(|d| Vec3::new(1.0, 0.5, 0.25) * (0.1 + 20.0 * (d.x - 0.9).max(0.0)));
        let n = 20_000;
        let estimate: f32 = (0..n)
            .map(|i| {
                let d = light.sample(point(i, 5));
                light.radiance(d).y / light.density(d) / n as f32
            })
            .sum();
        let exact = light.project(1)[0][1] as f32 / 0.282_094_8;
        assert!((estimate / exact - 1.0).abs() < 0.01, "{estimate} {exact}");
        let mass: f32 =
            sh::even_directions(200_000).iter().map(|d| light.density(d.as_vec3()) * 4.0 * PI / 200_000.0).sum();
        assert!((mass - 1.0).abs() < 0.01, "{mass}");
    }

    #[test]
    fn projection_returns_the_coefficients() {
        let mut c = vec![[0.0; 3]; 9];
        c[0] = [3.0, 2.0, 1.0];
        c[3] = [0.5, -0.3, 0.1];
        c[6] = [0.1, 0.2, 0.0];
        let light = Light { coefficients: c.clone(), ..Light::default() };
        let back = Environment::from_light(&light).project(3);
        for (a, b) in c.iter().flatten().zip(back.iter().flatten()) {
            assert!((a - b).abs() < 5e-3, "{a} {b}");
        }
    }
}
