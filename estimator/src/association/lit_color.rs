//! Robust lit colours (Eq. 2).

use crate::association::light_field::LightField;
use crate::association::observations::{Observation, RefinedView};
use crate::numerics::robust::{SIGMA_PER_MAD, median, weighted_median};
use glam::Vec3;
use rayon::prelude::*;

/// Vertices per parallel task.
const CHUNK: usize = 4096;
/// Vertices from which the noise is estimated.
const NOISE_VERTICES: usize = 4000;
/// Huber's constant in standard deviations.
const HUBER: f32 = 1.5;
/// Rounds of reweighting.
const ROUNDS: usize = 3;

/// Lit colours and the weights of their observations.
pub struct LitColors {
    /// Linear RGB, `[vertex]`; black for vertices that were never seen.
    pub color: Vec<Vec3>,
    /// Sum of weights, `[vertex]`; 0 for vertices that were never seen.
    pub weight: Vec<f32>,
    /// Weight after robust reweighting, `[observation]`.
    pub used: Vec<f32>,
}

/// Eq. (2) for every vertex, with the exposures of `views`.
pub fn lit_colors(field: &LightField, views: &[RefinedView]) -> LitColors {
    let factors: Vec<[f32; 3]> = views.iter().map(|v| v.gain.map(|g| (1.0 / g) as f32)).collect();
    let rows = field.vertices();
    let scale = noise_scale(field, &factors);
    let starts: Vec<usize> = (0..rows).step_by(CHUNK).collect();
    let parts: Vec<(Vec<_>, Vec<f32>)> = starts
        .par_iter()
        .map(|&start| {
            let mut used = Vec::new();
            let colors: Vec<(Vec3, f32)> = (start..(start + CHUNK).min(rows))
                .map(|i| robust_color(field.row(i), &factors, scale, &mut used))
                .collect();
            (colors, used)
        })
        .collect();
    let mut lit = LitColors { color: Vec::with_capacity(rows), weight: Vec::with_capacity(rows), used: Vec::new() };
    for (colors, used) in parts {
        lit.color.extend(colors.iter().map(|c| c.0));
        lit.weight.extend(colors.iter().map(|c| c.1));
        lit.used.extend(used);
    }
    lit
}

/// Robust standard deviation, in square roots of light, of an observation of weight 1 from its vertex's median.
fn noise_scale(field: &LightField, factors: &[[f32; 3]]) -> f32 {
    let stride = (field.vertices() / NOISE_VERTICES).max(1);
    let rows = (0..field.vertices()).step_by(stride).map(|i| field.row(i)).filter(|row| row.len() >= 3);
    let deviations = rows.flat_map(|row| {
        let middle = median_color(row, factors);
        row.iter().map(move |o| deviation(o, factors, middle) * o.weight.sqrt())
    });
    median(deviations).map_or(1e-3, |m| (SIGMA_PER_MAD as f32 * m).max(1e-4))
}

/// RMS difference of square roots over the channels: their photon noise is the same at every brightness.
fn deviation(o: &Observation, factors: &[[f32; 3]], color: Vec3) -> f32 {
    let e = factors[o.keyframe as usize];
    let d = (0..3).map(|c| (o.color[c] * e[c]).max(0.0).sqrt() - color[c].max(0.0).sqrt()).map(|x| x * x);
    (d.sum::<f32>() / 3.0).sqrt()
}

fn median_color(row: &[Observation], factors: &[[f32; 3]]) -> Vec3 {
    let mut values: Vec<(f64, f64)> = Vec::with_capacity(row.len());
    let channels: [f32; 3] = std::array::from_fn(|c| {
        values.clear();
        values.extend(
            row.iter()
                .map(|o| (f64::from(o.color[c] * factors[o.keyframe as usize][c]), f64::from(o.weight.max(1e-6)))),
        );
        weighted_median(&mut values).unwrap_or(0.0) as f32
    });
    Vec3::from_array(channels)
}

/// Huber's estimate and the sum of its weights, starting at the weighted median. Eq. (2)
fn robust_color(row: &[Observation], factors: &[[f32; 3]], scale: f32, used: &mut Vec<f32>) -> (Vec3, f32) {
    if row.is_empty() {
        return (Vec3::ZERO, 0.0);
    }
    let mut color = median_color(row, factors);
    let first = used.len();
    used.resize(first + row.len(), 0.0);
    let mut total = 0.0;
    for _ in 0..ROUNDS {
        let mut sum = Vec3::ZERO;
        total = 0.0;
        for (o, u) in row.iter().zip(&mut used[first..]) {
            let x = deviation(o, factors, color) * o.weight.sqrt() / (HUBER * scale);
            *u = o.weight / x.max(1.0);
            sum += *u * Vec3::from_array(o.color) * Vec3::from_array(factors[o.keyframe as usize]);
            total += *u;
        }
        if total <= 0.0 {
            break;
        }
        color = sum / total;
    }
    (color, total)
}
