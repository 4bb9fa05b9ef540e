//! Model only what the scene requires (DESIGN §7): bands, transfer and rays by evidence from this scene.

use crate::factorisation::robust_solver::{self, DARK_FLOOR, Observed, Solution};
use crate::factorisation::{self, Colors, Factorised, MID_GREY, Start};
use crate::numerics::robust::{SampleMean, median};
use crate::rays::RayScene;
use crate::transfer::{self, ERROR_OF_TWICE, Pilot, Traced, Transfer};
use firmware_config::{EstimatorConfig, TransferChoice};
use glam::Vec3;
use rayon::prelude::*;
use recordings::decision::{BandsGain, Decision};
use recordings::types::Mesh;
use std::sync::Arc;

/// Bands that are tried upward from the first, until so many levels in a row bring no gain …
const UPWARD: [usize; 4] = [3, 5, 7, 9];
const PATIENCE: usize = 2;
/// … and, where the first was not exceeded, downward while nothing is lost.
const DOWNWARD: [usize; 2] = [2, 1];
/// A level is better if its gain on what was left out exceeds this many standard errors of that gain.
const SIGNIFICANT: f64 = 1.0;
/// … and this: colours of eight bits are rounded by ten times as much.
const LEAST_GAIN: f64 = 2e-4;
/// Relative errors count up to this.
const CAPPED: f64 = 0.5;
/// Vertices of the pilot.
const PILOT_VERTICES: usize = 1024;
/// Rays of the pilot, and those that every selection begins with.
pub const PILOT_RAYS: u32 = 64;
/// The transfer's relative standard error may be this share of what is left unexplained: a tenth of the variance.
const TRANSFER_SHARE: f64 = 0.316;
/// Most rays that are chosen.
const MOST_RAYS: u32 = 1024;
/// Error with which a lit colour is known, however often it was seen: bounced light below it cannot be told.
const COLOR_ERROR: f64 = 0.01;

/// What a few rays tell of the scene.
#[must_use]
pub fn pilot(mesh: &Mesh, scene: &RayScene, seed: u32) -> Pilot {
    transfer::pilot(mesh, scene, PILOT_VERTICES, PILOT_RAYS, seed)
}

/// Rays per vertex with which the transfer errs by a small part of what light and albedo leave unexplained on vertices
/// that were left out: a power of two times [`PILOT_RAYS`].
#[must_use]
pub fn rays(traced: &Traced, held_out: f64) -> u32 {
    let mut rays = traced.rays;
    let mut error = traced.relative_error();
    while error > TRANSFER_SHARE * held_out && rays < MOST_RAYS {
        rays *= 2;
        error *= ERROR_OF_TWICE;
    }
    rays
}

/// Mean relative error of an answer on vertices that were left out of it.
#[must_use]
pub fn held_out(found: &Factorised, evidence: &Colors) -> f64 {
    mean(&left_out(evidence, &floors(evidence), &found.solution.albedo, &found.irradiance))
}

/// Rays are traced if more are blocked than colours err.
#[must_use]
pub fn is_open(config: &EstimatorConfig, blocked: f64) -> bool {
    match config.transfer {
        TransferChoice::Diffuse => true,
        TransferChoice::Auto => blocked < COLOR_ERROR,
        _ => false,
    }
}

/// Whether interreflection is modelled: if the light of one bounce between mid-grey surfaces stands out of the error of
/// the rays and of the colours.
#[must_use]
pub fn interreflects(config: &EstimatorConfig, traced: &Traced) -> bool {
    match config.transfer {
        TransferChoice::Gi => true,
        TransferChoice::Shade | TransferChoice::Diffuse => false,
        TransferChoice::Auto => traced.mean_blocked() > config.gi_from_blocked && grey_bounce(traced) > COLOR_ERROR,
    }
}

/// Share of the light that one bounce between mid-grey surfaces brings.
#[must_use]
pub fn grey_bounce(traced: &Traced) -> f64 {
    transfer::bounce(traced, &vec![Vec3::splat(MID_GREY); traced.vertices()], 1).share
}

/// The fewest bands of a range that nothing above in it predicts the held-out vertices significantly better than.
#[must_use]
pub fn bands(
    traced: &Arc<Traced>,
    evidence: &Colors,
    gi: bool,
    bounces: u32,
    range: std::ops::RangeInclusive<usize>,
) -> Selected {
    let (least, most) = range.into_inner();
    let grey = || vec![Vec3::splat(MID_GREY); traced.vertices()];
    let bounced = gi.then(|| transfer::bounce_and_rest(traced, &grey(), bounces));
    let transfer = Transfer { traced: Arc::clone(traced), bounced };
    let observed = evidence.under(&transfer);
    let floors = floors(evidence);
    let level = |n: usize, fewer: Option<&Level>| Level::new(&observed, evidence, &floors, n, fewer);
    let mut tried = Vec::new();
    let mut note = |l: &Level| tried.push((l.bands as u32, l.error()));
    let mut best = level(UPWARD[0].clamp(least, most), None);
    note(&best);
    let mut next: Option<(usize, SampleMean)> = None;
    let mut without = 0;
    for n in UPWARD.into_iter().skip(1).chain([most]).filter(|n| *n <= most) {
        if n <= best.bands || without >= PATIENCE || next.is_some_and(|(tried, _)| n <= tried) {
            continue;
        }
        let higher = level(n, Some(&best));
        note(&higher);
        let gain = higher.gain_over(&best);
        if is_significant(&gain) {
            (best, next, without) = (higher, None, 0);
        } else {
            (next, without) = (next.or(Some((n, gain))), without + 1);
        }
    }
    if best.bands <= UPWARD[0] {
        let first = best.bands;
        for n in DOWNWARD.into_iter().filter(|n| (least..first).contains(n)) {
            let lower = level(n, None);
            note(&lower);
            let gain = best.gain_over(&lower);
            if is_significant(&gain) {
                break;
            }
            next = Some((best.bands, gain));
            best = lower;
        }
    }
    tried.sort_unstable_by_key(|t| t.0);
    let chosen = best.bands;
    let decision = Decision::Bands {
        chosen: chosen as u32,
        held_out: tried,
        condition: best.condition,
        next: next.map(|(n, g)| BandsGain { bands: n as u32, gain: g.mean, standard_error: g.error }),
    };
    let held_out = best.error();
    let start = factorisation::start_from(transfer, evidence, best.solution);
    Selected { bands: chosen, held_out, decision, start }
}

/// Bands, why, and the solution with them, whose bounced light is that of mid-grey surfaces.
pub struct Selected {
    /// SH bands.
    pub bands: usize,
    /// Mean relative error on vertices that were left out.
    pub held_out: f64,
    /// Why.
    pub decision: Decision,
    /// Where the factorisation may go on from.
    pub start: Start,
}

/// What errors are relative to at least, per segment.
fn floors(evidence: &Colors) -> Vec<f64> {
    let mut colors: Vec<Vec<f64>> = vec![Vec::new(); evidence.segments];
    for ((f, weight), segment) in evidence.lit_color.iter().zip(evidence.lit_weight).zip(evidence.segment) {
        if *weight > 0.0 && f.is_finite() {
            colors[*segment as usize].push(f64::from(f.element_sum() / 3.0));
        }
    }
    colors.into_iter().map(|values| DARK_FLOOR * median(values).unwrap_or(0.0)).collect()
}

fn is_significant(gain: &SampleMean) -> bool {
    gain.mean > SIGNIFICANT * gain.error && gain.mean > LEAST_GAIN
}

/// A block that was left out, with the sum of its relative errors and its vertices.
type Block = (u32, f64, f64);

fn mean(blocks: &[Block]) -> f64 {
    let (sum, count) = blocks.iter().fold((0.0, 0.0), |(s, n), b| (s + b.1, n + b.2));
    sum / f64::max(count, 1.0)
}

/// What light and segments' albedo leave unexplained of the vertices that were left out.
fn left_out(evidence: &Colors, floors: &[f64], albedo: &[[f64; 3]], irradiance: &[Vec3]) -> Vec<Block> {
    let errors: Vec<Option<(u32, f64)>> = (0..evidence.lit_color.len())
        .into_par_iter()
        .map(|i| {
            let block = robust_solver::held_out_block(i as u32)?;
            let f = evidence.lit_color[i];
            if evidence.lit_weight[i] <= 0.0 || !f.is_finite() || f.max_element() <= 0.0 {
                return None;
            }
            let segment = evidence.segment[i] as usize;
            let size = (f64::from(f.element_sum()) / 3.0).max(floors[segment]);
            let off = |c: usize| (f64::from(f[c]) - albedo[segment][c] * f64::from(irradiance[i][c])).abs();
            Some((block, ((off(0) + off(1) + off(2)) / (3.0 * size)).min(CAPPED)))
        })
        .collect();
    let mut blocks: Vec<Block> = Vec::new();
    for (block, error) in errors.into_iter().flatten() {
        match blocks.last_mut() {
            Some(last) if last.0 == block => {
                last.1 += error;
                last.2 += 1.0;
            }
            _ => blocks.push((block, error, 1.0)),
        }
    }
    blocks
}

/// One number of bands, and how well it predicts what was left out.
struct Level {
    bands: usize,
    blocks: Vec<Block>,
    condition: f64,
    solution: Solution,
}

impl Level {
    /// Goes on from `fewer` bands where those are enough to choose the pull by.
    fn new(observed: &Observed, evidence: &Colors, floors: &[f64], bands: usize, fewer: Option<&Self>) -> Self {
        let start = fewer.filter(|f| f.bands >= robust_solver::PULL_BANDS).map(|f| &f.solution);
        let solution = robust_solver::solve(observed, bands, start);
        let irradiance = observed.transfer.irradiance(&solution.light);
        let blocks = left_out(evidence, floors, &solution.albedo, &irradiance);
        Self { bands, blocks, condition: solution.condition, solution }
    }

    fn error(&self) -> f64 {
        mean(&self.blocks)
    }

    /// How much lower the error is than with `other`, over the same blocks.
    fn gain_over(&self, other: &Self) -> SampleMean {
        let gains: Vec<f64> = self.blocks.iter().zip(&other.blocks).map(|(a, b)| (b.1 - a.1) / a.2).collect();
        SampleMean::of(&gains)
    }
}
