//! Light of every kind and the segments' albedo from lit colours: one small least-squares problem a channel.
//!
//! With b = 1/albedo of a segment, `f b − Σ t i − Σ P g − Σ F E − k G = 0` is linear in everything (N5). Rows are divided by
//! the light there, in a few rounds. Every row has one b, so that the b are eliminated segment by segment
//! (`H = Σ_s C_s − B_s B_sᵀ / D_s`) and a quadratic form in the light alone is left. Zero would solve it, so the mean light
//! is held at 1; the coefficient k of the secondary light, which is known in units of f, then fixes the absolute scale.
//!
//! Least squares of (N5) take the lit colour for exact. Where it varies within a segment (a print), `Σ w f²` is too large by the
//! square of that spread, and light is drawn away from there. The rounds after the first ones are therefore steps of Gauss–Newton
//! on `f b − E (1 + δ_s)`, which takes the light for exact, with the δ_s eliminated in the place of the b.

use crate::factorisation::{Center, NonNegative, Projection, held};
use crate::light_model::samples::{DARK_FLOOR, Samples};
use crate::numerics::dense::add_scaled;
use crate::numerics::robust::robust_sigma;
use isa::{Hot, Isa, dispatch};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Rounds at most, and those at first that are linear in 1/albedo.
const ROUNDS: usize = 10;
const LINEAR_ROUNDS: usize = 3;
/// Rounds end when the light of the samples changes by less (root mean square, relative).
const CONVERGED: f64 = 2e-3;
/// Factor that an albedo changes by at most in one step of Gauss–Newton.
const MOST_CHANGE: f64 = 2.0;
/// Residuals beyond this many robust standard deviations count less (Huber).
const HUBER: f64 = 1.5;
/// Weight of the condition that holds the mean light at 1, against the sum of the rows' weights.
const NORMALISED: f64 = 10.0;
/// Lit colours of neighbouring vertices err together: so many samples' weight counts as one measurement.
const CORRELATED: f64 = 25.0;
/// Albedo that the brightest [`LARGE`] of the surface has where no secondary light fixes the scale, and its deviation.
const PRIOR_ALBEDO: (f64, f64) = (0.7, 0.25);
/// The share of the surface that bounds the scale. A segment that secondary light alone reaches, of which some radiates more than is
/// known, has an albedo above 1 at any scale: if such a one counted, light would be told from round to round that none of it is secondary.
const LARGE: f64 = 0.1;
/// Albedo of that share at most.
const MAX_ALBEDO: f64 = 0.95;
/// Directions that the surfaces tell less of than this share of the best observed one are held at the mean by more.
const MIN_OBSERVABILITY: f64 = 5e-3;
/// Light of one lamp or emitter where it is strongest, against the mean light: deviation of its prior. One that hardly any sample
/// tells would be taken for any radiance.
const BRIGHTEST: f64 = 100.0;

/// Rows of (N5): `shared` is `[sample][columns]`, SH transfer first (`coefficients`), then lamps and emitters; `secondary`
/// is G per channel.
#[derive(Debug, Clone, Copy)]
pub struct Rows<'a> {
    /// Sampled vertices.
    pub samples: &'a Samples,
    /// SH columns.
    pub coefficients: usize,
    /// All columns that the channels share.
    pub columns: usize,
    /// Their values.
    pub shared: &'a [f32],
    /// Secondary light as it was observed.
    pub secondary: &'a [[f64; 3]],
    /// The share of what a source radiates that its prior takes it to bring at least, where it is strongest: `[source]`, none for
    /// those at the end that it leaves out.
    pub least_brought: &'a [f64],
}

/// What the rows say.
#[derive(Debug, Clone)]
pub struct Solved {
    /// SH coefficients, then powers of lamps and radiances of emitters, in units of f: `[column][channel]`.
    pub light: Vec<[f64; 3]>,
    /// Posterior standard deviation, same shape.
    pub standard_deviation: Vec<[f64; 3]>,
    /// Non-negative radiance over [`directions`](crate::factorisation::directions).
    pub radiance: Vec<[f64; 3]>,
    /// Albedo per segment, absolute.
    pub albedo: Vec<[f64; 3]>,
    /// Irradiance over π of every sample.
    pub irradiance: Vec<[f64; 3]>,
    /// Relative standard deviation of the scale by the secondary light, per channel; infinite without it.
    pub scale_deviation: [f64; 3],
}

/// Solves every channel with this weight of the regularisation towards the mean radiance.
#[must_use]
pub fn solve(rows: &Rows, regularisation: f64) -> Solved {
    let projection = Projection::new(rows.coefficients);
    let channels: Vec<Channel> = [0, 1, 2]
        .into_par_iter()
        .map(|c| solve_channel(rows, &Values::new(rows, |rgb| rgb[c]), &projection, regularisation))
        .collect();
    let zip = |count: usize, get: &dyn Fn(&Channel, usize) -> f64| -> Vec<[f64; 3]> {
        (0..count).map(|i| [0, 1, 2].map(|c| get(&channels[c], i))).collect()
    };
    Solved {
        light: zip(rows.columns, &|c, i| c.light[i]),
        standard_deviation: zip(rows.columns, &|c, i| c.standard_deviation[i]),
        radiance: zip(projection.matrix().ncols(), &|c, i| c.radiance[i]),
        albedo: zip(rows.samples.segments, &|c, i| c.albedo[i]),
        irradiance: zip(rows.samples.len(), &|c, i| c.irradiance[i]),
        scale_deviation: [0, 1, 2].map(|c| channels[c].scale_deviation),
    }
}

/// Colours of one channel: `[sample]`, and `[segment]` for the medians.
#[derive(Debug, Clone)]
pub struct Values {
    /// Lit colour f.
    pub color: Vec<f64>,
    /// Median lit colour of each segment.
    pub medians: Vec<f64>,
    /// G of (N3).
    pub secondary: Vec<f64>,
}

impl Values {
    /// Takes `channel` of every colour.
    pub fn new(rows: &Rows, channel: impl Fn(&[f64; 3]) -> f64) -> Self {
        Self {
            color: rows.samples.color.iter().map(&channel).collect(),
            medians: rows.samples.medians.iter().map(&channel).collect(),
            secondary: rows.secondary.iter().map(&channel).collect(),
        }
    }
}

/// What the rows say of one channel, in units of f.
#[derive(Debug, Clone)]
pub struct Channel {
    /// `[column]`.
    pub light: Vec<f64>,
    /// Posterior standard deviation of `light`.
    pub standard_deviation: Vec<f64>,
    /// Over [`directions`](crate::factorisation::directions).
    pub radiance: Vec<f64>,
    /// `[segment]`.
    pub albedo: Vec<f64>,
    /// Irradiance over π: `[sample]`.
    pub irradiance: Vec<f64>,
    /// Relative standard deviation of the scale by the secondary light; infinite without it.
    pub scale_deviation: f64,
}

/// Solves one channel, or a mean of the channels. `projection` is that of the rows' SH columns.
#[must_use]
pub fn solve_channel(rows: &Rows, values: &Values, projection: &Projection, regularisation: f64) -> Channel {
    let projection = projection.matrix();
    let Rows { samples, coefficients, columns, shared, .. } = *rows;
    let Values { color, medians, secondary } = values;
    let (count, dim) = (samples.len(), columns + 1);
    let fitted: Vec<usize> = samples.fitted().collect();
    let total: f64 = fitted.iter().map(|n| samples.weight[*n]).sum();
    let surface = samples.surface(|n| samples.held_out(n).is_none());
    let brightest_median = medians.iter().copied().fold(0.0, f64::max).max(1e-30);
    let mut inverse: Vec<f64> = medians.iter().map(|m| 1.0 / m.max(1e-4 * brightest_median)).collect();
    let mut irradiance = vec![1.0; count];
    let mut solution = DVector::zeros(dim);
    let mut radiance = DVector::from_element(projection.ncols(), 1.0);
    let mut last = None;
    let largest = |j: usize| fitted.iter().map(|n| f64::from(shared[n * columns + j])).fold(0.0, f64::max);
    let brought = |j: usize| largest(j).max(rows.least_brought.get(j - coefficients).copied().unwrap_or(0.0));
    let strongest: Vec<f64> = (coefficients..columns).map(brought).collect();
    let isa = Isa::detect();
    for round in 0..ROUNDS {
        let is_linear = round < LINEAR_ROUNDS;
        let explained = |n: usize| color[n] * inverse[samples.segment[n] as usize];
        let expected = |n: usize| if is_linear { 0.5 * (explained(n) + irradiance[n]) } else { irradiance[n] };
        let size = |n: usize| f64::max(expected(n), DARK_FLOOR);
        let relative = |n: usize| (explained(n) - irradiance[n]).abs() / size(n);
        let sigma = if round == 0 { 0.5 } else { robust_sigma(fitted.iter().map(|n| relative(*n))).max(1e-4) };
        let mut statistics = Statistics::new(samples.segments, dim);
        let mut mean = DVector::zeros(dim);
        let of_row = |&n: &usize| {
            let huber = if round == 0 { 1.0 } else { HUBER * sigma / relative(n).max(HUBER * sigma) };
            let (factor, known) = if is_linear { (color[n], 0.0) } else { (irradiance[n], explained(n)) };
            Row {
                segment: samples.segment[n] as usize,
                weight: samples.weight[n] * huber / (size(n) * size(n)),
                factor,
                known,
                share: samples.weight[n] / (size(n) * total),
                shared: &shared[n * columns..][..columns],
                secondary: secondary[n],
            }
        };
        let rows = fitted.iter().map(of_row);
        dispatch(isa, Summed { statistics: &mut statistics, mean: mean.as_mut_slice(), rows });
        if statistics.square.iter().all(|s| *s <= 0.0) {
            break;
        }
        let (reduced, explained) = statistics.reduced();
        let brightest = brightest(&inverse, &surface);
        let mut problem = NonNegative {
            cross: &mean * (NORMALISED * total) + explained,
            gram: reduced.clone(),
            projection,
            center: Center::Mean,
            last_at_most: MAX_ALBEDO / brightest,
        };
        problem.gram.ger(NORMALISED * total, &mean, &mean, 1.0);
        let normalised = problem.gram.clone();
        // Scale: the albedo of the brightest surface is k / b, known beforehand within some deviation.
        let noise = CORRELATED * sigma * sigma;
        let per = brightest / PRIOR_ALBEDO.1;
        problem.gram[(columns, columns)] += noise * per * per;
        problem.cross[columns] += noise * per * PRIOR_ALBEDO.0 / PRIOR_ALBEDO.1;
        for (j, most) in strongest.iter().enumerate() {
            let per = most / BRIGHTEST;
            problem.gram[(coefficients + j, coefficients + j)] += noise * per * per;
        }
        let strength = regularisation * total / projection.ncols() as f64;
        let held = held(&problem.gram, projection, MIN_OBSERVABILITY, |_| strength);
        solution = problem.solve(&held, &mut radiance, &solution);
        let scale = Some(mean.dot(&solution)).filter(|s| *s > 0.0).unwrap_or(1.0);
        for (b, eliminated) in inverse.iter_mut().zip(statistics.eliminated(&solution)) {
            match eliminated {
                Some(inverse) if is_linear && inverse > 0.0 => *b = inverse / scale,
                Some(minus) if !is_linear => *b /= scale * (1.0 - minus).clamp(1.0 / MOST_CHANGE, MOST_CHANGE),
                _ => {}
            }
        }
        solution /= scale;
        radiance /= scale;
        let (mut moved, mut weights) = (0.0, 0.0);
        for (n, e) in irradiance.iter_mut().enumerate() {
            let shared = &shared[n * columns..(n + 1) * columns];
            let sum: f64 = shared.iter().zip(solution.iter()).map(|(t, x)| f64::from(*t) * x).sum();
            let next = (sum + secondary[n] * solution[columns]).max(0.0);
            moved += samples.weight[n] * ((next - *e) / next.max(DARK_FLOOR)).powi(2);
            weights += samples.weight[n];
            *e = next;
        }
        last = Some((reduced, normalised, noise));
        if !is_linear && moved <= CONVERGED * CONVERGED * weights {
            break;
        }
    }
    let (mut deviation, mut scale_deviation) = (vec![f64::INFINITY; dim], f64::INFINITY);
    if let Some((reduced, normalised, noise)) = last {
        let prior = regularisation * total / (4.0 * std::f64::consts::PI);
        deviation = posterior(reduced, noise, prior, coefficients);
        scale_deviation = posterior(normalised, noise, prior, coefficients)[columns] / solution[columns];
    }
    // Into units of f: the secondary light's coefficient is 1 there.
    let least = inverse.iter().copied().fold(f64::INFINITY, f64::min);
    let k = if solution[columns] > 1e-6 * least { solution[columns] } else { PRIOR_ALBEDO.0 * least };
    Channel {
        light: solution.iter().take(columns).map(|x| x / k).collect(),
        standard_deviation: deviation.iter().take(columns).map(|x| x / k).collect(),
        radiance: radiance.iter().map(|x| x / k).collect(),
        albedo: inverse.iter().map(|b| k / b).collect(),
        irradiance: irradiance.iter().map(|e| e / k).collect(),
        scale_deviation: if scale_deviation.is_nan() { f64::INFINITY } else { scale_deviation },
    }
}

/// 1/b that [`LARGE`] of the surface reaches: `inverse` has the b, `weight` the surface of the segments.
fn brightest(inverse: &[f64], weight: &[f64]) -> f64 {
    let mut by_albedo: Vec<(f64, f64)> = inverse.iter().copied().zip(weight.iter().copied()).collect();
    by_albedo.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut left = LARGE * weight.iter().sum::<f64>();
    let reached = by_albedo.into_iter().find(|(_, weight)| {
        left -= weight;
        left <= 0.0
    });
    reached.map_or(f64::MIN_POSITIVE, |(b, _)| 1.0 / b.max(1e-30))
}

/// Standard deviation of every coefficient: noise variance times the inverse of the system with its prior, which only the
/// first `coefficients` have.
fn posterior(mut gram: DMatrix<f64>, noise: f64, prior: f64, coefficients: usize) -> Vec<f64> {
    let dim = gram.nrows();
    let least = 1e-9 * gram.trace() / dim as f64;
    (0..dim).for_each(|j| gram[(j, j)] += least + if j < coefficients { prior } else { 0.0 });
    match gram.cholesky() {
        Some(factor) => factor.inverse().diagonal().iter().map(|v| libm::sqrt(noise * v.max(0.0))).collect(),
        None => vec![f64::INFINITY; dim],
    }
}

/// Sufficient statistics of `Σ w (e u_s + y − t z)²` with the light z and one unknown u_s a segment: (N5) has e = f, y = 0 and
/// u = b, a step of Gauss–Newton e = E, y = f b and u = −δ.
struct Statistics {
    /// Σ w e²: `[segment]`.
    square: Vec<f64>,
    /// Σ w e t: `[segment]`.
    cross: Vec<DVector<f64>>,
    /// Σ w e y: `[segment]`.
    known: Vec<f64>,
    /// Σ w y t over all.
    known_cross: DVector<f64>,
    /// Σ w t tᵀ over all.
    gram: DMatrix<f64>,
}

impl Statistics {
    fn new(segments: usize, dim: usize) -> Self {
        Self {
            square: vec![0.0; segments],
            cross: vec![DVector::zeros(dim); segments],
            known: vec![0.0; segments],
            known_cross: DVector::zeros(dim),
            gram: DMatrix::zeros(dim, dim),
        }
    }

    /// The form in the light alone: ½ zᵀ H z − gᵀ z.
    fn reduced(&self) -> (DMatrix<f64>, DVector<f64>) {
        let (mut gram, mut explained) = (self.gram.clone(), self.known_cross.clone());
        gram.fill_lower_triangle_with_upper_triangle();
        for ((square, cross), known) in self.square.iter().zip(&self.cross).zip(&self.known) {
            if *square > 0.0 {
                gram.ger(-1.0 / square, cross, cross, 1.0);
                explained.axpy(-known / square, cross, 1.0);
            }
        }
        (gram, explained)
    }

    /// u of every segment under this light, where there is a sample: `[segment]`.
    fn eliminated(&self, light: &DVector<f64>) -> impl Iterator<Item = Option<f64>> {
        let sums = self.square.iter().zip(&self.cross).zip(&self.known);
        sums.map(|((square, cross), known)| (*square > 0.0).then(|| (cross.dot(light) - known) / square))
    }
}

/// One sample of the statistics.
struct Row<'a> {
    segment: usize,
    weight: f64,
    /// e.
    factor: f64,
    /// y.
    known: f64,
    /// Its part of the mean light.
    share: f64,
    /// t but for its last entry.
    shared: &'a [f32],
    /// The last entry of t.
    secondary: f64,
}

/// Adds samples to the statistics, and to the `mean` of t.
struct Summed<'a, R> {
    statistics: &'a mut Statistics,
    mean: &'a mut [f64],
    rows: R,
}

impl<'r, R: Iterator<Item = Row<'r>>> Hot for Summed<'_, R> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { statistics, mean, rows } = self;
        let mut row = vec![0.0; mean.len()];
        for Row { segment, weight, factor, known, share, shared, secondary } in rows {
            row.iter_mut().zip(shared).for_each(|(r, t)| *r = f64::from(*t));
            row[shared.len()] = secondary;
            statistics.square[segment] += weight * factor * factor;
            statistics.known[segment] += weight * factor * known;
            add_scaled(statistics.cross[segment].as_mut_slice(), weight * factor, &row);
            if known > 0.0 {
                add_scaled(statistics.known_cross.as_mut_slice(), weight * known, &row);
            }
            let gram = statistics.gram.as_mut_slice().chunks_exact_mut(row.len());
            for (j, (column, t)) in gram.zip(&row).enumerate() {
                add_scaled(&mut column[..=j], weight * t, &row[..=j]);
            }
            add_scaled(mean, share, &row);
        }
    }
}

impl Rows<'_> {
    /// The shared values with one more column at the end, and the number of columns.
    #[must_use]
    pub fn with_column(&self, column: &[f32]) -> (Vec<f32>, usize) {
        let mut shared = Vec::with_capacity(self.shared.len() + column.len());
        for (n, value) in column.iter().enumerate() {
            shared.extend_from_slice(&self.shared[n * self.columns..(n + 1) * self.columns]);
            shared.push(*value);
        }
        (shared, self.columns + 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::factorisation::directions;

    /// A uniform sky over surface of albedo ½, and one emitter of which only the last sample gets `share`, which is `bright` times as
    /// bright as the others and weighs `weight`. Light at the last over that at the first, and the emitter's radiance over the latter.
    fn light_at_the_last(bright: f64, weight: f64, share: f32, least_brought: f64) -> [f64; 2] {
        let count = 200;
        let mut samples = Samples {
            vertex: (0..count).collect(),
            segment: vec![0; count as usize],
            weight: vec![1.0; count as usize],
            block: vec![1; count as usize],
            fold: 0,
            patch: vec![0; count as usize],
            color: (0..count).map(|n| [0.5 + 0.01 * f64::from(n % 3); 3]).collect(),
            segments: 1,
            medians: vec![[0.5; 3]],
        };
        let last = samples.len() - 1;
        (samples.weight[last], samples.color[last]) = (weight, [0.5 * bright; 3]);
        let sky = 0.5 / libm::sqrt(std::f64::consts::PI);
        let shared: Vec<f32> = (0..=last).flat_map(|n| [sky as f32, if n == last { share } else { 0.0 }]).collect();
        let secondary = vec![[0.05; 3]; samples.len()];
        let rows = Rows {
            samples: &samples,
            coefficients: 1,
            columns: 2,
            shared: &shared,
            secondary: &secondary,
            least_brought: &[least_brought],
        };
        let solved = solve(&rows, 1e-3);
        assert_eq!(solved.radiance.len(), directions().len());
        [solved.irradiance[last][0], solved.light[1][0]].map(|x| x / solved.irradiance[0][0])
    }

    /// A sky and secondary light over surface of albedo ½, and a corner of the same that secondary light alone reaches, `more` of it than
    /// is known.
    #[test]
    fn a_corner_that_unknown_light_reaches_does_not_take_away_all_secondary_light() {
        let (count, corner) = (400u32, 380);
        let sky = 0.5 / libm::sqrt(std::f64::consts::PI);
        let in_corner = |n: u32| n >= corner;
        let open = |n: u32| if in_corner(n) { 0.0 } else { 0.2 + 0.8 * f64::from(n % 7) / 6.0 };
        let reflected = |n: u32| 0.05 + 0.25 * f64::from(n % 5) / 4.0;
        let more = |n: u32| if in_corner(n) { 3.0 } else { 1.0 };
        let samples = Samples {
            vertex: (0..count).collect(),
            segment: (0..count).map(|n| u32::from(in_corner(n))).collect(),
            weight: vec![1.0; count as usize],
            block: vec![1; count as usize],
            fold: 0,
            patch: vec![0; count as usize],
            color: (0..count).map(|n| [0.5 * (open(n) + more(n) * reflected(n)); 3]).collect(),
            segments: 2,
            medians: vec![[0.4; 3], [0.25; 3]],
        };
        let shared: Vec<f32> = (0..count).map(|n| (open(n) * sky) as f32).collect();
        let secondary: Vec<[f64; 3]> = (0..count).map(|n| [reflected(n); 3]).collect();
        let (coefficients, columns) = (1, 1);
        let rows = Rows {
            samples: &samples,
            coefficients,
            columns,
            shared: &shared,
            secondary: &secondary,
            least_brought: &[],
        };
        let albedo = solve(&rows, 1e-3).albedo[0][0];
        assert!((albedo - 0.5).abs() < 0.05, "{albedo}");
    }

    #[test]
    fn what_one_poor_sample_tells_is_not_taken_for_a_strong_light() {
        let [told, _] = light_at_the_last(20.0, 1.0, 1.0, 0.0);
        assert!((18.0..22.0).contains(&told), "{told}");
        let [poor, _] = light_at_the_last(1e5, 1e-6, 1.0, 0.0);
        assert!(poor < 1e3, "{poor}");
    }

    #[test]
    fn what_next_to_no_light_arrives_of_does_not_blind() {
        // A thousandth of what it radiates arrives, and makes one sample twice as bright.
        let [_, blinding] = light_at_the_last(2.0, 1e-4, 1e-3, 0.0);
        let [_, held] = light_at_the_last(2.0, 1e-4, 1e-3, 1.0);
        assert!(blinding > 500.0 && held < 300.0, "{blinding} {held}");
    }
}
