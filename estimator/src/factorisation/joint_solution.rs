//! Light and segment albedos together, for one channel, on the statistics of the segments (Eqs. 10 and 11): Gauss–Newton steps on the
//! light, from which the albedos are eliminated (variable projection: Golub and Pereyra 1973).
//!
//! A light l₀ has the best albedos a_s = g_sᵀ l₀ / q_s with u_s = G_s l₀ and q_s = l₀ᵀ u_s (Eq. 11). The residuals f − a_s (1 + δ_s) tᵀ l, linear
//! in l and δ_s there, are least with δ_s = 1 − u_sᵀ l / q_s, which leaves `½ lᵀ H l − bᵀ l` with H = Σ a_s² (G_s − u_s u_sᵀ / q_s) and
//! b = Σ a_s g_s − a_s² u_s. H leaves the level of the light free: h l is held, h = Σ a_s² u_sᵀ, where a step starts, and the mean is made 1
//! after it. So what the prior draws to has no part in the level of what surfaces tell. Holding the mean instead makes directions that no
//! surface tells brighter than they are drawn to be, the more the others vary.

use crate::factorisation::light_form::{LightForm, Prior};
use crate::factorisation::projection::Projection;
use crate::factorisation::solution::DIRECTIONS;
use crate::factorisation::statistics::{Folds, Statistics};
use crate::numerics::dense::{self, add_scaled};
use firmware_config::tuning::FactorisationTuning;
use isa::{Hot, Isa, dispatch};
use nalgebra::DVector;
use rayon::prelude::*;

/// Changes of log albedos and radiance that end the steps: of a solution, and of one that is only compared or weighted by.
pub(super) const EXACT: f64 = 1e-4;
pub(super) const ROUGH: f64 = 1e-3;
/// What a relative change of the radiance counts beside those of the albedos. Without it, trials of the regularisation on a plain thing end
/// before light has converged, and the wrong weight wins.
const OF_RADIANCE: f64 = 0.1;
/// Smallest share of a step that is tried.
const LEAST_STEP: f64 = 0.01;
/// A cost that rises by less, relative to Σ w f², has not risen.
const ROUNDING: f64 = 1e-12;
/// Weight of the condition on the level of the light, against Σ w f².
const NORMALISED: f64 = 10.0;
/// Regularisation weights tried, strongest first.
const REGULARISATIONS: [f64; 5] = [1e-1, 1e-2, 1e-3, 1e-4, 1e-5];
/// Segments that one task predicts at least.
const SEGMENTS: usize = 16;
/// Weight before one is chosen.
pub(super) const FIRST_REGULARISATION: f64 = REGULARISATIONS[2];

/// Mean radiance but for the sun's.
pub(super) fn mean_radiance(radiance: &DVector<f64>) -> f64 {
    radiance.rows(0, DIRECTIONS).mean()
}

/// Radiance and albedos, for one channel.
#[derive(Debug, Clone)]
pub(super) struct JointSolution {
    /// `[direction]`, mean 1, and the sun's.
    pub radiance: DVector<f64>,
    /// `[segment]`.
    pub albedo: Vec<f64>,
}

impl JointSolution {
    /// Coefficients of the light: `[k]`.
    pub fn light(&self, projection: &Projection) -> DVector<f64> {
        projection.light(&self.radiance)
    }

    /// Light for the albedos as they are, then steps of both until one changes albedos and radiance by no more than `tolerance`. Steps that
    /// raise the cost are halved. Light is uniform where there is none.
    pub fn run(
        &mut self,
        statistics: &[Statistics],
        projection: &Projection,
        prior: &Prior,
        tolerance: f64,
        tuning: &FactorisationTuning,
    ) {
        let form = LightForm::new(statistics, &self.albedo, projection);
        let total = form.total;
        if total <= 0.0 {
            return;
        }
        let held = prior.held(&form, tuning);
        let problem = Problem { statistics, projection, prior, held: &held, total };
        let first = form.solved(prior, &held, &self.radiance);
        let Some(mut now) = problem.under(first, &self.albedo).normalised() else {
            self.radiance.fill(1.0);
            return;
        };
        for _ in 0..tuning.max_turns {
            let Some(next) = problem.step(&now) else { break };
            let has_converged = next.apart(&now) <= tolerance;
            now = next;
            if has_converged {
                break;
            }
        }
        *self = now.solution;
    }

    /// Runs with each regularisation weight and keeps the weakest that still lowers the held-out error. Returns the weight.
    pub fn choose(&mut self, folds: &Folds, projection: &Projection, tuning: &FactorisationTuning) -> f64 {
        let tried = REGULARISATIONS.par_iter().map(|&regularisation| {
            let mut trial = self.clone();
            trial.run(&folds.fitted, projection, &Prior::uniform(regularisation), ROUGH, tuning);
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

/// What the steps lower: Σ w (f − a E)² and the penalty of a prior.
struct Problem<'a> {
    statistics: &'a [Statistics],
    projection: &'a Projection,
    prior: &'a Prior,
    /// Of the prior.
    held: &'a [(f64, f64)],
    /// Σ w f².
    total: f64,
}

/// A light with its best albedos.
struct Point {
    solution: JointSolution,
    /// u: `[segment]`.
    products: Vec<DVector<f64>>,
    /// q, 0 where the albedo is not told: `[segment]`.
    predicted: Vec<f64>,
    /// Σ w f² − Σ w (f − a E)².
    explained: f64,
}

impl Point {
    /// With mean radiance 1; `None` where there is no light.
    fn normalised(mut self) -> Option<Self> {
        let mean = mean_radiance(&self.solution.radiance);
        if mean <= 0.0 || !mean.is_finite() {
            return None;
        }
        self.solution.radiance /= mean;
        self.products.iter_mut().for_each(|u| *u /= mean);
        for (a, q) in self.solution.albedo.iter_mut().zip(&mut self.predicted).filter(|(_, q)| **q > 0.0) {
            *a *= mean;
            *q /= mean * mean;
        }
        Some(self)
    }

    /// Largest difference of a log albedo, or the share that counts of the relative one of the radiance, if that is more.
    fn apart(&self, other: &Self) -> f64 {
        let (to, from) = (&self.solution, &other.solution);
        let albedo = to.albedo.iter().zip(&from.albedo).map(|(a, b)| libm::log(a / b).abs());
        albedo.fold(OF_RADIANCE * (&to.radiance - &from.radiance).norm() / to.radiance.norm(), f64::max)
    }
}

impl Problem<'_> {
    /// This light and the albedos that are best under it (Eq. 11). Segments that it does not tell keep theirs.
    fn under(&self, radiance: DVector<f64>, albedo: &[f64]) -> Point {
        let light = self.projection.light(&radiance);
        let product = |s: &Statistics| dense::times(&s.gram, &light);
        let products: Vec<DVector<f64>> = self.statistics.par_iter().with_min_len(SEGMENTS).map(product).collect();
        let (mut albedo, mut predicted, mut explained) = (albedo.to_vec(), vec![0.0; albedo.len()], 0.0);
        for (n, (s, a)) in self.statistics.iter().zip(&mut albedo).enumerate() {
            let (square, cross) = (light.dot(&products[n]), s.cross.dot(&light));
            if s.weight > 0.0 && square > 0.0 && cross > 0.0 {
                *a = cross / square;
                predicted[n] = square;
                explained += cross * *a;
            }
        }
        Point { solution: JointSolution { radiance, albedo }, products, predicted, explained }
    }

    /// The next point; `None` where no share of the step lowers the cost at the level that is held.
    fn step(&self, now: &Point) -> Option<Point> {
        let JointSolution { radiance: from, albedo } = &now.solution;
        let level = self.level(now);
        let to = self.reduced(now, &level).solved(self.prior, self.held, from);
        let cost = |p: &Point| self.prior.penalty(self.held, &p.solution.radiance) - p.explained;
        let most = cost(now) + ROUNDING * self.total;
        let mut share = 1.0;
        while share > LEAST_STEP {
            let mut radiance = from + (&to - from) * share;
            radiance /= level.dot(&self.projection.light(&radiance));
            let next = self.under(radiance, albedo);
            if cost(&next) <= most {
                return next.normalised();
            }
            share *= 0.5;
        }
        None
    }

    /// h / (h l) at a light l, without the sun's part: no prior moves a sun. `[k]`.
    fn level(&self, at: &Point) -> DVector<f64> {
        let light = at.solution.light(self.projection);
        let mut level = DVector::zeros(light.len());
        let told = at.solution.albedo.iter().zip(&at.products).zip(&at.predicted).filter(|(_, q)| **q > 0.0);
        told.for_each(|((a, u), _)| add_scaled(level.as_mut_slice(), a * a, u.as_slice()));
        level.as_mut_slice()[self.projection.matrix().nrows()..].fill(0.0);
        let of_light = level.dot(&light);
        if of_light > 0.0 { level / of_light } else { level }
    }

    /// H and b about a point, with the `level` of the light held.
    fn reduced(&self, at: &Point, level: &DVector<f64>) -> LightForm<'_> {
        let mut form = LightForm::new(self.statistics, &at.solution.albedo, self.projection);
        dispatch(Isa::detect(), Reduced { form: &mut form, at });
        form.gram.ger(NORMALISED * self.total, level, level, 1.0);
        form.cross.axpy(NORMALISED * self.total, level, 1.0);
        form
    }
}

/// Takes a² u uᵀ / q and a² u of the segments out of the form.
struct Reduced<'a, 'p> {
    form: &'a mut LightForm<'p>,
    at: &'a Point,
}

impl Hot for Reduced<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { form, at } = self;
        let rows = at.solution.albedo.iter().zip(&at.products).zip(&at.predicted);
        for ((a, u), q) in rows.filter(|(_, q)| **q > 0.0) {
            add_scaled(form.cross.as_mut_slice(), -a * a, u.as_slice());
            for (column, x) in form.gram.as_mut_slice().chunks_exact_mut(u.len()).zip(u.iter()) {
                add_scaled(column, -a * a / q * x, u.as_slice());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::factorisation::directions;
    use crate::numerics::sh;
    use crate::transfer::{self, Transfer};
    use glam::Vec3;
    use proptest::prelude::*;
    use recordings::types::Mesh;
    use std::sync::Arc;

    const SEGMENTS: usize = 12;
    const BANDS: usize = 3;
    const REGULARISATION: f64 = 1e-3;

    /// A ball in patches of several paints, in light with a bright spot; colours err by 10 %. What its patches say.
    fn patches(seed: u32) -> (Projection, Vec<Statistics>) {
        let normals: Vec<Vec3> = sh::even_directions(600).iter().map(|d| d.as_vec3().normalize()).collect();
        let mesh = Mesh { positions: normals.clone(), normals: normals.clone(), ..Mesh::default() };
        let transfer = Transfer { traced: Arc::new(transfer::unoccluded(&mesh, BANDS)), bounced: None };
        let projection = Projection::of(&transfer, BANDS);
        let value = |i: usize| 0.5 + 0.5 * libm::sin(f64::from(seed % 997) + 37.0 * i as f64);
        let spot = Vec3::new(value(1) as f32 - 0.5, value(2) as f32 - 0.5, 0.6).normalize().as_dvec3();
        let radiance = directions().into_iter().map(|d| 0.4 + if d.dot(spot) > 0.8 { 8.0 } else { 0.0 });
        let light = projection.light(&DVector::from_iterator(DIRECTIONS, radiance));
        let k = projection.coefficients();
        let mut statistics: Vec<Statistics> = (0..SEGMENTS).map(|_| Statistics::zero(k)).collect();
        let mut row = DVector::zeros(k);
        for (i, n) in normals.iter().enumerate() {
            transfer.row(i, 0, row.as_mut_slice());
            let segment = (6.0 * (n.z + 1.0)).min(11.0) as usize;
            let color = (0.1 + 0.8 * value(segment)) * row.dot(&light) * (0.9 + 0.2 * value(i));
            let s = &mut statistics[segment];
            let weight = 1.0 / (color * color);
            s.gram.ger(weight, &row, &row, 1.0);
            s.cross.axpy(weight * color, &row, 1.0);
            s.square += weight * color * color;
            s.weight += weight;
        }
        (projection, statistics)
    }

    fn found(projection: &Projection, statistics: &[Statistics], max_turns: u32, tolerance: f64) -> JointSolution {
        let tuning = FactorisationTuning { max_turns, ..FactorisationTuning::default() };
        let mut found = JointSolution { radiance: DVector::from_element(DIRECTIONS, 1.0), albedo: vec![0.5; SEGMENTS] };
        found.run(statistics, projection, &Prior::uniform(REGULARISATION), tolerance, &tuning);
        found
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(8))]

        #[test]
        fn no_albedo_and_no_radiance_can_be_moved_to_lower_the_cost(seed: u32) {
            let (projection, statistics) = patches(seed);
            let found = found(&projection, &statistics, 100, 1e-9);
            let light = found.light(&projection);
            for (s, a) in statistics.iter().zip(&found.albedo) {
                let best = s.cross.dot(&light) / light.dot(&(&s.gram * &light));
                prop_assert!((a / best - 1.0).abs() < 1e-6, "{a} instead of {best}");
            }
            let form = LightForm::new(&statistics, &found.albedo, &projection);
            let prior = Prior::uniform(REGULARISATION);
            let start = LightForm::new(&statistics, &[0.5; SEGMENTS], &projection);
            let held = prior.held(&start, &FactorisationTuning::default());
            let gradient = projection.matrix().transpose() * (&form.gram * &light - &form.cross);
            let slopes: Vec<f64> =
                gradient.iter().zip(&held).zip(&found.radiance).map(|((g, h), r)| g + h.1 * (r - 1.0)).collect();
            // The level of the light is held: what shines lacks as much as it moves that level, the others no less.
            let levels = projection.matrix().transpose() * (&form.gram * &light);
            let shining = || slopes.iter().zip(&levels).zip(&found.radiance).filter(|(_, r)| **r > 0.0).map(|(s, _)| s);
            let lack = shining().map(|(s, l)| s * l).sum::<f64>() / shining().map(|(_, l)| l * l).sum::<f64>();
            let scale = form.total / DIRECTIONS as f64;
            for ((slope, level), r) in slopes.iter().zip(&levels).zip(&found.radiance) {
                let off = (slope - lack * level) / scale;
                prop_assert!(off > -1e-5 && (*r <= 0.0 || off < 1e-5), "{off} where the radiance is {r}");
            }
        }
    }

    #[test]
    fn a_few_steps_are_as_good_as_many() {
        let (projection, statistics) = patches(5);
        let [few, many] = [8, 200].map(|turns| found(&projection, &statistics, turns, EXACT));
        let apart = (&few.radiance - &many.radiance).norm() / many.radiance.norm();
        assert!(apart < 1e-3, "{apart}");
    }

    #[test]
    fn what_is_not_lit_keeps_its_albedo() {
        let (projection, mut statistics) = patches(5);
        statistics[3] = Statistics::zero(projection.coefficients());
        assert_eq!(found(&projection, &statistics, 25, EXACT).albedo[3], 0.5);
        let dark: Vec<Statistics> = statistics.iter().map(|s| Statistics::zero(s.cross.len())).collect();
        let untold = found(&projection, &dark, 25, EXACT);
        assert!(untold.radiance.iter().all(|r| *r == 1.0) && untold.albedo == vec![0.5; SEGMENTS]);
    }
}
