//! The share of veiling glare, by how well light and albedo explain what is left.

use crate::association::veil::without as without_veil;
use crate::factorisation::held_out::{BlockError, mean};
use crate::factorisation::{FactorisationOptions, Factorised, Observed, factorise, held_out, robust_solver};
use crate::stages::prepare::Prepared;
use firmware_config::tuning::FactorisationTuning;
use firmware_config::{EstimatorConfig, SolverChoice};
use glam::Vec3;
use rayon::prelude::*;
use recordings::decision::Decision;
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
            .map(|(f, v)| without_veil(*f, *v * share as f32))
            .collect();
        errors(prepared, &found, &lit, options.bands.min(BANDS), &tuning)
    };
    // Side by side: the three channels of one trial leave one of two threads without work.
    let shares: Vec<f64> = std::iter::once(0.0).chain(STEPS.map(|s| s * most)).collect();
    let mut tried: Vec<(f64, Vec<BlockError>)> = shares.into_par_iter().map(|share| (share, trial(share))).collect();
    let (_, without) = tried.remove(0);
    let best = tried.iter().min_by(|a, b| mean(&a.1).total_cmp(&mean(&b.1)));
    let chosen = best.filter(|(_, blocks)| {
        let gain = held_out::gain(blocks, &without);
        gain.mean > gain.error && mean(blocks) < (1.0 - LEAST_GAIN) * mean(&without)
    });
    let share = chosen.map_or(0.0, |c| c.0);
    let held_out = std::iter::once((0.0, mean(&without))).chain(tried.iter().map(|t| (t.0, mean(&t.1)))).collect();
    prepared.decisions.push(Decision::Veil { share, most: veil.most, held_out });
    if share == 0.0 {
        return found;
    }
    prepared.fields.take_veil(&veil, share);
    factorise(Arc::clone(&found.transfer.traced), &prepared.colors(), options, Some(found.start()))
}

/// Errors of albedo × light against lit colours without veil, relative to those with it, by held-out blocks: what is taken away
/// must not make the rest look better explained.
fn errors(
    prepared: &Prepared,
    found: &Factorised,
    lit_color: &[Vec3],
    bands: usize,
    tuning: &FactorisationTuning,
) -> Vec<BlockError> {
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
    held_out::by_block(errors)
}
