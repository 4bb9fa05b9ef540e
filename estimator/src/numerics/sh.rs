//! Real orthonormal spherical harmonics, no Condon–Shortley phase, index `l*(l+1)+m`, polar axis +Z, up to nine bands.

use glam::{DVec3, Vec3};
use std::f64::consts::PI;
use std::sync::LazyLock;

/// Largest number of bands (l_max + 1).
pub const MAX_BANDS: usize = 9;
/// Bands of the light used for mirror reflections: higher bands would be too sharp for a specular weight without a lobe width.
pub const MIRRORED_BANDS: usize = 7;
/// Number of coefficients of [`MAX_BANDS`].
pub const MAX_COEFFICIENTS: usize = MAX_BANDS * MAX_BANDS;
/// Directions that [`add_lanes`] evaluates at a time.
pub const LANES: usize = 8;

/// Factors of the normalised associated Legendre recurrence
/// `q(l, m) = a(l, m) z q(l-1, m) + b(l, m) q(l-2, m)`, starting at `q(m, m)`; the factor sin^m θ is carried by x and y.
struct Recurrence {
    start: [f64; MAX_BANDS],
    a: [[f64; MAX_BANDS]; MAX_BANDS],
    b: [[f64; MAX_BANDS]; MAX_BANDS],
}

static RECURRENCE: LazyLock<Recurrence> = LazyLock::new(|| {
    let mut r =
        Recurrence { start: [0.0; MAX_BANDS], a: [[0.0; MAX_BANDS]; MAX_BANDS], b: [[0.0; MAX_BANDS]; MAX_BANDS] };
    let mut q = libm::sqrt(0.25 / PI);
    for m in 0..MAX_BANDS {
        let mf = m as f64;
        if m > 0 {
            q *= libm::sqrt((2.0 * mf + 1.0) / (2.0 * mf));
        }
        r.start[m] = if m > 0 { q * std::f64::consts::SQRT_2 } else { q };
        for l in m + 1..MAX_BANDS {
            let lf = l as f64;
            let span = lf * lf - mf * mf;
            r.a[l][m] = libm::sqrt((4.0 * lf * lf - 1.0) / span);
            if l >= m + 2 {
                let previous = (lf - 1.0) * (lf - 1.0) - mf * mf;
                r.b[l][m] = -libm::sqrt((2.0 * lf + 1.0) * previous / ((2.0 * lf - 3.0) * span));
            }
        }
    }
    r
});

/// The same factors in f32.
static RECURRENCE_F32: LazyLock<[[[f32; MAX_BANDS]; MAX_BANDS]; 2]> =
    LazyLock::new(|| [&RECURRENCE.a, &RECURRENCE.b].map(|table| table.map(|row| row.map(|x| x as f32))));

/// Y_k(direction) in f64; `values` is `bands²` long.
pub fn eval(direction: DVec3, values: &mut [f64]) {
    let bands = bands_of(values.len());
    let r = &*RECURRENCE;
    let (mut cos, mut sin) = (1.0, 0.0);
    for m in 0..bands {
        let (mut before, mut q) = (0.0, r.start[m]);
        for l in m..bands {
            if l > m {
                (before, q) = (q, r.a[l][m] * direction.z * q + r.b[l][m] * before);
            }
            values[l * (l + 1) - m] = q * sin;
            values[l * (l + 1) + m] = q * cos;
        }
        (cos, sin) = (direction.x * cos - direction.y * sin, direction.x * sin + direction.y * cos);
    }
}

/// Adds Σ over lanes of `weight · Y_k(direction)` to `sum` (`bands²` long): the fast path, in f32.
#[inline(always)]
pub fn add_lanes(directions: &[[f32; LANES]; 3], weight: &[f32; LANES], sum: &mut [f32]) {
    let bands = bands_of(sum.len());
    let r = &*RECURRENCE;
    let [a, b] = &*RECURRENCE_F32;
    let [x, y, z] = directions;
    let (mut cos, mut sin) = (*weight, [0.0f32; LANES]);
    for m in 0..bands {
        let mut before = [0.0f32; LANES];
        let mut q = [r.start[m] as f32; LANES];
        for l in m..bands {
            if l > m {
                let (al, bl) = (a[l][m], b[l][m]);
                let next: [f32; LANES] = std::array::from_fn(|i| al * z[i] * q[i] + bl * before[i]);
                (before, q) = (q, next);
            }
            if m > 0 {
                sum[l * (l + 1) - m] += lane_sum(&q, &sin);
            }
            sum[l * (l + 1) + m] += lane_sum(&q, &cos);
        }
        let next_cos: [f32; LANES] = std::array::from_fn(|i| x[i] * cos[i] - y[i] * sin[i]);
        let next_sin: [f32; LANES] = std::array::from_fn(|i| x[i] * sin[i] + y[i] * cos[i]);
        (cos, sin) = (next_cos, next_sin);
    }
}

#[inline(always)]
fn lane_sum(a: &[f32; LANES], b: &[f32; LANES]) -> f32 {
    let p: [f32; LANES] = std::array::from_fn(|i| a[i] * b[i]);
    let q: [f32; 4] = std::array::from_fn(|i| p[i] + p[i + 4]);
    (q[0] + q[2]) + (q[1] + q[3])
}

/// Y_k(direction) in f32.
pub fn eval_f32(direction: Vec3, values: &mut [f32]) {
    let mut wide = [0.0f64; MAX_COEFFICIENTS];
    let wide = &mut wide[..values.len()];
    eval(direction.as_dvec3(), wide);
    values.iter_mut().zip(wide).for_each(|(v, w)| *v = *w as f32);
}

/// `Σ_k coefficients[k] Y_k(direction)`, for `N` sets of coefficients at once.
#[must_use]
pub fn radiance<const N: usize>(coefficients: &[[f64; N]], direction: DVec3) -> [f64; N] {
    let mut y = [0.0; MAX_COEFFICIENTS];
    let y = &mut y[..coefficients.len().min(MAX_COEFFICIENTS)];
    eval(direction, y);
    let mut sum = [0.0; N];
    for (c, y) in coefficients.iter().zip(y) {
        for (s, c) in sum.iter_mut().zip(c) {
            *s += c * *y;
        }
    }
    sum
}

/// Factor of band l in the convolution with the clamped cosine over π (Ramamoorthi and Hanrahan 2001): `1/π ∫ max(n·ω, 0) Y_k(ω) dω = factor(l) Y_k(n)`.
#[must_use]
pub fn cosine_factor(l: usize) -> f64 {
    match l {
        0 => 1.0,
        1 => 2.0 / 3.0,
        l if l % 2 == 1 => 0.0,
        l => {
            // l! / (2^l (l/2)!²) as a product of (2i-1)/(2i).
            let central: f64 = (1..=l / 2).map(|i| (2 * i - 1) as f64 / (2 * i) as f64).product();
            let sign = if l % 4 == 0 { -1.0 } else { 1.0 };
            2.0 * sign * central / ((l + 2) * (l - 1)) as f64
        }
    }
}

/// Band l of coefficient k.
#[must_use]
pub fn band(k: usize) -> usize {
    k.isqrt()
}

/// `n` unit directions that cover the sphere evenly (Fibonacci spiral); each represents 4π/n steradians.
#[must_use]
pub fn even_directions(n: usize) -> Vec<DVec3> {
    let turn = PI * (1.0 + libm::sqrt(5.0));
    (0..n)
        .map(|i| {
            let z = 1.0 - (2 * i + 1) as f64 / n as f64;
            let s = libm::sqrt(1.0 - z * z);
            let (sin, cos) = libm::sincos(turn * (i as f64 + 0.5));
            DVec3::new(s * cos, s * sin, z)
        })
        .collect()
}

fn bands_of(coefficients: usize) -> usize {
    coefficients.isqrt().min(MAX_BANDS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn closed_forms() {
        let d = DVec3::new(0.36, 0.48, 0.8);
        let mut y = [0.0; MAX_COEFFICIENTS];
        eval(d, &mut y);
        let expected = [
            0.282_094_791_773_878,
            0.488_602_511_902_92 * d.y,
            0.488_602_511_902_92 * d.z,
            0.488_602_511_902_92 * d.x,
            1.092_548_430_592_08 * d.x * d.y,
            1.092_548_430_592_08 * d.y * d.z,
            0.315_391_565_252_52 * (3.0 * d.z * d.z - 1.0),
            1.092_548_430_592_08 * d.x * d.z,
            0.546_274_215_296_04 * (d.x * d.x - d.y * d.y),
            0.590_043_589_926_644 * d.y * (3.0 * d.x * d.x - d.y * d.y),
        ];
        for (k, e) in expected.iter().enumerate() {
            assert!((y[k] - e).abs() < 1e-12, "Y_{k}: {} instead of {e}", y[k]);
        }
    }

    #[test]
    fn orthonormal() {
        // Gauss–Legendre in z is exact for these degrees; 24 azimuths are exact for |m| <= 8.
        let (nodes, weights) = gauss_legendre(24);
        let mut gram = vec![0.0; MAX_COEFFICIENTS * MAX_COEFFICIENTS];
        let mut y = [0.0; MAX_COEFFICIENTS];
        for (z, w) in nodes.iter().zip(&weights) {
            for j in 0..24 {
                let (s, c) = libm::sincos(2.0 * PI * j as f64 / 24.0);
                let r = libm::sqrt(1.0 - z * z);
                eval(DVec3::new(r * c, r * s, *z), &mut y);
                for (a, ya) in y.iter().enumerate() {
                    for (b, yb) in y.iter().enumerate() {
                        gram[a * MAX_COEFFICIENTS + b] += w * 2.0 * PI / 24.0 * ya * yb;
                    }
                }
            }
        }
        for a in 0..MAX_COEFFICIENTS {
            for b in 0..MAX_COEFFICIENTS {
                let e = if a == b { 1.0 } else { 0.0 };
                assert!((gram[a * MAX_COEFFICIENTS + b] - e).abs() < 1e-10, "<Y_{a}, Y_{b}>");
            }
        }
    }

    #[test]
    fn cosine_factor_is_the_integral() {
        let (nodes, weights) = gauss_legendre(64);
        for l in 0..MAX_BANDS {
            // n = +Z: only m = 0 counts. Nodes on [0, 1] only, where the integrand is smooth.
            let mut y = [0.0; MAX_COEFFICIENTS];
            let mut integral = 0.0;
            for (t, w) in nodes.iter().zip(&weights) {
                let z = 0.5 * (t + 1.0);
                eval(DVec3::new(libm::sqrt(1.0 - z * z), 0.0, z), &mut y);
                integral += 0.5 * w * 2.0 * z * y[l * (l + 1)];
            }
            eval(DVec3::Z, &mut y);
            assert!((integral - cosine_factor(l) * y[l * (l + 1)]).abs() < 1e-12, "l = {l}");
        }
    }

    proptest! {
        #[test]
        fn fast_path_is_the_reference(seed in 0u64..10_000) {
            let directions = even_directions(LANES + seed as usize % 97);
            let lanes: [[f32; LANES]; 3] = [0, 1, 2].map(|c| std::array::from_fn(|i| directions[i][c] as f32));
            let weight: [f32; LANES] = std::array::from_fn(|i| (i as f32) * 0.25 - 0.5);
            let mut fast = [0.0f32; MAX_COEFFICIENTS];
            add_lanes(&lanes, &weight, &mut fast);
            let mut reference = [0.0f64; MAX_COEFFICIENTS];
            let mut y = [0.0f64; MAX_COEFFICIENTS];
            for i in 0..LANES {
                eval(directions[i], &mut y);
                reference.iter_mut().zip(&y).for_each(|(r, y)| *r += f64::from(weight[i]) * y);
            }
            for k in 0..MAX_COEFFICIENTS {
                prop_assert!((f64::from(fast[k]) - reference[k]).abs() < 2e-5, "Y_{}", k);
            }
        }

        /// Addition theorem: a band's energy does not depend on the direction.
        #[test]
        fn addition_theorem(x in -1.0f64..1.0, y in -1.0f64..1.0, z in -1.0f64..1.0) {
            prop_assume!(DVec3::new(x, y, z).length() > 0.1);
            let mut v = [0.0; MAX_COEFFICIENTS];
            eval(DVec3::new(x, y, z).normalize(), &mut v);
            for l in 0..MAX_BANDS {
                let energy: f64 = v[l * l..(l + 1) * (l + 1)].iter().map(|y| y * y).sum();
                prop_assert!((energy - (2 * l + 1) as f64 / (4.0 * PI)).abs() < 1e-9);
            }
        }
    }

    fn gauss_legendre(n: usize) -> (Vec<f64>, Vec<f64>) {
        let legendre = |x: f64| {
            let (mut p0, mut p1) = (1.0, x);
            for k in 2..=n {
                (p0, p1) = (p1, ((2 * k - 1) as f64 * x * p1 - (k - 1) as f64 * p0) / k as f64);
            }
            (p1, n as f64 * (x * p1 - p0) / (x * x - 1.0))
        };
        (0..n)
            .map(|i| {
                let mut x = libm::cos(PI * (i as f64 + 0.75) / (n as f64 + 0.5));
                for _ in 0..50 {
                    let (p, d) = legendre(x);
                    x -= p / d;
                }
                let d = legendre(x).1;
                (x, 2.0 / ((1.0 - x * x) * d * d))
            })
            .unzip()
    }
}
