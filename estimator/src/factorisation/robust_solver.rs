//! Default solver (Eqs. 9–12): non-negative radiance over a few hundred directions and one albedo per segment, found together
//! with robust relative weights.

use crate::factorisation::joint_solution::{EXACT, FIRST_REGULARISATION, JointSolution, ROUGH};
use crate::factorisation::light_form::Prior;
use crate::factorisation::posterior::posterior;
use crate::factorisation::problem::{Observed, counted};
use crate::factorisation::projection::Projection;
use crate::factorisation::scale::brightest_large;
use crate::factorisation::solution::{DIRECTIONS, Solution, zip3};
use crate::factorisation::statistics::{Folds, Sample, Statistics, samples, statistics};
use crate::numerics::robust::{median, robust_sigma};
use firmware_config::tuning::FactorisationTuning;
use nalgebra::DVector;
use rayon::prelude::*;

/// Rounds of reweighting.
const REWEIGHTINGS: usize = 3;
/// Smallest size of a lit colour that errors are relative to, as a share of the channel's median.
const MIN_SIZE: f64 = 1e-3;
/// Weight of what is clipped: it tells nothing of light, but gives a segment that is clipped everywhere an albedo.
const CLIPPED: f64 = 1e-6;

/// Solves for light and segment albedos with at most the bands of the transfer. Continues `start`, if there is one, with its
/// regularisation weight.
#[must_use]
pub fn solve(observed: &Observed, bands: usize, start: Option<&Solution>, tuning: &FactorisationTuning) -> Solution {
    let samples = samples(observed, tuning);
    let projection = Projection::of(observed.transfer, bands);
    let k = projection.coefficients();
    let channels: Vec<ChannelSolution> = [0, 1, 2]
        .into_par_iter()
        .map(|channel| Channel::new(observed, &samples, channel, tuning).solve(&projection, start))
        .collect();
    Solution {
        light: zip3(k, &|c, i| channels[c].light[i]),
        standard_deviation: zip3(k, &|c, i| channels[c].standard_deviation[i]),
        radiance: zip3(projection.directions(), &|c, i| channels[c].state.radiance[i]),
        albedo: zip3(observed.segments, &|c, i| channels[c].state.albedo[i]),
        held_out: libm::sqrt(channels.iter().map(|c| c.held_out).sum::<f64>() / 3.0),
        regularisation: [0, 1, 2].map(|c| channels[c].regularisation),
        condition: channels.iter().map(|c| c.condition).fold(0.0, f64::max),
    }
}

struct ChannelSolution {
    state: JointSolution,
    light: DVector<f64>,
    standard_deviation: Vec<f64>,
    held_out: f64,
    regularisation: f64,
    condition: f64,
}

/// The problem of one channel.
pub(super) struct Channel<'a> {
    observed: &'a Observed<'a>,
    samples: &'a [Sample],
    channel: usize,
    /// Median lit colour: `[segment]`.
    medians: Vec<f64>,
    /// Median lit colour of all samples, positive.
    median: f64,
    tuning: &'a FactorisationTuning,
}

impl<'a> Channel<'a> {
    pub fn new(observed: &'a Observed, samples: &'a [Sample], channel: usize, tuning: &'a FactorisationTuning) -> Self {
        let color = |s: &Sample| f64::from(observed.lit_color[s.vertex as usize][channel]);
        let mut medians = vec![0.0; observed.segments];
        for group in samples.chunk_by(|a, b| a.segment == b.segment) {
            medians[group[0].segment as usize] = median(group.iter().map(color)).unwrap_or(0.0);
        }
        // A channel that is dark everywhere is measured against the others, not against its own noise.
        let brightest = |s: &Sample| f64::from(observed.lit_color[s.vertex as usize].max_element());
        let least = tuning.dark_channel * median(samples.iter().map(brightest)).unwrap_or(0.0);
        let median = median(samples.iter().map(color)).unwrap_or(0.0).max(least).max(1e-30);
        Self { observed, samples, channel, medians, median, tuning }
    }

    fn solve(&self, projection: &Projection, start: Option<&Solution>) -> ChannelSolution {
        let tuning = self.tuning;
        let mut state = start.map_or_else(|| self.uniform(), |s| self.state_of(s));
        // No sun yet, where the start has none.
        state.radiance = state.radiance.resize_vertically(projection.directions(), 0.0);
        let mut regularisation = start.map_or(FIRST_REGULARISATION, |s| self.regularisation(s));
        // A start tells outliers already, unless it knows nothing of a sun.
        let is_told = start.is_some_and(|s| s.radiance.len() == projection.directions());
        let mut weights = if is_told {
            self.robust_weights(&self.predict(&state, projection), &state.albedo)
        } else {
            let colors: Vec<f64> = self.samples.iter().map(|s| self.color(s)).collect();
            self.weights(&colors, &state.albedo)
        };
        for _ in 1 + usize::from(is_told)..REWEIGHTINGS {
            let fitted = self.fitted(&weights, projection);
            state.run(&fitted, projection, &Prior::uniform(regularisation), ROUGH, tuning);
            weights = self.robust_weights(&self.predict(&state, projection), &state.albedo);
        }
        let folds = self.folds(&weights, projection);
        if start.is_none() {
            regularisation = state.choose(&folds, projection, tuning);
        }
        state.run(&folds.fitted, projection, &Prior::uniform(regularisation), EXACT, tuning);
        let held_out = state.relative_square_error(&folds.held_out, projection);
        let (condition, standard_deviation) = posterior(&folds, projection, &state, regularisation, tuning);
        let light = state.light(projection);
        ChannelSolution { state, light, standard_deviation, held_out, regularisation, condition }
    }

    /// Uniform light, and albedos in proportion to the lit colours.
    fn uniform(&self) -> JointSolution {
        JointSolution {
            radiance: DVector::from_element(DIRECTIONS, 1.0),
            albedo: self.medians.iter().map(|m| m.max(1e-6 * self.median) / self.median * 0.5).collect(),
        }
    }

    /// Light and albedos of a solution.
    pub fn state_of(&self, solution: &Solution) -> JointSolution {
        JointSolution {
            radiance: DVector::from_iterator(
                solution.radiance.len(),
                solution.radiance.iter().map(|r| r[self.channel]),
            ),
            albedo: solution.albedo.iter().map(|a| a[self.channel]).collect(),
        }
    }

    /// The regularisation weight of a solution.
    pub fn regularisation(&self, solution: &Solution) -> f64 {
        solution.regularisation[self.channel]
    }

    /// Statistics of the samples that are fitted, `[segment]`, with these weights: `[sample]`.
    fn fitted(&self, weights: &[f64], projection: &Projection) -> Vec<Statistics> {
        statistics(self.observed, self.samples, weights, projection.coefficients(), self.channel, false)
    }

    /// Statistics with these weights: `[sample]`.
    pub fn folds(&self, weights: &[f64], projection: &Projection) -> Folds {
        Folds::accumulate(self.observed, self.samples, weights, projection.coefficients(), self.channel)
    }

    fn color(&self, s: &Sample) -> f64 {
        f64::from(self.observed.lit_color[s.vertex as usize][self.channel])
    }

    /// The lit colour that errors of a sample are relative to.
    fn size(&self, s: &Sample, predicted: f64) -> f64 {
        let dark = self.tuning.dark_floor * self.medians[s.segment as usize];
        predicted.max(dark).max(MIN_SIZE * self.median)
    }

    /// a_u E_i of the samples: `[sample]`.
    pub fn predict(&self, state: &JointSolution, projection: &Projection) -> Vec<f64> {
        let light = state.light(projection);
        let mut row = vec![0.0; light.len()];
        let predict = |s: &Sample| {
            self.observed.transfer.row(s.vertex as usize, self.channel, &mut row);
            let e: f64 = row.iter().zip(light.iter()).map(|(t, l)| t * l).sum();
            state.albedo[s.segment as usize] * e.max(0.0)
        };
        self.samples.iter().map(predict).collect()
    }

    /// Weights of squared residuals, `[sample]`: a lit colour has an error in proportion to itself, and one of undetected
    /// gloss in proportion to its light. What is clipped hardly counts: it is brighter than it shows, by how much is not known,
    /// and gloss may be why. `albedo` is `[segment]`.
    fn weights(&self, predicted: &[f64], albedo: &[f64]) -> Vec<f64> {
        let gloss = self.gloss_variance(albedo);
        let weight = |(s, predicted): (&Sample, &f64)| {
            let vertex = s.vertex as usize;
            let vertex_weight = f64::from(self.observed.transfer.traced.vertex_weight[vertex]);
            let known = if self.observed.clipped[vertex] { CLIPPED } else { 1.0 };
            let seen = counted(self.observed.lit_weight, self.observed.reliability, vertex) * vertex_weight * known;
            let size = self.size(s, *predicted);
            s.count * seen / (size * size * (1.0 + gloss[s.segment as usize]))
        };
        self.samples.iter().zip(predicted).map(weight).collect()
    }

    /// The same times Huber's weight.
    pub fn robust_weights(&self, predicted: &[f64], albedo: &[f64]) -> Vec<f64> {
        let residual = |(s, p): (&Sample, &f64)| ((self.color(s) - p) / self.size(s, *p)).abs();
        let residuals: Vec<f64> = self.samples.iter().zip(predicted).map(residual).collect();
        let clipped = |s: &Sample| self.observed.clipped[s.vertex as usize];
        let exact = self.samples.iter().zip(&residuals).filter(|(s, _)| !clipped(s)).map(|(_, r)| *r);
        let bound = self.tuning.huber * (robust_sigma(exact) + 1e-9);
        let weights = self.weights(predicted, albedo).into_iter().zip(&residuals);
        weights.map(|(w, r)| w * (bound / r.max(bound))).collect()
    }

    /// Variance of undetected gloss, `[segment]`, in units of the variance of a lit colour's relative error. Gloss is the same
    /// in all channels, so it is relatively large where the albedo is small. Beside a sun, what is in its shadow has a small albedo until
    /// its power is known, which it would then never be.
    fn gloss_variance(&self, albedo: &[f64]) -> Vec<f64> {
        if self.observed.transfer.traced.sun.is_some() {
            return vec![0.0; albedo.len()];
        }
        let mut seen = vec![0.0; albedo.len()];
        self.samples.iter().for_each(|s| seen[s.segment as usize] += s.count);
        let brightest = brightest_large(albedo, &seen, self.tuning);
        let relative = |a: &f64| self.tuning.undetected_gloss * brightest / a.max(1e-6 * brightest);
        albedo.iter().map(|a| relative(a).powi(2).min(1e6)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::factorisation::directions;
    use crate::transfer::{self, Transfer};
    use glam::Vec3;
    use recordings::types::Mesh;
    use std::sync::Arc;

    /// A ball of which three fifths of the vertices are white and clipped at twice what they show at the equator; the rest is
    /// dark, but for a tenth that is clipped everywhere. Irradiance at its top over that at its bottom, of which the truth is
    /// 9, and the albedo of what is clipped everywhere over that of the white. Colours are multiplied by `scale`.
    fn clipped_ball(says_so: bool, scale: f32) -> (f64, f64) {
        let normals: Vec<Vec3> = directions().iter().map(|d| d.as_vec3().normalize()).collect();
        let (top, bottom) = (normals.len(), normals.len() + 1);
        let normals: Vec<Vec3> = normals.into_iter().chain([Vec3::Z, Vec3::NEG_Z]).collect();
        let mesh = Mesh { positions: normals.clone(), normals: normals.clone(), ..Mesh::default() };
        let transfer = Transfer { traced: Arc::new(transfer::unoccluded(&mesh, 2)), bounced: None };
        let segment_of = |i: usize| if i % 10 == 9 { 2 } else { u32::from(i % 5 < 3) };
        let segment: Vec<u32> = (0..normals.len()).map(segment_of).collect();
        let light = normals.iter().map(|n| 0.5 + 0.4 * n.z);
        let most = 0.8 * 0.6;
        let shown = |(s, e): (&u32, f32)| match s {
            0 => (0.1 * e, false),
            1 => ((0.8 * e).min(most), 0.8 * e > most),
            _ => (most, true),
        };
        let (lit, clipped): (Vec<f32>, Vec<bool>) = segment.iter().zip(light).map(shown).unzip();
        let lit_color: Vec<Vec3> = lit.into_iter().map(|f| Vec3::splat(scale * f)).collect();
        let clipped: Vec<bool> = clipped.into_iter().map(|c| c && says_so).collect();
        let observed = Observed {
            transfer: &transfer,
            lit_color: &lit_color,
            lit_weight: &vec![1.0; normals.len()],
            reliability: &[],
            clipped: &clipped,
            segment: &segment,
            segments: 3,
        };
        let found = solve(&observed, 2, None, &FactorisationTuning::default());
        let irradiance = transfer.irradiance(&found.light);
        (f64::from(irradiance[top].y / irradiance[bottom].y), found.albedo[2][1] / found.albedo[1][1])
    }

    #[test]
    fn what_is_clipped_does_not_pass_for_dim_light() {
        let (told, untold) = (clipped_ball(true, 1.0).0, clipped_ball(false, 1.0).0);
        assert!((8.0..10.0).contains(&told), "{told}");
        assert!(9.0 - untold > 3.0 * (9.0 - told).abs(), "{untold}, {told}");
    }

    #[test]
    fn what_is_clipped_everywhere_has_an_albedo_all_the_same() {
        let of = |scale| clipped_ball(true, scale).1;
        let (dim, bright) = (of(0.01), of(100.0));
        assert!((0.6..6.0).contains(&dim), "colours from 0.53 to 4.8 times the light's, the white's are 0.8: {dim}");
        assert!((bright / dim - 1.0).abs() < 1e-3, "{dim} and {bright}");
    }
}
