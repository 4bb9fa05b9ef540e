//! The paper's solver, literally (Eqs. 10–12), for comparison: plain least squares for the light; segment residuals, which
//! are radiances, are added to the albedo.

use crate::factorisation::problem::Observed;
use crate::factorisation::solution::{Solution, directions};
use crate::numerics::sh;
use firmware_config::tuning::FactorisationTuning;
use glam::Vec3;
use nalgebra::{DMatrix, DVector};

/// Rows of one step of the QR decomposition.
const ROWS: usize = 512;
/// Singular values below this share of the largest are dropped: they hold noise.
const MIN_SINGULAR: f64 = 1e-10;
/// Maximum number of rounds of Eqs. (10)–(12).
const MAX_ROUNDS: usize = 100;
/// The rounds have converged when no residual exceeds this share of the mean lit colour.
const TOLERANCE: f64 = 1e-4;

/// Runs Eqs. (10)–(12). Returns the solution and the albedo per vertex, linear RGB: the segment's plus the high-frequency
/// part of f_rest / (a0 E).
#[must_use]
pub fn solve(observed: &Observed, bands: usize, tuning: &FactorisationTuning) -> (Solution, Vec<Vec3>) {
    let k = bands * bands;
    let first_albedo = tuning.initial_albedo;
    let mut light = vec![[0.0; 3]; k];
    let mut segment_albedo = vec![[first_albedo; 3]; observed.segments];
    let mut albedo = vec![Vec3::splat(first_albedo as f32); observed.lit_color.len()];
    let (mut residual, mut condition) = (0.0, 0.0f64);
    for c in 0..3 {
        let answer = solve_channel(observed, k, c, first_albedo);
        for (row, x) in light.iter_mut().zip(answer.light.iter()) {
            row[c] = *x;
        }
        for (a, x) in segment_albedo.iter_mut().zip(&answer.albedo) {
            a[c] = *x;
        }
        for (a, x) in albedo.iter_mut().zip(&answer.detail) {
            a[c] = *x as f32;
        }
        residual += answer.residual / 3.0;
        condition = condition.max(answer.condition);
    }
    let radiance = directions().iter().map(|d| sh::radiance(&light, *d).map(|x| x.max(0.0))).collect();
    let solution = Solution {
        standard_deviation: vec![[0.0; 3]; k],
        light,
        radiance,
        albedo: segment_albedo,
        held_out: residual,
        regularisation: [0.0; 3],
        condition,
    };
    (solution, albedo)
}

struct Answer {
    light: DVector<f64>,
    albedo: Vec<f64>,
    detail: Vec<f64>,
    residual: f64,
    condition: f64,
}

fn solve_channel(observed: &Observed, k: usize, channel: usize, first_albedo: f64) -> Answer {
    let seen: Vec<usize> = (0..observed.lit_color.len())
        .filter(|&i| observed.lit_weight[i] > 0.0 && observed.lit_color[i].is_finite())
        .collect();
    let mut f: Vec<f64> = seen.iter().map(|&i| f64::from(observed.lit_color[i][channel])).collect();
    let mean = f.iter().sum::<f64>() / f.len().max(1) as f64;
    let mut albedo = vec![first_albedo; observed.segments];
    let mut rows = vec![0.0; seen.len() * k];
    for (row, &i) in rows.chunks_mut(k).zip(&seen) {
        observed.transfer.row(i, channel, row);
    }
    let row = |j: usize| &rows[j * k..(j + 1) * k];
    let irradiance = |light: &DVector<f64>, j: usize| row(j).iter().zip(light.iter()).map(|(t, l)| t * l).sum::<f64>();
    let (mut light, mut condition) = (DVector::zeros(k), 0.0);
    for _ in 0..MAX_ROUNDS {
        (light, condition) = least_squares(k, seen.len(), |j, out| {
            let a = albedo[observed.segment[seen[j]] as usize];
            out[..k].iter_mut().zip(row(j)).for_each(|(o, t)| *o = a * t);
            out[k] = f[j];
        }); // Eq. (10)
        let (mut sum, mut count) = (vec![0.0; observed.segments], vec![0.0; observed.segments]);
        for (j, &i) in seen.iter().enumerate() {
            let u = observed.segment[i] as usize;
            sum[u] += f[j] - albedo[u] * irradiance(&light, j);
            count[u] += 1.0;
        }
        let change: Vec<f64> = sum.iter().zip(&count).map(|(s, n)| if *n > 0.0 { s / n } else { 0.0 }).collect(); // Eq. (11)
        for (f, &i) in f.iter_mut().zip(&seen) {
            *f -= change[observed.segment[i] as usize]; // Eq. (12)
        }
        for (a, d) in albedo.iter_mut().zip(&change) {
            *a = (*a + d).max(1e-3);
        }
        if change.iter().all(|d| d.abs() < TOLERANCE * mean) {
            break;
        }
    }
    let mut detail: Vec<f64> = observed.segment.iter().map(|u| albedo[*u as usize]).collect();
    let rest: Vec<f64> =
        (0..seen.len()).map(|j| f[j] / (first_albedo * irradiance(&light, j)).max(1e-3 * mean.max(1e-30))).collect();
    let (mut sum, mut count) = (vec![0.0; observed.segments], vec![0.0; observed.segments]);
    for (x, &i) in rest.iter().zip(&seen) {
        sum[observed.segment[i] as usize] += x;
        count[observed.segment[i] as usize] += 1.0;
    }
    for (x, &i) in rest.iter().zip(&seen) {
        let u = observed.segment[i] as usize;
        detail[i] = (detail[i] + x - sum[u] / count[u]).clamp(1e-4, 1.0);
    }
    let off: f64 = f
        .iter()
        .enumerate()
        .map(|(j, f)| (f - albedo[observed.segment[seen[j]] as usize] * irradiance(&light, j)).powi(2))
        .sum();
    let residual = libm::sqrt(off / f.len().max(1) as f64) / mean.max(1e-30);
    Answer { light, albedo, detail, residual, condition }
}

/// Least squares of `count` rows by QR in blocks of rows and a singular value decomposition of R, which does not square the
/// condition number. `fill(j, out)` writes row j and its right side: `[k + 1]`. Returns the solution `[k]` and the condition
/// number.
#[must_use]
pub fn least_squares(k: usize, count: usize, mut fill: impl FnMut(usize, &mut [f64])) -> (DVector<f64>, f64) {
    let width = k + 1;
    let mut triangle = DMatrix::<f64>::zeros(width, width);
    let mut row = vec![0.0; width];
    let mut next = 0;
    while next < count {
        let taken = ROWS.min(count - next);
        let mut stacked = DMatrix::zeros(width + taken, width);
        stacked.rows_mut(0, width).copy_from(&triangle);
        for r in 0..taken {
            fill(next + r, &mut row);
            stacked.row_mut(width + r).iter_mut().zip(&row).for_each(|(s, x)| *s = *x);
        }
        triangle = stacked.qr().r();
        next += taken;
    }
    let system = triangle.view((0, 0), (width, k)).into_owned();
    let target = triangle.column(k).into_owned();
    let svd = system.svd(true, true);
    let (largest, smallest) = (svd.singular_values.max(), svd.singular_values.min());
    let condition = if smallest > 0.0 { largest / smallest } else { f64::INFINITY };
    let solution = svd.solve(&target, MIN_SINGULAR * largest).unwrap_or_else(|_| DVector::zeros(k));
    (solution, condition)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Noise-free systems of condition 10^12: directions of singular values above 1e-4 of the largest are right.
        #[test]
        fn ill_conditioned_system(seed in 0u32..1000) {
            let (k, count) = (9, 200);
            let random = |i: u32| f64::from(crate::numerics::random::unit(crate::numerics::random::hash(i, seed))) - 0.5;
            let orthogonal = |rows: usize, salt: u32| {
                DMatrix::from_fn(rows, k, |r, c| random((r * k + c) as u32 + salt)).qr().q()
            };
            let (u, v) = (orthogonal(count, 1), orthogonal(k, 7_000_000));
            let singular = DVector::from_fn(k, |i, _| libm::pow(10.0, -1.5 * i as f64));
            let system = &u * DMatrix::from_diagonal(&singular) * v.transpose();
            let truth = DVector::from_fn(k, |i, _| random(i as u32 + 99_000_000));
            let target = &system * &truth;
            let (x, condition) = least_squares(k, count, |j, out| {
                (0..k).for_each(|c| out[c] = system[(j, c)]);
                out[k] = target[j];
            });
            prop_assert!(condition > 1e11, "{}", condition);
            let off = v.transpose() * (x - truth);
            for i in 0..k {
                if singular[i] > 1e-4 {
                    prop_assert!(off[i].abs() < 1e-6, "direction {}: {}", i, off[i]);
                }
            }
        }
    }
}
