//! Model only what the scene requires (§7 of the design): bands, transfer and rays, by evidence from this scene.

use crate::factorisation::held_out::BlockError;
use crate::factorisation::{Colors, Factorised, Observed, Solution, Start, held_out, robust_solver, start_from};
use crate::numerics::robust::{SampleMean, median};
use crate::transfer::{self, ERROR_OF_TWICE, Traced, Transfer};
use firmware_config::tuning::{EstimatorTuning, ModelSelectionTuning};
use firmware_config::{EstimatorConfig, TransferChoice};
use glam::Vec3;
use rayon::prelude::*;
use recordings::decision::{BandsGain, Decision};
use std::ops::RangeInclusive;
use std::sync::Arc;

/// Bands tried upwards from the first, …
const UPWARD: [usize; 4] = [3, 5, 7, 9];
/// … and downwards, if the first is chosen, while nothing is lost.
const DOWNWARD: [usize; 2] = [2, 1];

/// Rays per vertex with which the error of the transfer is a small share of the held-out error: `traced.rays` times a power of
/// two.
#[must_use]
pub fn rays(traced: &Traced, held_out: f64, tuning: &ModelSelectionTuning) -> u32 {
    let mut rays = traced.rays;
    let mut error = traced.relative_error();
    while error > tuning.transfer_error_share * held_out && rays < tuning.max_rays {
        rays *= 2;
        error *= ERROR_OF_TWICE;
    }
    rays
}

/// Mean relative error of a factorisation on held-out vertices.
#[must_use]
pub fn held_out_error(found: &Factorised, colors: &Colors, tuning: &EstimatorTuning) -> f64 {
    held_out::mean(&held_out_errors(&found.solution.albedo, &found.irradiance, colors, tuning))
}

/// Relative errors of albedo × irradiance on held-out vertices, by blocks. `albedo` is `[segment][channel]`, `irradiance` over π is
/// `[vertex]`.
#[must_use]
pub fn held_out_errors(
    albedo: &[[f64; 3]],
    irradiance: &[Vec3],
    colors: &Colors,
    tuning: &EstimatorTuning,
) -> Vec<BlockError> {
    HeldOut::new(colors, tuning).errors(albedo, irradiance)
}

/// True if visibility is ignored: fewer rays are blocked than colours err.
#[must_use]
pub fn is_open(config: &EstimatorConfig, blocked: f64) -> bool {
    match config.transfer {
        TransferChoice::Diffuse => true,
        TransferChoice::Auto => blocked < config.tuning.model_selection.color_error,
        _ => false,
    }
}

/// True if interreflection is modelled: one bounce between grey surfaces exceeds the errors of rays and colours.
#[must_use]
pub fn interreflects(config: &EstimatorConfig, traced: &Traced) -> bool {
    match config.transfer {
        TransferChoice::Gi => true,
        TransferChoice::Shade | TransferChoice::Diffuse => false,
        TransferChoice::Auto => {
            traced.mean_blocked() > config.gi_from_blocked
                && grey_bounce(traced, config) > config.tuning.model_selection.color_error
        }
    }
}

/// Share of one bounce between grey surfaces in the light.
#[must_use]
pub fn grey_bounce(traced: &Traced, config: &EstimatorConfig) -> f64 {
    transfer::bounce(traced, &grey(traced, &config.tuning), 1).share
}

fn grey(traced: &Traced, tuning: &EstimatorTuning) -> Vec<Vec3> {
    vec![Vec3::splat(tuning.factorisation.initial_albedo as f32); traced.vertices()]
}

/// Limits of the selection of bands.
pub struct BandLimits {
    /// Interreflection is modelled.
    pub gi: bool,
    /// Bounces; 0 = until convergence.
    pub bounces: u32,
    /// Bands that may be chosen.
    pub bands: RangeInclusive<usize>,
}

/// The bands chosen, and a solution with them under the bounced light of grey surfaces.
pub struct Selected {
    /// SH bands.
    pub bands: usize,
    /// Mean relative error on held-out vertices.
    pub held_out: f64,
    /// The evidence.
    pub decision: Decision,
    /// A start for the factorisation.
    pub start: Start,
}

/// The fewest bands such that no tried level above predicts the held-out vertices significantly better.
#[must_use]
pub fn bands(traced: &Arc<Traced>, colors: &Colors, limits: &BandLimits, tuning: &EstimatorTuning) -> Selected {
    let bounced = limits.gi.then(|| transfer::bounce_scaled(traced, &grey(traced, tuning), limits.bounces));
    let transfer = Transfer { traced: Arc::clone(traced), bounced };
    let trials = Trials { observed: colors.under(&transfer), held_out: HeldOut::new(colors, tuning), tuning };
    let mut tried = Vec::new();
    let Search { best, next } = trials.search(*limits.bands.start(), *limits.bands.end(), &mut tried);
    tried.sort_unstable_by_key(|t| t.0);
    let decision = Decision::Bands {
        chosen: best.bands as u32,
        held_out: tried,
        condition: best.solution.condition,
        next: next.map(|(n, g)| BandsGain { bands: n as u32, gain: g.mean, standard_error: g.error }),
    };
    let (bands, held_out) = (best.bands, best.error());
    let start = start_from(transfer, colors, best.solution, &tuning.factorisation);
    Selected { bands, held_out, decision, start }
}

/// The held-out vertices.
struct HeldOut<'a> {
    colors: &'a Colors<'a>,
    /// Smallest brightness that errors are relative to: `[segment]`.
    floors: Vec<f64>,
    max_error: f64,
}

impl<'a> HeldOut<'a> {
    fn new(colors: &'a Colors, tuning: &EstimatorTuning) -> Self {
        let mut brightness: Vec<Vec<f64>> = vec![Vec::new(); colors.segments];
        for ((f, weight), segment) in colors.lit_color.iter().zip(colors.lit_weight).zip(colors.segment) {
            if *weight > 0.0 && f.is_finite() {
                brightness[*segment as usize].push(f64::from(f.element_sum() / 3.0));
            }
        }
        let floor = |values: Vec<f64>| tuning.factorisation.dark_floor * median(values).unwrap_or(0.0);
        let floors = brightness.into_iter().map(floor).collect();
        Self { colors, floors, max_error: tuning.model_selection.max_error }
    }

    /// Relative errors of albedo × irradiance by blocks. `albedo` is `[segment][channel]`, `irradiance` over π is `[vertex]`.
    fn errors(&self, albedo: &[[f64; 3]], irradiance: &[Vec3]) -> Vec<BlockError> {
        let colors = self.colors;
        let errors: Vec<Option<(u32, f64)>> = (0..colors.lit_color.len())
            .into_par_iter()
            .map(|i| {
                let block = held_out::block(i as u32)?;
                let f = colors.lit_color[i];
                if colors.lit_weight[i] <= 0.0 || !f.is_finite() || f.max_element() <= 0.0 {
                    return None;
                }
                let segment = colors.segment[i] as usize;
                let size = (f64::from(f.element_sum()) / 3.0).max(self.floors[segment]);
                let off = |c: usize| (f64::from(f[c]) - albedo[segment][c] * f64::from(irradiance[i][c])).abs();
                Some((block, ((off(0) + off(1) + off(2)) / (3.0 * size)).min(self.max_error)))
            })
            .collect();
        held_out::by_block(errors.into_iter().flatten())
    }
}

/// One number of bands, with its solution and its errors on held-out vertices.
struct Level {
    bands: usize,
    blocks: Vec<BlockError>,
    solution: Solution,
}

impl Level {
    fn error(&self) -> f64 {
        held_out::mean(&self.blocks)
    }

    /// How much lower the error is than that of `other`, over the same blocks.
    fn gain_over(&self, other: &Self) -> SampleMean {
        held_out::gain(&self.blocks, &other.blocks)
    }
}

/// The level chosen, and the gain of the next level up, if one was tried.
struct Search {
    best: Level,
    next: Option<(usize, SampleMean)>,
}

/// Solves with different numbers of bands.
struct Trials<'a> {
    observed: Observed<'a>,
    held_out: HeldOut<'a>,
    tuning: &'a EstimatorTuning,
}

impl Trials<'_> {
    /// Tries bands from 3 upwards, then downwards. `tried` gets bands and held-out error of each level.
    fn search(&self, min_bands: usize, max_bands: usize, tried: &mut Vec<(u32, f64)>) -> Search {
        let mut best = self.level(UPWARD[0].clamp(min_bands, max_bands), None, tried);
        let mut next: Option<(usize, SampleMean)> = None;
        let mut without = 0;
        let mut rejected: Option<Level> = None;
        for n in UPWARD.into_iter().skip(1).chain([max_bands]).filter(|n| *n <= max_bands) {
            let patient = without < self.tuning.model_selection.patience;
            if n <= best.bands || !patient || next.is_some_and(|(tried, _)| n <= tried) {
                continue;
            }
            let higher = self.level(n, Some(rejected.as_ref().unwrap_or(&best)), tried);
            let gain = higher.gain_over(&best);
            if self.is_significant(&gain) {
                (best, next, without) = (higher, None, 0);
                rejected = None;
            } else {
                (next, without) = (next.or(Some((n, gain))), without + 1);
                rejected = Some(higher);
            }
        }
        if best.bands <= UPWARD[0] {
            let first = best.bands;
            for n in DOWNWARD.into_iter().filter(|n| (min_bands..first).contains(n)) {
                let lower = self.level(n, None, tried);
                let gain = best.gain_over(&lower);
                if self.is_significant(&gain) {
                    break;
                }
                next = Some((best.bands, gain));
                best = lower;
            }
        }
        Search { best, next }
    }

    /// One level; continues `fewer` bands if these are enough to choose the regularisation by.
    fn level(&self, bands: usize, fewer: Option<&Level>, tried: &mut Vec<(u32, f64)>) -> Level {
        let tuning = &self.tuning.factorisation;
        let start = fewer.filter(|f| f.bands >= tuning.regularisation_bands as usize).map(|f| &f.solution);
        let solution = robust_solver::solve(&self.observed, bands, start, tuning);
        let irradiance = self.observed.transfer.irradiance(&solution.light);
        let blocks = self.held_out.errors(&solution.albedo, &irradiance);
        let level = Level { bands, blocks, solution };
        tried.push((bands as u32, level.error()));
        level
    }

    fn is_significant(&self, gain: &SampleMean) -> bool {
        let tuning = &self.tuning.model_selection;
        gain.mean > tuning.min_significance * gain.error && gain.mean > tuning.min_gain
    }
}
