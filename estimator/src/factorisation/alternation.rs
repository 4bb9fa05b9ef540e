//! Light and segment albedos in turn, for one channel, on the statistics of the segments (Eqs. 10 and 11).

use crate::factorisation::extrapolation::extrapolated;
use crate::factorisation::projection::Projection;
use crate::factorisation::solution::DIRECTIONS;
use crate::factorisation::statistics::{Folds, Statistics};
use crate::numerics::dense::{self, add_scaled, dot};
use firmware_config::tuning::FactorisationTuning;
use isa::{Hot, Isa, dispatch};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Changes of log albedos and radiance that end the turns: of a solution, and of one that is only compared or weighted by.
pub(super) const EXACT: f64 = 1e-4;
pub(super) const ROUGH: f64 = 1e-3;
/// What a relative change of the radiance counts beside those of the albedos. Without it, trials of the regularisation on a plain thing end
/// before light has converged, and the wrong weight wins.
const OF_RADIANCE: f64 = 0.1;
/// Maximum number of sweeps of one descent; the next one continues them.
const SWEEPS: usize = 12;
/// Descents for light alone.
const LIGHT_TURNS: usize = 10;
/// Regularisation weights tried, strongest first.
const REGULARISATIONS: [f64; 5] = [1e-1, 1e-2, 1e-3, 1e-4, 1e-5];
/// Columns that one task sums over the segments, and segments that one predicts at least.
const COLUMNS: usize = 16;
const SEGMENTS: usize = 16;
/// Weight before one is chosen.
pub(super) const FIRST_REGULARISATION: f64 = REGULARISATIONS[2];

/// The radiance that directions are drawn to, as far as surfaces do not tell theirs.
#[derive(Debug, Clone)]
pub(super) struct Prior {
    /// Weights of (r − center)², in units of the mean of Σ w f² over the directions: `[direction]`.
    weight: DVector<f64>,
    /// In units of the mean radiance: `[direction]`.
    center: DVector<f64>,
}

impl Prior {
    /// Uniform radiance. The sun is free.
    pub fn uniform(projection: &Projection, regularisation: f64) -> Self {
        let even = DVector::from_element(DIRECTIONS, 1.0).resize_vertically(projection.directions(), 0.0);
        Self::found(even, regularisation)
    }

    /// A radiance that was found. The sun is free.
    pub fn found(radiance: DVector<f64>, regularisation: f64) -> Self {
        let weight = DVector::from_element(DIRECTIONS, regularisation).resize_vertically(radiance.len(), 0.0);
        Self { weight, center: radiance }
    }

    /// The same drawn to `center`, too, with a `weight` for each direction.
    pub fn drawn_to(mut self, center: &DVector<f64>, weight: impl Fn(usize) -> f64) -> Self {
        for d in 0..center.len() {
            let (more, before) = (weight(d), self.weight[d]);
            self.weight[d] = before + more;
            if self.weight[d] > 0.0 {
                self.center[d] += more / self.weight[d] * (center[d] - self.center[d]);
            }
        }
        self
    }

    /// `total` is Σ w f².
    fn penalty(&self, total: f64, tuning: &FactorisationTuning) -> Penalty<'_> {
        let strength = self.weight.map(|w| w * total / DIRECTIONS as f64);
        Penalty { strength, center: &self.center, min_observability: tuning.min_observability }
    }
}

/// Mean radiance but for the sun's.
pub(super) fn mean_radiance(radiance: &DVector<f64>) -> f64 {
    radiance.rows(0, DIRECTIONS).mean()
}

/// Radiance and albedos, for one channel.
#[derive(Debug, Clone)]
pub(super) struct Alternation {
    /// `[direction]`, mean 1, and the sun's.
    pub radiance: DVector<f64>,
    /// `[segment]`.
    pub albedo: Vec<f64>,
}

impl Alternation {
    /// Coefficients of the light: `[k]`.
    pub fn light(&self, projection: &Projection) -> DVector<f64> {
        dense::times(projection.matrix(), &self.radiance)
    }

    /// Alternates until a turn changes albedos and radiance by no more than `tolerance`. The mean radiance, 1, fixes the free factor.
    /// After every second turn the albedos are extrapolated; the turn after that is taken back if it does not lower the cost.
    pub fn run(
        &mut self,
        statistics: &[Statistics],
        projection: &Projection,
        prior: &Prior,
        tolerance: f64,
        tuning: &FactorisationTuning,
    ) {
        let total: f64 = statistics.iter().map(|s| s.square).sum();
        if total <= 0.0 {
            return;
        }
        let penalty = prior.penalty(total, tuning);
        let mut path = vec![self.albedo.clone()];
        let mut kept: Option<(Self, f64)> = None;
        for _ in 0..tuning.max_turns {
            let Some(turn) = self.turn(statistics, projection, &penalty) else { return };
            if let Some((before, cost)) = kept.take()
                && turn.cost > cost
            {
                *self = before;
                path = vec![self.albedo.clone()];
                continue;
            }
            if turn.moved < tolerance {
                return;
            }
            path.push(self.albedo.clone());
            if let [first, second, third] = path.as_slice() {
                kept = Some((self.clone(), turn.cost));
                self.albedo = extrapolated(first, second, third);
                path = vec![self.albedo.clone()];
            }
        }
        if let Some((before, _)) = kept {
            *self = before;
        }
    }

    /// Light for the albedos, then albedos for the light. None without light: it is uniform then.
    fn turn(&mut self, statistics: &[Statistics], projection: &Projection, penalty: &Penalty) -> Option<Turn> {
        // Eq. (10) for non-negative radiance, plus the weight of the prior · total · mean of (r − center)².
        let form = LightForm::new(statistics, &self.albedo, projection);
        let held = form.held(penalty);
        let before = self.radiance.clone();
        form.descend(&held, penalty.center, &mut self.radiance);
        let mean = mean_radiance(&self.radiance);
        if mean <= 0.0 || !mean.is_finite() {
            self.radiance.fill(1.0);
            return None;
        }
        self.radiance /= mean;
        let light = self.light(projection);
        let off = self.radiance.iter().zip(penalty.center.iter()).map(|(r, c)| (r - c) * (r - c));
        let moved = OF_RADIANCE * (&self.radiance - before).norm() / self.radiance.norm();
        let mut turn = Turn { moved, cost: held.iter().zip(off).map(|((_, strength), off)| strength * off).sum() };
        // Eq. (11), as a_u = Σ f E / Σ E².
        let predicted = |s: &Statistics| light.dot(&dense::times(&s.gram, &light));
        let predicted: Vec<f64> = statistics.par_iter().with_min_len(SEGMENTS).map(predicted).collect();
        for ((s, a), predicted) in statistics.iter().zip(self.albedo.iter_mut()).zip(predicted) {
            let explained = s.cross.dot(&light);
            if s.weight > 0.0 && predicted > 0.0 && explained > 0.0 {
                let new = explained / predicted;
                turn.moved = turn.moved.max(libm::log(new / *a).abs());
                *a = new;
                turn.cost -= explained * new;
            }
        }
        Some(turn)
    }

    /// Light for the albedos as they are, of which `form` is made.
    pub fn light_alone(&mut self, form: &LightForm, prior: &Prior, tuning: &FactorisationTuning) {
        let penalty = prior.penalty(form.total, tuning);
        let held = form.held(&penalty);
        for _ in 0..LIGHT_TURNS {
            form.descend(&held, penalty.center, &mut self.radiance);
        }
    }

    /// Runs with each regularisation weight and keeps the weakest that still lowers the held-out error. Returns the weight.
    pub fn choose(&mut self, folds: &Folds, projection: &Projection, tuning: &FactorisationTuning) -> f64 {
        let tried = REGULARISATIONS.par_iter().map(|&regularisation| {
            let mut trial = self.clone();
            trial.run(&folds.fitted, projection, &Prior::uniform(projection, regularisation), ROUGH, tuning);
            (regularisation, trial.relative_square_error(&folds.held_out, projection), trial)
        });
        let mut best: Option<(f64, f64, Self)> = None;
        for trial in tried.collect::<Vec<_>>() {
            if best.as_ref().is_none_or(|b| trial.1 < b.1 * (1.0 - tuning.regularisation_min_gain)) {
                best = Some(trial);
            }
        }
        match best {
            Some((regularisation, _, trial)) => {
                *self = trial;
                regularisation
            }
            None => REGULARISATIONS[0],
        }
    }

    /// Mean squared relative error over `statistics`; 0 where there are none.
    pub fn relative_square_error(&self, statistics: &[Statistics], projection: &Projection) -> f64 {
        let light = self.light(projection);
        let (mut error, mut size) = (0.0, 0.0);
        for (s, a) in statistics.iter().zip(&self.albedo) {
            error += s.residual(*a, &light);
            size += s.square;
        }
        if size > 0.0 { error / size } else { 0.0 }
    }
}

/// What a turn did.
struct Turn {
    /// Largest change of a log albedo, or the share that counts of the relative change of the radiance, if that is more.
    moved: f64,
    /// Σ w (f − a E)² plus the penalty, less Σ w f².
    cost: f64,
}

/// Σ a² G and Σ a g over the segments; `albedo` is `[segment]`.
fn summed(statistics: &[Statistics], albedo: &[f64], k: usize) -> (DMatrix<f64>, DVector<f64>) {
    let (mut gram, mut cross) = (DMatrix::zeros(k, k), DVector::zeros(k));
    // Every task sums some columns over all segments, so that the order is that of the segments. All is symmetric.
    let isa = Isa::detect();
    gram.as_mut_slice()
        .par_chunks_mut(k * COLUMNS)
        .enumerate()
        .for_each(|(task, sums)| dispatch(isa, SomeColumns { statistics, albedo, first: task * COLUMNS, k, sums }));
    gram.fill_lower_triangle_with_upper_triangle();
    statistics.iter().zip(albedo).for_each(|(s, a)| add_scaled(cross.as_mut_slice(), *a, s.cross.as_slice()));
    (gram, cross)
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

/// The penalty on radiance: ½ Σ_d s_d (r_d − c_d)². s_d is `strength`, and more for directions whose observability (the
/// diagonal of Pᵀ G P) is below the share `min_observability` of the largest: directions that few vertices see would fit
/// their errors.
struct Penalty<'a> {
    /// `[direction]`.
    strength: DVector<f64>,
    /// c: `[direction]`.
    center: &'a DVector<f64>,
    min_observability: f64,
}

/// The quadratic form in the light that the albedos leave of Eq. (10), `½ rᵀ Pᵀ G P r − (Pᵀ g)ᵀ r`.
pub(super) struct LightForm<'a> {
    /// G: `[k][k]`.
    gram: DMatrix<f64>,
    /// g: `[k]`.
    cross: DVector<f64>,
    /// P.
    projection: &'a Projection,
    /// G P.
    products: DMatrix<f64>,
    /// The diagonal of Pᵀ G P: `[direction]`.
    observability: Vec<f64>,
    /// Σ w f².
    total: f64,
}

impl<'a> LightForm<'a> {
    /// `albedo` is `[segment]`.
    pub fn new(statistics: &[Statistics], albedo: &[f64], projection: &'a Projection) -> Self {
        let k = projection.coefficients();
        let (gram, cross) = summed(statistics, albedo, k);
        let products = dense::product(&gram, projection.matrix());
        let columns = projection.matrix().as_slice().chunks_exact(k).zip(products.as_slice().chunks_exact(k));
        let observability = columns.map(|(column, product)| dot(column, product).max(0.0)).collect();
        let total = statistics.iter().map(|s| s.square).sum();
        Self { gram, cross, projection, products, observability, total }
    }

    /// Observability and strength of the penalty: `[direction]`.
    fn held(&self, Penalty { strength, min_observability, .. }: &Penalty) -> Vec<(f64, f64)> {
        let least = min_observability * self.observability.iter().copied().fold(0.0, f64::max);
        let held = |(&o, s): (&f64, &f64)| (o, s * (1.0 + least / o.max(1e-4 * least)));
        self.observability.iter().zip(strength).map(held).collect()
    }

    /// Lowers the form plus the penalty, over r ≥ 0, by coordinate descent from the given r. `held` is of the penalty.
    fn descend(&self, held: &[(f64, f64)], center: &DVector<f64>, r: &mut DVector<f64>) {
        let mut gradient = dense::times(&self.gram, &dense::times(self.projection.matrix(), r)) - &self.cross;
        let descent = Descent {
            columns: self.projection.matrix().as_slice(),
            products: self.products.as_slice(),
            held,
            center: center.as_slice(),
            gradient: gradient.as_mut_slice(),
            r: r.as_mut_slice(),
        };
        dispatch(Isa::detect(), descent);
    }
}

/// Sweeps over the directions, one after the other.
struct Descent<'a> {
    /// P and G P by columns: `[direction][k]`.
    columns: &'a [f64],
    products: &'a [f64],
    /// Observability and strength: `[direction]`.
    held: &'a [(f64, f64)],
    center: &'a [f64],
    /// The gradient as coefficients: `[k]`.
    gradient: &'a mut [f64],
    /// `[direction]`.
    r: &'a mut [f64],
}

impl Hot for Descent<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { columns, products, held, center, gradient, r } = self;
        let k = gradient.len();
        for _ in 0..SWEEPS {
            let (mut moved, mut size) = (0.0, 0.0);
            let columns = columns.chunks_exact(k).zip(products.chunks_exact(k));
            for (d, ((column, product), &(observability, strength))) in columns.zip(held).enumerate() {
                let diagonal = observability + strength;
                if diagonal <= 0.0 {
                    continue;
                }
                let slope = dot(column, gradient) + strength * (r[d] - center[d]);
                let step = (r[d] - slope / diagonal).max(0.0) - r[d];
                if step != 0.0 {
                    r[d] += step;
                    add_scaled(gradient, step, product);
                    moved += step * step;
                }
                size += r[d] * r[d];
            }
            if moved <= 1e-10 * size {
                break;
            }
        }
    }
}
