//! Sufficient statistics per segment: with them no step of the solver touches a vertex.

use crate::factorisation::held_out;
use crate::factorisation::problem::Observed;
use crate::numerics::dense;
use firmware_config::tuning::FactorisationTuning;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::ops::Range;

/// Samples of one partial sum.
const PIECE: usize = 256;

/// A vertex of the fit, with the number of vertices it stands for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    pub vertex: u32,
    pub segment: u32,
    pub count: f64,
    pub held_out: bool,
}

/// Evenly strided vertices of every segment, sorted by segment.
pub(super) fn samples(observed: &Observed, tuning: &FactorisationTuning) -> Vec<Sample> {
    let usable = |i: &usize| {
        let f = observed.lit_color[*i];
        observed.lit_weight[*i] > 0.0 && f.is_finite() && f.min_element() >= 0.0 && f.max_element() > 0.0
    };
    let mut of_segment: Vec<Vec<usize>> = vec![Vec::new(); observed.segments];
    for i in (0..observed.lit_color.len()).filter(usable) {
        of_segment[observed.segment[i] as usize].push(i);
    }
    let total: usize = of_segment.iter().map(Vec::len).sum();
    let mut samples = Vec::new();
    for (segment, vertices) in (0u32..).zip(&of_segment) {
        let share = tuning.samples as usize * vertices.len() / total.max(1);
        let stride = vertices.len().div_ceil(share.max(tuning.min_segment_samples as usize)).max(1);
        samples.extend(vertices.iter().step_by(stride).map(|&i| Sample {
            vertex: i as u32,
            segment,
            count: stride as f64,
            held_out: held_out::block(i as u32).is_some(),
        }));
    }
    samples
}

/// Statistics of one segment and channel over its samples with weights w: Σ w T Tᵀ, Σ w f T, Σ w f², Σ w.
#[derive(Debug, Clone)]
pub(super) struct Statistics {
    /// `[k][k]`.
    pub gram: DMatrix<f64>,
    /// `[k]`.
    pub cross: DVector<f64>,
    pub square: f64,
    pub weight: f64,
}

impl Statistics {
    pub fn zero(k: usize) -> Self {
        Self { gram: DMatrix::zeros(k, k), cross: DVector::zeros(k), square: 0.0, weight: 0.0 }
    }

    fn add(&mut self, other: &Self) {
        self.gram += &other.gram;
        self.cross += &other.cross;
        self.square += other.square;
        self.weight += other.weight;
    }

    /// Σ w (f − a E)².
    pub fn residual(&self, albedo: f64, light: &DVector<f64>) -> f64 {
        let predicted = light.dot(&dense::times(&self.gram, light));
        (self.square - 2.0 * albedo * self.cross.dot(light) + albedo * albedo * predicted).max(0.0)
    }
}

/// Statistics of every segment, over the samples that are fitted and over those held out.
pub(super) struct Folds {
    /// `[segment]`.
    pub fitted: Vec<Statistics>,
    /// `[segment]`.
    pub held_out: Vec<Statistics>,
}

impl Folds {
    /// Sums over all samples for one channel; `weights` is `[sample]`, `k` the number of coefficients.
    pub fn accumulate(observed: &Observed, samples: &[Sample], weights: &[f64], k: usize, channel: usize) -> Self {
        let of = |held_out| statistics(observed, samples, weights, k, channel, held_out);
        let (fitted, held_out) = rayon::join(|| of(false), || of(true));
        Self { fitted, held_out }
    }
}

/// Statistics of every segment, `[segment]`, over the samples that are `held_out` or those that are not, for one channel; `weights` is
/// `[sample]`, `k` the number of coefficients.
pub(super) fn statistics(
    observed: &Observed,
    samples: &[Sample],
    weights: &[f64],
    k: usize,
    channel: usize,
    held_out: bool,
) -> Vec<Statistics> {
    let mut pieces: Vec<(u32, Range<usize>)> = Vec::new();
    let mut start = 0;
    while start < samples.len() {
        let segment = samples[start].segment;
        let length = samples[start..].iter().take(PIECE).take_while(|s| s.segment == segment).count();
        pieces.push((segment, start..start + length));
        start += length;
    }
    let sum = |range: &Range<usize>| {
        let chosen: Vec<usize> =
            range.clone().filter(|&j| samples[j].held_out == held_out && weights[j] > 0.0).collect();
        let mut rows = DMatrix::zeros(k, chosen.len());
        let mut weighted = DMatrix::zeros(k, chosen.len());
        let mut sum = Statistics::zero(k);
        for (n, &j) in chosen.iter().enumerate() {
            let (vertex, w) = (samples[j].vertex as usize, weights[j]);
            let f = f64::from(observed.lit_color[vertex][channel]);
            observed.transfer.row(vertex, channel, rows.column_mut(n).as_mut_slice());
            weighted.column_mut(n).axpy(w, &rows.column(n), 0.0);
            sum.cross.axpy(w * f, &rows.column(n), 1.0);
            sum.square += w * f * f;
            sum.weight += w;
        }
        sum.gram = dense::upper_product(&weighted, &rows.transpose());
        sum
    };
    let partial: Vec<Statistics> = pieces.par_iter().map(|(_, range)| sum(range)).collect();
    let mut total = vec![Statistics::zero(k); observed.segments];
    for ((segment, _), sum) in pieces.iter().zip(&partial) {
        total[*segment as usize].add(sum);
    }
    total.iter_mut().for_each(|statistics| statistics.gram.fill_lower_triangle_with_upper_triangle());
    total
}
