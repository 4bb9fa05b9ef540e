//! The quadratic form in the light that known albedos leave of Eq. (10), and what its radiance is drawn to.

use crate::factorisation::non_negative::{self, Center, NonNegative};
use crate::factorisation::projection::Projection;
use crate::factorisation::solution::DIRECTIONS;
use crate::factorisation::statistics::Statistics;
use crate::numerics::dense::add_scaled;
use firmware_config::tuning::FactorisationTuning;
use isa::{Hot, Isa, dispatch};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Columns that one task sums over the segments.
const COLUMNS: usize = 16;

/// The radiance that directions are drawn to, as far as surfaces do not tell theirs. The sun is free.
#[derive(Debug, Clone)]
pub(super) struct Prior {
    /// Weights of (r − center)², in units of the mean of Σ w f² over the directions: `[direction]`.
    weight: DVector<f64>,
    /// In units of the mean radiance: `[direction]`.
    center: DVector<f64>,
}

impl Prior {
    /// Uniform radiance.
    pub fn uniform(regularisation: f64) -> Self {
        Self::found(&DVector::from_element(DIRECTIONS, 1.0), regularisation)
    }

    /// A radiance that was found.
    pub fn found(radiance: &DVector<f64>, regularisation: f64) -> Self {
        Self {
            weight: DVector::from_element(DIRECTIONS, regularisation),
            center: radiance.rows(0, DIRECTIONS).into_owned(),
        }
    }

    /// The same drawn to `center`, too, with a `weight` for each direction.
    pub fn drawn_to(mut self, center: &DVector<f64>, weight: impl Fn(usize) -> f64) -> Self {
        for d in 0..DIRECTIONS {
            let (more, before) = (weight(d), self.weight[d]);
            self.weight[d] = before + more;
            if self.weight[d] > 0.0 {
                self.center[d] += more / self.weight[d] * (center[d] - self.center[d]);
            }
        }
        self
    }

    /// Observability and strength of every direction under a form.
    pub fn held(&self, form: &LightForm, tuning: &FactorisationTuning) -> Vec<(f64, f64)> {
        let strength = |d: usize| self.weight[d] * form.total / DIRECTIONS as f64;
        non_negative::held(&form.gram, form.projection.matrix(), tuning.min_observability, strength)
    }

    /// Σ_d s_d (r_d − c_d)²; `held` has the s.
    pub fn penalty(&self, held: &[(f64, f64)], radiance: &DVector<f64>) -> f64 {
        let off = radiance.iter().zip(self.center.iter()).map(|(r, c)| (r - c) * (r - c));
        held.iter().zip(off).map(|((_, strength), off)| strength * off).sum()
    }
}

/// `½ lᵀ G l − gᵀ l` in the coefficients l of the light.
#[derive(Clone)]
pub(super) struct LightForm<'a> {
    /// G: `[k][k]`.
    pub gram: DMatrix<f64>,
    /// g: `[k]`.
    pub cross: DVector<f64>,
    pub projection: &'a Projection,
    /// Σ w f².
    pub total: f64,
}

impl<'a> LightForm<'a> {
    /// Σ a² G and Σ a g over the segments; `albedo` is `[segment]`.
    pub fn new(statistics: &[Statistics], albedo: &[f64], projection: &'a Projection) -> Self {
        let k = projection.coefficients();
        let (mut gram, mut cross) = (DMatrix::zeros(k, k), DVector::zeros(k));
        // Every task sums some columns over all segments, so that the order is that of the segments. All is symmetric.
        let isa = Isa::detect();
        gram.as_mut_slice()
            .par_chunks_mut(k * COLUMNS)
            .enumerate()
            .for_each(|(task, sums)| dispatch(isa, SomeColumns { statistics, albedo, first: task * COLUMNS, k, sums }));
        gram.fill_lower_triangle_with_upper_triangle();
        statistics.iter().zip(albedo).for_each(|(s, a)| add_scaled(cross.as_mut_slice(), *a, s.cross.as_slice()));
        let total = statistics.iter().map(|s| s.square).sum();
        Self { gram, cross, projection, total }
    }

    /// The radiance, `[direction]`, at the minimum of the form plus the penalty of `prior`, whose strengths are `held`; `from` is where the
    /// search starts.
    pub fn solved(self, prior: &Prior, held: &[(f64, f64)], from: &DVector<f64>) -> DVector<f64> {
        let Self { gram, cross, projection, .. } = self;
        let mut start = DVector::zeros(cross.len());
        let (harmonics, sun) = from.as_slice().split_at(DIRECTIONS);
        let mut radiance = DVector::from_column_slice(harmonics);
        let k = projection.matrix().nrows();
        start.rows_mut(k, sun.len()).copy_from_slice(sun);
        let problem = NonNegative {
            gram,
            cross,
            projection: projection.matrix(),
            center: Center::At(&prior.center),
            last_at_most: f64::INFINITY,
        };
        let light = problem.solve(held, &mut radiance, &start);
        radiance.extend(light.iter().skip(k).copied());
        radiance
    }
}

/// Some columns of Σ a² G, down to the diagonal.
struct SomeColumns<'a> {
    statistics: &'a [Statistics],
    albedo: &'a [f64],
    /// The first column.
    first: usize,
    k: usize,
    sums: &'a mut [f64],
}

impl Hot for SomeColumns<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { statistics, albedo, first, k, sums } = self;
        for (s, a) in statistics.iter().zip(albedo) {
            let columns = s.gram.as_slice().chunks_exact(k).enumerate().skip(first);
            for (sum, (j, g)) in sums.chunks_exact_mut(k).zip(columns) {
                add_scaled(&mut sum[..=j], a * a, &g[..=j]);
            }
        }
    }
}
