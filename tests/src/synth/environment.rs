//! Distant light: a latitude–longitude map of radiance, sampled by importance.

use glam::Vec3;
use std::f32::consts::{PI, TAU};

/// Radiance from every direction. Row r, column c of the map: polar angle θ = (r+½)/H·π from +Z, azimuth
/// a = 2π(c+½)/W from +Y, clockwise seen from above; direction = (sin θ sin a, sin θ cos a, cos θ).
#[derive(Debug, Clone)]
pub struct Environment {
    width: usize,
    height: usize,
    map: Vec<Vec3>,
    /// Cumulated probability of the rows, and of the texels within each row; last entry 1.
    rows: Vec<f32>,
    columns: Vec<f32>,
    /// Density per steradian of each texel.
    density: Vec<f32>,
}

/// Rec. 709 luminance.
#[must_use]
pub fn luminance(color: Vec3) -> f32 {
    color.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

impl Environment {
    /// Samples `radiance(direction)` on a `height` × `2 height` map.
    #[must_use]
    pub fn new(height: usize, radiance: impl Fn(Vec3) -> Vec3) -> Self {
        let width = 2 * height;
        let direction =
            |r: usize, c: usize| direction_of((r as f32 + 0.5) / height as f32, (c as f32 + 0.5) / width as f32);
        Self::from_map((0..height * width).map(|k| radiance(direction(k / width, k % width)).max(Vec3::ZERO)).collect())
    }

    /// A map of H × 2H texels, `[row][column]`.
    #[must_use]
    pub fn from_map(map: Vec<Vec3>) -> Self {
        let height = (map.len() / 2).isqrt();
        let width = 2 * height;
        let solid = solid_angles(height, width);
        let weights: Vec<f32> = (0..height * width)
            .map(|k| {
                // The lookup is bilinear: a texel's light reaches its neighbours, which must not have density 0.
                let (r, c) = (k / width, k % width);
                let around = [
                    (r, (c + 1) % width),
                    (r, (c + width - 1) % width),
                    ((r + 1).min(height - 1), c),
                    (r.saturating_sub(1), c),
                ];
                let neighbours: f32 = around.iter().map(|&(r, c)| luminance(map[r * width + c])).sum();
                (luminance(map[k]) + 0.05 * neighbours + 1e-6) * solid[r]
            })
            .collect();
        let total: f64 = weights.iter().map(|&w| f64::from(w)).sum();
        let mut rows = Vec::with_capacity(height);
        let mut columns = Vec::with_capacity(height * width);
        let mut below = 0.0f64;
        for row in weights.chunks(width) {
            let sum: f64 = row.iter().map(|&w| f64::from(w)).sum();
            let mut left = 0.0f64;
            columns.extend(row.iter().map(|&w| {
                left += f64::from(w);
                (left / sum) as f32
            }));
            below += sum;
            rows.push((below / total) as f32);
        }
        let density = (0..height * width)
            .map(|k| {
                let r = k / width;
                let of_row = rows[r] - if r > 0 { rows[r - 1] } else { 0.0 };
                let of_column = columns[k] - if k % width > 0 { columns[k - 1] } else { 0.0 };
                of_row * of_column / solid[r]
            })
            .collect();
        Self { width, height, map, rows, columns, density }
    }

    /// The same radiance from everywhere.
    #[must_use]
    pub fn uniform(radiance: Vec3) -> Self {
        Self::new(8, |_| radiance)
    }

    /// The map, `[row][column]`, and its number of rows.
    #[must_use]
    pub fn map(&self) -> (usize, &[Vec3]) {
        (self.height, &self.map)
    }

    /// Radiance times a factor.
    #[must_use]
    pub fn scaled(mut self, factor: f32) -> Self {
        self.map.iter_mut().for_each(|l| *l *= factor);
        self
    }

    /// Scaled so that the mean luminance over the sphere is 1.
    #[must_use]
    pub fn normalised(mut self) -> Self {
        let solid = solid_angles(self.height, self.width);
        let mean =
            self.map.iter().enumerate().map(|(k, &l)| luminance(l) * solid[k / self.width]).sum::<f32>() / (4.0 * PI);
        self.map.iter_mut().for_each(|l| *l /= mean);
        self
    }

    /// Radiance arriving from a unit direction (bilinear between texel centres).
    #[must_use]
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        let (v, u) = coordinates(direction);
        let (y, x) = (v * self.height as f32 - 0.5, u * self.width as f32 - 0.5);
        let (r, c) = (y.floor(), x.floor());
        let (fy, fx) = (y - r, x - c);
        let row = |r: f32| (r.max(0.0) as usize).min(self.height - 1) * self.width;
        let column = |c: f32| (c as isize).rem_euclid(self.width as isize) as usize;
        let (r0, r1, c0, c1) = (row(r), row(r + 1.0), column(c), column(c + 1.0));
        let top = self.map[r0 + c0].lerp(self.map[r0 + c1], fx);
        top.lerp(self.map[r1 + c0].lerp(self.map[r1 + c1], fx), fy)
    }

    /// A direction drawn by radiance, and its density per steradian.
    #[must_use]
    pub fn sample(&self, u: [f32; 2]) -> (Vec3, f32) {
        let pick = |cumulated: &[f32], u: f32| {
            let k = cumulated.partition_point(|&p| p <= u).min(cumulated.len() - 1);
            let start = if k > 0 { cumulated[k - 1] } else { 0.0 };
            (k, ((u - start) / (cumulated[k] - start).max(1e-12)).clamp(0.0, 1.0))
        };
        let (r, dv) = pick(&self.rows, u[0]);
        let (c, du) = pick(&self.columns[r * self.width..(r + 1) * self.width], u[1]);
        // Uniform over the texel's solid angle: linear in the cosine.
        let edge = |r: usize| libm::cosf(PI * r as f32 / self.height as f32);
        let cosine = edge(r) + (edge(r + 1) - edge(r)) * dv;
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        let (s, k) = libm::sincosf(TAU * (c as f32 + du) / self.width as f32);
        (Vec3::new(sine * s, sine * k, cosine), self.density[r * self.width + c])
    }

    /// Density per steradian with which [`Environment::sample`] draws a direction.
    #[must_use]
    pub fn density(&self, direction: Vec3) -> f32 {
        let (v, u) = coordinates(direction);
        let r = ((v * self.height as f32) as usize).min(self.height - 1);
        let c = ((u * self.width as f32) as usize).min(self.width - 1);
        self.density[r * self.width + c]
    }

    /// Coefficients of radiance in real orthonormal spherical harmonics, l ≤ `order`, index l(l+1)+m, no
    /// Condon–Shortley phase, world axes.
    #[must_use]
    pub fn spherical_harmonics(&self, order: usize) -> Vec<[f64; 3]> {
        let solid = solid_angles(self.height, self.width);
        let mut coefficients = vec![[0.0; 3]; (order + 1) * (order + 1)];
        for (k, l) in self.map.iter().enumerate() {
            let (r, c) = (k / self.width, k % self.width);
            let d = direction_of((r as f32 + 0.5) / self.height as f32, (c as f32 + 0.5) / self.width as f32);
            let weight = f64::from(solid[r]);
            for (sum, y) in coefficients.iter_mut().zip(harmonics(order, d)) {
                for (s, l) in sum.iter_mut().zip(l.to_array()) {
                    *s += y * f64::from(l) * weight;
                }
            }
        }
        coefficients
    }
}

/// All Y_lm(direction) with l ≤ `order`: real, orthonormal, index l(l+1)+m, no Condon–Shortley phase.
#[must_use]
pub fn harmonics(order: usize, direction: Vec3) -> Vec<f64> {
    let [x, y, z] = direction.to_array().map(f64::from);
    let azimuth = libm::atan2(y, x);
    let sine = (1.0 - z * z).max(0.0).sqrt();
    let mut out = vec![0.0; (order + 1) * (order + 1)];
    let mut diagonal = (0.25 / std::f64::consts::PI).sqrt();
    for m in 0..=order {
        if m > 0 {
            diagonal *= sine * ((2 * m + 1) as f64 / (2 * m) as f64).sqrt();
        }
        // Orthonormal associated Legendre functions, upwards in l at fixed m.
        let (mut before, mut here) = (0.0, diagonal);
        for l in m..=order {
            let (lf, mf) = (l as f64, m as f64);
            if m == 0 {
                out[l * (l + 1)] = here;
            } else {
                let scale = std::f64::consts::SQRT_2 * here;
                out[l * (l + 1) + m] = scale * libm::cos(mf * azimuth);
                out[l * (l + 1) - m] = scale * libm::sin(mf * azimuth);
            }
            let ratio = |l: f64| ((4.0 * l * l - 1.0) / (l * l - mf * mf)).sqrt();
            let next = ratio(lf + 1.0) * (z * here - if l > m { before / ratio(lf) } else { 0.0 });
            (before, here) = (here, next);
        }
    }
    out
}

fn direction_of(v: f32, u: f32) -> Vec3 {
    let (st, ct) = libm::sincosf(PI * v);
    let (sa, ca) = libm::sincosf(TAU * u);
    Vec3::new(st * sa, st * ca, ct)
}

/// Map coordinates (v down, u right) in [0, 1].
fn coordinates(direction: Vec3) -> (f32, f32) {
    let u = libm::atan2f(direction.x, direction.y) / TAU;
    (libm::acosf(direction.z.clamp(-1.0, 1.0)) / PI, if u < 0.0 { u + 1.0 } else { u })
}

/// Solid angle of a texel, by row.
fn solid_angles(height: usize, width: usize) -> Vec<f32> {
    let edge = |r: usize| libm::cos(std::f64::consts::PI * r as f64 / height as f64);
    (0..height).map(|r| ((edge(r) - edge(r + 1)) * std::f64::consts::TAU / width as f64) as f32).collect()
}
