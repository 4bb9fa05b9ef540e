//! Light and segment albedo from lit colours (Eqs. 9–12).
//!
//! Default solver: the light is non-negative radiance over a few hundred directions, each segment has one albedo, and
//! the two are found in turn on per-segment sufficient statistics, so that no step touches a vertex.

use crate::factorisation::SCALE_SHARE;
use crate::numerics::random::hash;
use crate::numerics::robust::{median, robust_sigma};
use crate::numerics::sh;
use crate::transfer::Transfer;
use glam::Vec3;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Directions that carry radiance.
const DIRECTIONS: usize = 320;
/// Vertices that vote in all, shared out by segment size: many times the unknowns.
const VOTES: usize = 12_000;
/// Votes that a segment has at least, if it has so many vertices.
const SEGMENT_VOTES: usize = 300;
/// Consecutive vertices that are held out together, since neighbours say the same.
const FOLD_BLOCK: u32 = 64;
/// One block in so many is held out.
const FOLDS: u32 = 5;
/// Votes of one partial sum.
const PIECE: usize = 256;
/// Lit colours count relative to themselves, but not below this share of the segment's median.
pub(crate) const DARK_FLOOR: f64 = 0.15;
/// No channel's colours are taken to be smaller than this share of the brightest channel's.
const DARK_CHANNEL: f64 = 1e-3;
/// Gloss that nobody has found yet, against the brightest segment's albedo and in units of the relative error of a lit
/// colour: it is the same in all channels, so it makes dark ones worth little.
const UNKNOWN_GLOSS: f64 = 0.5;
/// Residuals beyond this many robust standard deviations count less (Huber).
const HUBER: f64 = 1.5;
/// Rounds of reweighting.
const REWEIGHTINGS: usize = 3;
/// Alternations of light and albedo.
const MOST_ALTERNATIONS: usize = 80;
/// Alternation ends when no log albedo moves by more.
const ALBEDO_TOLERANCE: f64 = 1e-4;
/// Sweeps of the non-negative solver in one alternation, at most; the next goes on where they end.
const SWEEPS: usize = 12;
/// Weights of the pull towards the mean radiance that are tried, strongest first.
const PULLS: [f64; 5] = [1e-1, 1e-2, 1e-3, 1e-4, 1e-5];
/// Bands by which the pull is chosen at most: what is above lowers held-out errors by so little that a pull which bends the
/// albedos would be taken for as good.
pub const PULL_BANDS: usize = 7;
/// Directions that the surfaces tell less of than this share of the best told one are held at the mean by more than the
/// pull: what few vertices see between rims and holes is their own error rather than light.
const HARDLY_TOLD: f64 = 5e-3;
/// A weaker pull must lower the held-out error by this share to be taken.
const WORTHWHILE: f64 = 0.01;
/// Lit colours of neighbouring vertices err together: so many vertices count as one independent measurement.
const CORRELATED_VERTICES: f64 = 25.0;

/// What is to be explained.
#[derive(Debug, Clone, Copy)]
pub struct Observed<'a> {
    /// Transfer of every vertex.
    pub transfer: &'a Transfer,
    /// Lit colour f of every vertex.
    pub lit_color: &'a [Vec3],
    /// Its weight; 0 = never seen.
    pub lit_weight: &'a [f32],
    /// Segment of every vertex.
    pub segment: &'a [u32],
    /// Number of segments.
    pub segments: usize,
}

/// Light and segment albedos, up to one factor per channel.
#[derive(Debug, Clone)]
pub struct Solution {
    /// `bands²` rows of coefficients.
    pub light: Vec<[f64; 3]>,
    /// Posterior standard deviation, same shape.
    pub standard_deviation: Vec<[f64; 3]>,
    /// The non-negative radiance over [`directions`].
    pub radiance: Vec<[f64; 3]>,
    /// Albedo per segment.
    pub albedo: Vec<[f64; 3]>,
    /// Relative RMS error on vertices that were held out.
    pub held_out: f64,
    /// The pull towards the mean that held-out error chose.
    pub pull: [f64; 3],
    /// Condition number of the light's normal equations, before the pull.
    pub condition: f64,
}

/// The directions that [`Solution::radiance`] refers to.
#[must_use]
pub fn directions() -> Vec<glam::DVec3> {
    sh::even_directions(DIRECTIONS)
}

/// Sufficient statistics of one segment and channel: Σ w T Tᵀ, Σ w f T, Σ w f², Σ w.
#[derive(Debug, Clone)]
struct Statistics {
    gram: DMatrix<f64>,
    cross: DVector<f64>,
    square: f64,
    weight: f64,
}

impl Statistics {
    fn zero(k: usize) -> Self {
        Self { gram: DMatrix::zeros(k, k), cross: DVector::zeros(k), square: 0.0, weight: 0.0 }
    }

    fn add(&mut self, other: &Self) {
        self.gram += &other.gram;
        self.cross += &other.cross;
        self.square += other.square;
        self.weight += other.weight;
    }

    /// Σ w (f − a E)².
    fn residual(&self, albedo: f64, light: &DVector<f64>) -> f64 {
        let predicted = light.dot(&(&self.gram * light));
        (self.square - 2.0 * albedo * self.cross.dot(light) + albedo * albedo * predicted).max(0.0)
    }
}

/// One vertex's say.
#[derive(Debug, Clone, Copy)]
struct Vote {
    vertex: u32,
    segment: u32,
    /// Vertices it stands for.
    share: f64,
    held_out: bool,
}

/// Solves for light and segment albedo, `bands` being at most those of the transfer. Goes on from `start` where there is
/// one, with the pull chosen then.
#[must_use]
pub fn solve(observed: &Observed, bands: usize, start: Option<&Solution>) -> Solution {
    let k = bands * bands;
    let votes = votes(observed);
    let basis = Basis::new(k);
    let channels: Vec<Channel> =
        [0, 1, 2].into_par_iter().map(|c| solve_channel(observed, &votes, &basis, c, start)).collect();
    let zip3 = |n: usize, get: &dyn Fn(&Channel, usize) -> f64| -> Vec<[f64; 3]> {
        (0..n).map(|i| [0, 1, 2].map(|c| get(&channels[c], i))).collect()
    };
    let mean = |get: &dyn Fn(&Channel) -> f64| channels.iter().map(get).sum::<f64>() / 3.0;
    Solution {
        light: zip3(k, &|c, i| c.light[i]),
        standard_deviation: zip3(k, &|c, i| c.standard_deviation[i]),
        radiance: zip3(DIRECTIONS, &|c, i| c.radiance[i]),
        albedo: zip3(observed.segments, &|c, i| c.albedo[i]),
        held_out: libm::sqrt(mean(&|c| c.held_out)),
        pull: [0, 1, 2].map(|c| channels[c].pull),
        condition: channels.iter().map(|c| c.condition).fold(0.0, f64::max),
    }
}

struct Channel {
    light: DVector<f64>,
    standard_deviation: Vec<f64>,
    radiance: DVector<f64>,
    albedo: Vec<f64>,
    held_out: f64,
    pull: f64,
    condition: f64,
}

/// SH values at the radiance directions, times the solid angle of each: light = `project` · radiance.
struct Basis {
    project: DMatrix<f64>,
}

impl Basis {
    fn new(k: usize) -> Self {
        let mut y = vec![0.0; k];
        let mut project = DMatrix::zeros(k, DIRECTIONS);
        for (d, direction) in directions().into_iter().enumerate() {
            sh::eval(direction, &mut y);
            project
                .column_mut(d)
                .iter_mut()
                .zip(&y)
                .for_each(|(p, y)| *p = y * 4.0 * std::f64::consts::PI / DIRECTIONS as f64);
        }
        Self { project }
    }
}

/// The vertices that vote, by segment: evenly strided, and each standing for those it stepped over.
fn votes(observed: &Observed) -> Vec<Vote> {
    let usable = |i: &usize| {
        let f = observed.lit_color[*i];
        observed.lit_weight[*i] > 0.0 && f.is_finite() && f.min_element() >= 0.0 && f.max_element() > 0.0
    };
    let mut of_segment: Vec<Vec<usize>> = vec![Vec::new(); observed.segments];
    for i in (0..observed.lit_color.len()).filter(usable) {
        of_segment[observed.segment[i] as usize].push(i);
    }
    let total: usize = of_segment.iter().map(Vec::len).sum();
    let mut votes = Vec::new();
    for (segment, vertices) in (0u32..).zip(&of_segment) {
        let quota = (VOTES * vertices.len() / total.max(1)).max(SEGMENT_VOTES);
        let stride = vertices.len().div_ceil(quota).max(1);
        votes.extend(vertices.iter().step_by(stride).map(|&i| Vote {
            vertex: i as u32,
            segment,
            share: stride as f64,
            held_out: held_out_block(i as u32).is_some(),
        }));
    }
    votes
}

/// The block of vertices that is held out, if this vertex is in one.
pub(crate) fn held_out_block(vertex: u32) -> Option<u32> {
    let block = vertex / FOLD_BLOCK;
    hash(block, 0xf01d).is_multiple_of(FOLDS).then_some(block)
}

/// Statistics of every segment: those that are fitted, and those held out.
fn accumulate(observed: &Observed, votes: &[Vote], weights: &[f64], k: usize, channel: usize) -> [Vec<Statistics>; 2] {
    let mut pieces: Vec<(u32, std::ops::Range<usize>)> = Vec::new();
    let mut start = 0;
    while start < votes.len() {
        let segment = votes[start].segment;
        let length = votes[start..].iter().take(PIECE).take_while(|v| v.segment == segment).count();
        pieces.push((segment, start..start + length));
        start += length;
    }
    let partial: Vec<[Statistics; 2]> = pieces
        .par_iter()
        .map(|(_, range)| {
            [false, true].map(|held_out| {
                let voting: Vec<usize> =
                    range.clone().filter(|&j| votes[j].held_out == held_out && weights[j] > 0.0).collect();
                let mut rows = DMatrix::zeros(k, voting.len());
                let mut weighted = DMatrix::zeros(k, voting.len());
                let mut sum = Statistics::zero(k);
                for (n, &j) in voting.iter().enumerate() {
                    let (vertex, w) = (votes[j].vertex as usize, weights[j]);
                    let f = f64::from(observed.lit_color[vertex][channel]);
                    observed.transfer.row(vertex, channel, rows.column_mut(n).as_mut_slice());
                    weighted.column_mut(n).axpy(w, &rows.column(n), 0.0);
                    sum.cross.axpy(w * f, &rows.column(n), 1.0);
                    sum.square += w * f * f;
                    sum.weight += w;
                }
                sum.gram.gemm(1.0, &weighted, &rows.transpose(), 0.0);
                sum
            })
        })
        .collect();
    let mut total = [vec![Statistics::zero(k); observed.segments], vec![Statistics::zero(k); observed.segments]];
    for ((segment, _), sums) in pieces.iter().zip(&partial) {
        for (total, sum) in total.iter_mut().zip(sums) {
            total[*segment as usize].add(sum);
        }
    }
    for statistics in total.iter_mut().flatten() {
        statistics.gram.fill_lower_triangle_with_upper_triangle();
    }
    total
}

fn solve_channel(
    observed: &Observed,
    votes: &[Vote],
    basis: &Basis,
    channel: usize,
    start: Option<&Solution>,
) -> Channel {
    let k = basis.project.nrows();
    let color = |v: &Vote| f64::from(observed.lit_color[v.vertex as usize][channel]);
    let mut medians = vec![0.0; observed.segments];
    for group in votes.chunk_by(|a, b| a.segment == b.segment) {
        medians[group[0].segment as usize] = median(group.iter().map(color)).unwrap_or(0.0);
    }
    // A channel that is dark everywhere is measured against the others: its own size would be a division by nothing.
    let brightest = |v: &Vote| f64::from(observed.lit_color[v.vertex as usize].max_element());
    let least = DARK_CHANNEL * median(votes.iter().map(brightest)).unwrap_or(0.0);
    let overall = median(votes.iter().map(color)).unwrap_or(0.0).max(least).max(1e-30);
    // Relative weights: a lit colour errs in proportion to itself, and by gloss in proportion to its light.
    let relative = |v: &Vote, predicted: f64, gloss: &[f64]| {
        let size = predicted.max(DARK_FLOOR * medians[v.segment as usize]).max(1e-3 * overall);
        let vertex = v.vertex as usize;
        let seen =
            f64::from(observed.lit_weight[vertex]).min(1.0) * f64::from(observed.transfer.traced.vertex_weight[vertex]);
        v.share * seen / (size * size * (1.0 + gloss[v.segment as usize]))
    };
    let mut state = match start {
        Some(start) => Alternation {
            radiance: DVector::from_iterator(DIRECTIONS, start.radiance.iter().map(|r| r[channel])),
            albedo: start.albedo.iter().map(|a| a[channel]).collect(),
        },
        // Uniform light, each segment as bright as its colours say.
        None => Alternation {
            radiance: DVector::from_element(DIRECTIONS, 1.0),
            albedo: medians.iter().map(|m| m.max(1e-6 * overall) / overall * 0.5).collect(),
        },
    };
    let gloss = unknown_gloss(&state.albedo, votes);
    let mut weights: Vec<f64> = votes.iter().map(|v| relative(v, color(v), &gloss)).collect();
    let mut row = vec![0.0; k];
    let mut chosen = (start.map_or(PULLS[2], |s| s.pull[channel]), f64::INFINITY);
    let mut statistics = accumulate(observed, votes, &weights, k, channel);
    for round in 0..REWEIGHTINGS {
        if round + 1 == REWEIGHTINGS && start.is_none() {
            chosen.0 = choose_pull(&statistics, basis, &mut state);
        }
        state.run(&statistics[0], basis, chosen.0);
        if round + 1 < REWEIGHTINGS {
            let light = &basis.project * &state.radiance;
            let predicted: Vec<f64> = votes
                .iter()
                .map(|v| {
                    observed.transfer.row(v.vertex as usize, channel, &mut row);
                    let e: f64 = row.iter().zip(light.iter()).map(|(t, l)| t * l).sum();
                    state.albedo[v.segment as usize] * e.max(0.0)
                })
                .collect();
            let size = |v: &Vote, p: f64| p.max(DARK_FLOOR * medians[v.segment as usize]).max(1e-3 * overall);
            let off: Vec<f64> =
                votes.iter().zip(&predicted).map(|(v, p)| ((color(v) - p) / size(v, *p)).abs()).collect();
            let sigma = robust_sigma(off.iter().copied()) + 1e-9;
            let gloss = unknown_gloss(&state.albedo, votes);
            for ((w, v), (p, r)) in weights.iter_mut().zip(votes).zip(predicted.iter().zip(&off)) {
                *w = relative(v, *p, &gloss) * (HUBER * sigma / r.max(HUBER * sigma));
            }
            statistics = accumulate(observed, votes, &weights, k, channel);
        }
    }
    chosen.1 = held_out(&statistics[1], basis, &state);
    finish(&statistics, basis, &state, chosen)
}

/// Variance that gloss which is not known adds to each segment's relative error, in units of its own variance.
fn unknown_gloss(albedo: &[f64], votes: &[Vote]) -> Vec<f64> {
    let mut seen = vec![0.0; albedo.len()];
    votes.iter().for_each(|v| seen[v.segment as usize] += v.share);
    let least = SCALE_SHARE * seen.iter().sum::<f64>();
    let large = albedo.iter().zip(&seen).filter(|(_, n)| **n >= least).map(|(a, _)| *a);
    let brightest = large.fold(0.0, f64::max);
    albedo.iter().map(|a| (UNKNOWN_GLOSS * brightest / a.max(1e-6 * brightest)).powi(2).min(1e6)).collect()
}

/// Light and albedos on their way.
#[derive(Debug, Clone)]
struct Alternation {
    radiance: DVector<f64>,
    albedo: Vec<f64>,
}

impl Alternation {
    /// Light and albedo in turn until nothing moves. The free factor is held by the mean radiance: 1.
    fn run(&mut self, statistics: &[Statistics], basis: &Basis, pull: f64) {
        let k = basis.project.nrows();
        let total: f64 = statistics.iter().map(|s| s.square).sum();
        if total <= 0.0 {
            return;
        }
        for _ in 0..MOST_ALTERNATIONS {
            let mut gram = DMatrix::zeros(k, k);
            let mut cross = DVector::zeros(k);
            for (s, a) in statistics.iter().zip(&self.albedo) {
                gram += &s.gram * (a * a);
                cross += &s.cross * *a;
            }
            // Eq. (10) for non-negative radiance, pulled towards the mean: pull · total · mean of (r − 1)².
            non_negative(&gram, &cross, basis, pull * total / DIRECTIONS as f64, &mut self.radiance);
            let mean = self.radiance.mean();
            if mean <= 0.0 || !mean.is_finite() {
                self.radiance.fill(1.0);
                return;
            }
            self.radiance /= mean;
            let light = &basis.project * &self.radiance;
            // Eq. (11), default: a_u = Σ f E / Σ E².
            let mut moved = 0.0f64;
            for (s, a) in statistics.iter().zip(self.albedo.iter_mut()) {
                let predicted = light.dot(&(&s.gram * &light));
                let explained = s.cross.dot(&light);
                if s.weight > 0.0 && predicted > 0.0 && explained > 0.0 {
                    let new = explained / predicted;
                    moved = moved.max(libm::log(new / *a).abs());
                    *a = new;
                }
            }
            if moved < ALBEDO_TOLERANCE {
                break;
            }
        }
    }
}

/// The weakest pull that still lowers the held-out error.
fn choose_pull(statistics: &[Vec<Statistics>; 2], basis: &Basis, state: &mut Alternation) -> f64 {
    let mut best: Option<(f64, f64, Alternation)> = None;
    for pull in PULLS {
        let mut trial = state.clone();
        trial.run(&statistics[0], basis, pull);
        let error = held_out(&statistics[1], basis, &trial);
        if best.as_ref().is_none_or(|b| error < b.1 * (1.0 - WORTHWHILE)) {
            best = Some((pull, error, trial));
        }
    }
    match best {
        Some((pull, _, trial)) => {
            *state = trial;
            pull
        }
        None => PULLS[0],
    }
}

/// Mean squared relative error on what was held out.
fn held_out(statistics: &[Statistics], basis: &Basis, state: &Alternation) -> f64 {
    let light = &basis.project * &state.radiance;
    let (mut error, mut size) = (0.0, 0.0);
    for (s, a) in statistics.iter().zip(&state.albedo) {
        error += s.residual(*a, &light);
        size += s.square;
    }
    if size > 0.0 { error / size } else { 0.0 }
}

/// `min ½ rᵀ Pᵀ G P r − (Pᵀ g)ᵀ r + ½ Σ_d s_d (r_d − 1)²` over r ≥ 0 by coordinate descent from where `r` stands, P being
/// the projection to coefficients: the gradient is kept there, where it is short. `s_d` is `strength`, more where the
/// direction is [`HARDLY_TOLD`].
fn non_negative(gram: &DMatrix<f64>, cross: &DVector<f64>, basis: &Basis, strength: f64, r: &mut DVector<f64>) {
    let columns = gram * &basis.project;
    let told: Vec<f64> = (0..r.len()).map(|d| basis.project.column(d).dot(&columns.column(d)).max(0.0)).collect();
    let least = HARDLY_TOLD * told.iter().copied().fold(0.0, f64::max);
    let mut gradient = gram * (&basis.project * &*r) - cross;
    for _ in 0..SWEEPS {
        let (mut moved, mut size) = (0.0, 0.0);
        for d in 0..r.len() {
            let column = basis.project.column(d);
            let strength = strength * (1.0 + least / told[d].max(1e-4 * least));
            let diagonal = told[d] + strength;
            if diagonal <= 0.0 {
                continue;
            }
            let slope = column.dot(&gradient) + strength * (r[d] - 1.0);
            let step = (r[d] - slope / diagonal).max(0.0) - r[d];
            if step != 0.0 {
                r[d] += step;
                gradient.axpy(step, &columns.column(d), 1.0);
                moved += step * step;
            }
            size += r[d] * r[d];
        }
        if moved <= 1e-10 * size {
            break;
        }
    }
}

fn finish(statistics: &[Vec<Statistics>; 2], basis: &Basis, state: &Alternation, chosen: (f64, f64)) -> Channel {
    let k = basis.project.nrows();
    let light = &basis.project * &state.radiance;
    let mut gram = DMatrix::zeros(k, k);
    let (mut residual, mut total) = (0.0, 0.0);
    for s in statistics.iter().flatten().zip(state.albedo.iter().cycle()) {
        let (s, a) = s;
        gram += &s.gram * (a * a);
        residual += s.residual(*a, &light);
        total += s.square;
    }
    let (condition, standard_deviation) = posterior(gram, residual, total, chosen.0, k);
    Channel {
        light,
        standard_deviation,
        radiance: state.radiance.clone(),
        albedo: state.albedo.clone(),
        held_out: chosen.1,
        pull: chosen.0,
        condition,
    }
}

/// Condition number, and standard deviation of each coefficient: noise variance times the inverse of the system with its
/// pull. What the data do not determine is left with the deviation that the pull allows.
fn posterior(gram: DMatrix<f64>, residual: f64, total: f64, pull: f64, k: usize) -> (f64, Vec<f64>) {
    if total <= 0.0 {
        return (f64::INFINITY, vec![f64::MAX.sqrt(); k]);
    }
    // The decomposition is given numbers about 1: its tolerances are absolute.
    let scale = gram.amax();
    if !(scale > 0.0 && scale.is_finite()) {
        return (f64::INFINITY, vec![f64::MAX.sqrt(); k]);
    }
    let mut eigen = (gram / scale).symmetric_eigen();
    eigen.eigenvalues *= scale;
    let largest = eigen.eigenvalues.max();
    let smallest = eigen.eigenvalues.min();
    let condition = if smallest > 0.0 { largest / smallest } else { f64::INFINITY };
    // mean of (r − 1)² over directions = Σ (i_k)² / 4π for the bands above 0.
    let prior = (pull * total / (4.0 * std::f64::consts::PI)).max(1e-12 * largest);
    let noise = (residual / total).max(1e-12) * CORRELATED_VERTICES;
    let deviation = (0..k)
        .map(|i| {
            let variance: f64 = eigen
                .eigenvectors
                .row(i)
                .iter()
                .zip(eigen.eigenvalues.iter())
                .map(|(v, e)| v * v * noise / (e.max(0.0) + prior))
                .sum();
            libm::sqrt(variance)
        })
        .collect();
    (condition, deviation)
}
