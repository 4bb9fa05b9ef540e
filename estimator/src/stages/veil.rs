//! The share of veiling glare, by how well light and albedo explain what is left.

use crate::factorisation::{FactorisationOptions, Factorised, Observed, factorise, held_out, robust_solver};
use crate::numerics::robust::SampleMean;
use crate::stages::prepare::Prepared;
use firmware_config::tuning::FactorisationTuning;
use firmware_config::{EstimatorConfig, SolverChoice};
use glam::Vec3;
use rayon::prelude::*;
use recordings::decision::Decision;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Bands and vertices of the trials: shares differ in what is smooth.
const BANDS: usize = 5;
const SAMPLES: u32 = 4000;
/// Shares tried, of the largest that no dark thing contradicts.
const STEPS: [f64; 4] = [0.25, 0.5, 0.75, 1.0];
/// No lens scatters more.
const MOST: f64 = 0.08;
/// The error must fall by this share, and by more than a standard error.
const LEAST_GAIN: f64 = 0.03;
/// Relative errors count up to this.
const CAPPED: f32 = 0.3;

/// Takes veiling glare out of the colours where that explains them better, and factorises again. The share is at most what the
/// darkest observations hold.
pub fn remove_veil(
    prepared: &mut Prepared,
    found: Factorised,
    options: &FactorisationOptions,
    config: &EstimatorConfig,
) -> Factorised {
    if options.solver != SolverChoice::Robust || !config.tuning.factorisation.veil {
        return found;
    }
    let veil = prepared.fields.veil(&prepared.mesh);
    let most = veil.most.min(MOST);
    let tuning = FactorisationTuning { samples: SAMPLES, ..config.tuning.factorisation.clone() };
    let trial = |share: f64| {
        let lit: Vec<Vec3> = (prepared.fields.lit_color.iter().zip(&veil.of_vertex))
            .map(|(f, v)| crate::association::veil::without(*f, *v * share as f32))
            .collect();
        errors(prepared, &found, &lit, options.bands.min(BANDS), &tuning)
    };
    let without = trial(0.0);
    let tried: Vec<(f64, Vec<Block>)> = STEPS.iter().map(|s| (s * most, trial(s * most))).collect();
    let error = |blocks: &[Block]| {
        let (sum, count) = blocks.iter().fold((0.0, 0.0), |(s, n), b| (s + b.0, n + b.1));
        sum / f64::max(count, 1.0)
    };
    let best = tried.iter().min_by(|a, b| error(&a.1).total_cmp(&error(&b.1)));
    let chosen = best.filter(|(_, blocks)| {
        let gains: Vec<f64> = without.iter().zip(blocks).map(|(o, n)| (o.0 - n.0) / o.1).collect();
        let gain = SampleMean::of(&gains);
        gain.mean > gain.error && error(blocks) < (1.0 - LEAST_GAIN) * error(&without)
    });
    let share = chosen.map_or(0.0, |c| c.0);
    let held_out = std::iter::once((0.0, error(&without))).chain(tried.iter().map(|t| (t.0, error(&t.1)))).collect();
    prepared.decisions.push(Decision::Veil { share, most: veil.most, held_out });
    if share == 0.0 {
        return found;
    }
    prepared.fields.take_veil(&veil, share);
    factorise(Arc::clone(&found.transfer.traced), &prepared.colors(), options, Some(found.start()))
}

/// Sum of relative errors and number of vertices of a held-out block.
type Block = (f64, f64);

/// Errors of albedo × light against lit colours without veil, relative to those with it, by held-out blocks: what is taken away
/// must not make the rest look better explained.
fn errors(
    prepared: &Prepared,
    found: &Factorised,
    lit_color: &[Vec3],
    bands: usize,
    tuning: &FactorisationTuning,
) -> Vec<Block> {
    let colors = prepared.colors();
    let observed = Observed { lit_color, ..colors.under(&found.transfer) };
    let solution = robust_solver::solve(&observed, bands, Some(&found.solution), tuning);
    let irradiance = found.transfer.irradiance(&solution.light);
    let error = |i: usize| {
        let block = held_out::block(i as u32)?;
        let with = colors.lit_color[i];
        if colors.lit_weight[i] <= 0.0 || !with.is_finite() || with.min_element() <= 0.0 {
            return None;
        }
        let albedo = Vec3::from_array(solution.albedo[colors.segment[i] as usize].map(|a| a as f32));
        let off = (lit_color[i] - albedo * irradiance[i]).abs() / with;
        Some((block, f64::from(off.min(Vec3::splat(CAPPED)).element_sum() / 3.0)))
    };
    let errors: Vec<(u32, f64)> = (0..lit_color.len()).into_par_iter().filter_map(error).collect();
    let mut blocks: BTreeMap<u32, Block> = BTreeMap::new();
    for (block, error) in errors {
        let sum = blocks.entry(block).or_default();
        *sum = (sum.0 + error, sum.1 + 1.0);
    }
    blocks.into_values().collect()
}
