//! The share of veiling glare, by how well light and albedo explain what is left.

use crate::association::veil::without as without_veil;
use crate::association::veil_removal::VeilOfAll;
use crate::factorisation::held_out::{BlockError, mean};
use crate::factorisation::{Colors, FactorisationOptions, Factorised, Observed, factorise, held_out, robust_solver};
use crate::numerics::robust::segment_medians;
use crate::stages::prepare::Prepared;
use firmware_config::EstimatorConfig;
use firmware_config::tuning::FactorisationTuning;
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
    if !config.tuning.factorisation.veil {
        return found;
    }
    let tuning = FactorisationTuning { samples: SAMPLES, ..config.tuning.factorisation.clone() };
    let (veil, share) = chosen(prepared, |lit_color| {
        let observed = Observed { lit_color, ..prepared.colors().under(&found.transfer) };
        let solution = robust_solver::solve(&observed, options.bands.min(BANDS), Some(&found.solution), &tuning);
        let irradiance = found.transfer.irradiance(&solution.light);
        errors(&prepared.colors(), lit_color, &solution.albedo, &irradiance)
    });
    prepared.decisions.push(share.decision(&veil));
    let share = share.chosen;
    if share == 0.0 {
        return found;
    }
    prepared.fields.take_veil(&veil, share);
    factorise(Arc::clone(&found.transfer.traced), &prepared.colors(), options, Some(found.start()))
}

/// Veiling glare, and the share of it without which light that is not distant explains the colours better: `irradiance` over π,
/// `[vertex]`. It stays as it is: how far it is off is told by what is bright, glare by what is dark.
pub(super) fn near_veil(prepared: &Prepared, irradiance: &[Vec3]) -> (VeilOfAll, Share) {
    let weights = prepared.fields.lit_weight.iter().zip(&prepared.fields.clipped);
    let lit_weight: Vec<f32> = weights.map(|(w, clipped)| if *clipped { 0.0 } else { *w }).collect();
    chosen(prepared, |lit_color| {
        let colors = Colors { lit_weight: &lit_weight, ..prepared.colors() };
        errors(&colors, lit_color, &median_albedo(&colors, lit_color, irradiance), irradiance)
    })
}

/// A share of the veil, and the held-out errors that it was chosen by.
pub(super) struct Share {
    /// The share; 0 if it is hardly better than none.
    pub chosen: f64,
    held_out: Vec<(f64, f64)>,
}

impl Share {
    /// As evidence.
    pub fn decision(&self, veil: &VeilOfAll) -> Decision {
        Decision::Veil { share: self.chosen, most: veil.most, held_out: self.held_out.clone() }
    }
}

/// The veil, and the share of it without which colours are explained best; 0 if that is hardly better. `errors` are those of held-out
/// vertices without a share, from lit colours `[vertex]`.
fn chosen(prepared: &Prepared, errors: impl Fn(&[Vec3]) -> Vec<BlockError> + Sync) -> (VeilOfAll, Share) {
    let veil = prepared.fields.veil(&prepared.mesh);
    let most = veil.most.min(MOST);
    let trial = |share: f64| {
        let vertices = prepared.fields.lit_color.iter().zip(&veil.of_vertex);
        errors(&vertices.map(|(f, v)| without_veil(*f, *v * share as f32)).collect::<Vec<Vec3>>())
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
    let chosen = chosen.map_or(0.0, |c| c.0);
    let held_out = std::iter::once((0.0, mean(&without))).chain(tried.iter().map(|t| (t.0, mean(&t.1)))).collect();
    (veil, Share { chosen, held_out })
}

/// Weighted median of lit colour over irradiance, of every segment's vertices that are not held out.
fn median_albedo(colors: &Colors, lit_color: &[Vec3], irradiance: &[Vec3]) -> Vec<[f64; 3]> {
    let ratio = |i: usize| {
        let (f, e, weight) = (lit_color[i], irradiance[i], colors.lit_weight[i]);
        let counts = held_out::block(i as u32).is_none() && weight > 0.0 && f.is_finite() && e.min_element() > 0.0;
        counts.then(|| (colors.segment[i], (f / e).to_array().map(f64::from), f64::from(weight)))
    };
    segment_medians(colors.segments, (0..lit_color.len()).filter_map(ratio))
}

/// Errors of albedo × light against lit colours without veil, relative to those with it, by held-out blocks: what is taken away
/// must not make the rest look better explained.
fn errors(colors: &Colors, lit_color: &[Vec3], albedo: &[[f64; 3]], irradiance: &[Vec3]) -> Vec<BlockError> {
    let error = |i: usize| {
        let block = held_out::block(i as u32)?;
        let with = colors.lit_color[i];
        if colors.lit_weight[i] <= 0.0 || !with.is_finite() || with.min_element() <= 0.0 {
            return None;
        }
        let albedo = Vec3::from_array(albedo[colors.segment[i] as usize].map(|a| a as f32));
        let off = (lit_color[i] - albedo * irradiance[i]).abs() / with;
        Some((block, f64::from(off.min(Vec3::splat(CAPPED)).element_sum() / 3.0)))
    };
    let errors: Vec<(u32, f64)> = (0..lit_color.len()).into_par_iter().filter_map(error).collect();
    held_out::by_block(errors)
}
