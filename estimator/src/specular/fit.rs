//! Specular weights of every segment (Eq. 13).

use crate::association::Association;
use crate::numerics::robust::{median, robust_sigma};
use crate::specular::agreement::borne_out;
use crate::specular::gloss::{Gloss, LOBES};
use crate::specular::mirror_rays::MirrorRays;
use crate::specular::observations::{MirrorObservation, MirrorObservations, mirror_medians};
use crate::specular::reflection::Reflection;
use firmware_config::tuning::SpecularTuning;
use nalgebra::{Matrix4, Vector4};
use rayon::prelude::*;

/// Rounds of reweighting.
const ROUNDS: usize = 5;
/// Share of 1 that the determinant of Eq. (13) must reach; below, f and f_s are collinear and w_s is 0.
const NEARLY_COLLINEAR: f64 = 1e-3;

/// An observation, and the medians of f_s over the views of its vertex for every lobe.
type Centred = (MirrorObservation, [[f64; 3]; LOBES.len()]);

/// One channel of one observation, all colours divided by its error.
#[derive(Debug, Clone, Copy)]
struct Sample {
    /// e_j f~_ij.
    seen: f64,
    /// f_i.
    lit: f64,
    /// E_i.
    irradiance: f64,
    channel: usize,
    keyframe: usize,
    /// f_s for every lobe.
    mirror: [f64; LOBES.len()],
    /// The same minus its median over the vertex's views.
    change: [f64; LOBES.len()],
}

/// Fits every segment; `segment` is `[vertex]`, the result `[segment]`.
#[must_use]
pub(super) fn fit(
    reflection: &Reflection,
    rays: &MirrorRays,
    association: &Association,
    segment: &[u32],
    segments: usize,
    tuning: &SpecularTuning,
) -> Vec<Gloss> {
    let observations = MirrorObservations::new(reflection, rays, association, tuning.min_views);
    let views = |i: usize| (association.offsets[i + 1] - association.offsets[i]) as usize;
    let mut of_segment: Vec<Vec<usize>> = vec![Vec::new(); segments];
    for (i, s) in segment.iter().enumerate() {
        if views(i) >= tuning.min_views as usize && association.lit_weight[i] > 0.0 {
            of_segment[*s as usize].push(i);
        }
    }
    of_segment
        .into_par_iter()
        .map(|vertices| {
            let total: usize = vertices.iter().map(|&i| views(i)).sum();
            let stride = total.div_ceil(tuning.max_observations as usize).max(1);
            let chosen: Vec<usize> = vertices.into_iter().step_by(stride).collect();
            let with_medians = |&i: &usize| {
                let views = observations.of(i, false);
                let medians = mirror_medians(&views);
                views.into_iter().map(move |o| (o, medians))
            };
            let found: Vec<Centred> = chosen.par_iter().flat_map_iter(with_medians).collect();
            let fitted = SegmentFit::new(&found, tuning).map_or(Gloss::NONE, |fit| fit.gloss());
            if !fitted.significant {
                return fitted;
            }
            // What a mirrored surface shows is gloss like the rest.
            let views: Vec<Vec<MirrorObservation>> = chosen.par_iter().map(|&i| observations.of(i, true)).collect();
            borne_out(&views, fitted, tuning.min_significance)
        })
        .collect()
}

/// The fit of one segment.
struct SegmentFit<'a> {
    samples: Vec<Sample>,
    /// Robust standard deviation of seen − lit.
    spread: f64,
    tuning: &'a SpecularTuning,
}

impl<'a> SegmentFit<'a> {
    /// `None` for a segment without light or observations.
    fn new(observations: &[Centred], tuning: &'a SpecularTuning) -> Option<Self> {
        // Errors of a picture grow with its brightness; all channels of a segment have equal weight.
        let size = median(observations.iter().map(|(o, _)| (o.lit[0] + o.lit[1] + o.lit[2]) / 3.0));
        let size = size.filter(|s| *s > 0.0)?;
        let sample = |(o, medians): &Centred, c: usize| {
            let scale = libm::sqrt(o.weight.max(1e-3)) / (o.lit[c] + tuning.dark_floor * size);
            Sample {
                seen: o.seen[c] * scale,
                lit: o.lit[c] * scale,
                irradiance: o.irradiance[c] * scale,
                channel: c,
                keyframe: o.keyframe,
                mirror: o.mirror.map(|m| m[c] * scale),
                change: std::array::from_fn(|lobe| (o.mirror[lobe][c] - medians[lobe][c]) * scale),
            }
        };
        let samples: Vec<Sample> = observations.iter().flat_map(|o| [0, 1, 2].map(|c| sample(o, c))).collect();
        let spread = robust_sigma(samples.iter().map(|s| (s.seen - s.lit).abs())) + 1e-9;
        Some(Self { samples, spread, tuning })
    }

    /// The lobe and weight that explain the changes between views best; the level of the colours may raise the weight.
    fn gloss(&self) -> Gloss {
        let by_changes = |lobe: usize| {
            let (weight, error) = self.change_weight(lobe)?;
            // The loss has the same unit for every lobe.
            let residual = |s: &Sample| (s.seen - s.lit - weight.max(0.0) * s.change[lobe]).abs();
            let loss: f64 = self.samples.iter().map(|s| self.huber(residual(s) / self.spread)).sum();
            let significant = weight > self.tuning.min_significance * error;
            Some((loss, Gloss { error, significant, lobe, lobe_weight: weight.max(0.0), ..Gloss::NONE }))
        };
        let tried: Vec<Option<(f64, Gloss)>> = (0..LOBES.len()).into_par_iter().map(by_changes).collect();
        let best = tried.into_iter().flatten().reduce(|best, next| if next.0 < best.0 { next } else { best });
        let Some((_, mut gloss)) = best else { return Gloss::NONE };
        if gloss.significant {
            let mut least = f64::INFINITY;
            let by_change = gloss.lobe_weight;
            let levels: Vec<_> = (0..LOBES.len()).into_par_iter().map(|lobe| self.level_weight(lobe)).collect();
            for (lobe, level) in levels.into_iter().enumerate() {
                let Some((level, error, loss)) = level else { continue };
                if loss < least && level > by_change + self.tuning.min_significance * error {
                    least = loss;
                    gloss.lobe = lobe;
                    gloss.lobe_weight = level.min(self.tuning.max_level_ratio * by_change);
                }
            }
        }
        if gloss.lobe_weight > self.tuning.max_weight {
            return Gloss { error: gloss.error, ..Gloss::NONE };
        }
        let (w_d, w_s) = mirror_weights(&self.samples, &gloss);
        Gloss { w_d, w_s, ..gloss }
    }

    /// Huber's loss of a residual in standard deviations.
    fn huber(&self, residual: f64) -> f64 {
        let r = residual / self.tuning.huber;
        if r < 1.0 { r * r } else { 2.0 * r - 1.0 }
    }

    /// Huber's weights for these residuals, `[sample]`, and their robust standard deviation.
    fn reweighted(&self, residual: impl Fn(&Sample) -> f64) -> (Vec<f64>, f64) {
        let mut weights: Vec<f64> = self.samples.iter().map(residual).collect();
        let sigma = robust_sigma(weights.iter().copied()) + 1e-9;
        let bound = self.tuning.huber * sigma;
        weights.iter_mut().for_each(|w| *w = bound / w.max(bound));
        (weights, sigma)
    }

    /// Robust weight of a lobe from the changes between views, with its standard error.
    fn change_weight(&self, lobe: usize) -> Option<(f64, f64)> {
        let mut robust = vec![1.0; self.samples.len()];
        let (mut weight, mut error) = (0.0, f64::INFINITY);
        for _ in 0..ROUNDS {
            let (square, cross) = self.samples.iter().zip(&robust).fold((0.0, 0.0), |(square, cross), (s, robust)| {
                let change = s.change[lobe];
                (square + robust * change * change, cross + robust * change * (s.seen - s.lit))
            });
            if square <= 0.0 {
                return None;
            }
            weight = cross / square;
            let sigma;
            (robust, sigma) = self.reweighted(|s| (s.seen - s.lit - weight.max(0.0) * s.change[lobe]).abs());
            error = sigma * libm::sqrt(self.tuning.correlated_observations / square);
        }
        Some((weight, error.max(self.jackknife(lobe, &robust))))
    }

    /// Standard error of the weight of a lobe by leaving out one keyframe at a time (Efron, Stein 1981): an error of a whole
    /// picture, as of its exposure or its pose, is one error however many vertices show it. Huber's weights are kept.
    fn jackknife(&self, lobe: usize, robust: &[f64]) -> f64 {
        let keyframes = self.samples.iter().map(|s| s.keyframe + 1).max().unwrap_or(0);
        let mut sums = vec![(0.0, 0.0); keyframes];
        for (s, robust) in self.samples.iter().zip(robust) {
            let change = s.change[lobe];
            sums[s.keyframe].0 += robust * change * change;
            sums[s.keyframe].1 += robust * change * (s.seen - s.lit);
        }
        let (square, cross) = sums.iter().fold((0.0, 0.0), |a, s| (a.0 + s.0, a.1 + s.1));
        let without = sums.iter().filter(|s| s.0 > 0.0).map(|s| (cross - s.1) / (square - s.0));
        let without: Vec<f64> = without.collect();
        let (n, mean) = (without.len() as f64, without.iter().sum::<f64>() / without.len().max(1) as f64);
        let variance = (n - 1.0) / n * without.iter().map(|w| (w - mean) * (w - mean)).sum::<f64>();
        if variance.is_finite() { libm::sqrt(variance.max(0.0)) } else { f64::INFINITY }
    }

    /// Robust weight of a lobe from the level of the colours, e_j f~_ij = a_c E_i + w f_s,ij with one albedo per channel: weight,
    /// standard error, loss. Gloss that is equal in all views shows here only, best in dark channels. Light that was estimated
    /// too smooth makes the weight from the changes too small, but hardly affects the level.
    fn level_weight(&self, lobe: usize) -> Option<(f64, f64, f64)> {
        let mut robust = vec![1.0; self.samples.len()];
        let (mut weight, mut error, mut loss) = (0.0, f64::INFINITY, f64::INFINITY);
        for _ in 0..ROUNDS {
            let (mut normal, mut target) = (Matrix4::<f64>::zeros(), Vector4::<f64>::zeros());
            for (s, robust) in self.samples.iter().zip(&robust) {
                let (c, e, m) = (s.channel, s.irradiance, s.mirror[lobe]);
                normal[(c, c)] += robust * e * e;
                normal[(c, 3)] += robust * e * m;
                normal[(3, 3)] += robust * m * m;
                target[c] += robust * e * s.seen;
                target[3] += robust * m * s.seen;
            }
            for c in 0..3 {
                normal[(3, c)] = normal[(c, 3)];
            }
            let inverse = normal.try_inverse()?;
            let x = inverse * target;
            let residual = |s: &Sample| (s.seen - x[s.channel] * s.irradiance - x[3] * s.mirror[lobe]).abs();
            let sigma;
            (robust, sigma) = self.reweighted(residual);
            let variance = self.tuning.correlated_observations * inverse[(3, 3)].max(0.0);
            (weight, error) = (x[3], sigma * libm::sqrt(variance));
            let total = self.samples.iter().map(|s| self.huber(residual(s) / self.spread)).sum::<f64>();
            loss = total / self.samples.len() as f64;
        }
        Some((weight, error, loss))
    }
}

/// w_d and w_s of Eq. (13), both ≥ 0, for the colours that the lobe predicts. A mirror fitted to noisy colours under light that
/// was estimated too smooth gets too small a weight; the lobe's weight already combines level and change.
fn mirror_weights(samples: &[Sample], gloss: &Gloss) -> (f64, f64) {
    let (mut ff, mut fs, mut ss, mut fy, mut sy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for s in samples {
        let (mirror, seen) = (s.mirror[0], s.lit + gloss.lobe_weight * s.mirror[gloss.lobe]);
        ff += s.lit * s.lit;
        fs += s.lit * mirror;
        ss += mirror * mirror;
        fy += s.lit * seen;
        sy += mirror * seen;
    }
    let determinant = ff * ss - fs * fs;
    if ff <= 0.0 || determinant <= NEARLY_COLLINEAR * ff * ss {
        return (if ff > 0.0 { fy / ff } else { 1.0 }, 0.0);
    }
    let (w_d, w_s) = ((fy * ss - sy * fs) / determinant, (sy * ff - fy * fs) / determinant);
    if w_s < 0.0 {
        (fy / ff, 0.0)
    } else if w_d < 0.0 {
        (0.0, sy / ss)
    } else {
        (w_d, w_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grey segment of 3000 vertices in four pictures: what the mirror direction shows differs between the pictures by
    /// `MIRROR`, what is seen differs by `seen`.
    fn fitted(seen: [f64; 4]) -> Gloss {
        const MIRROR: [f64; 4] = [0.2, 0.1, -0.1, -0.2];
        let of = |vertex: u32, k: usize| {
            let noise = 0.005 * (f64::from(vertex * 7 % 11) - 5.0) / 5.0;
            let observation = MirrorObservation {
                seen: [0.5 + seen[k] + noise; 3],
                lit: [0.5; 3],
                irradiance: [1.0; 3],
                mirror: [[1.0 + MIRROR[k]; 3]; LOBES.len()],
                weight: 1.0,
                keyframe: k,
            };
            (observation, [[1.0; 3]; LOBES.len()])
        };
        let observations: Vec<Centred> = (0..3000).flat_map(|i| (0..4).map(move |k| of(i, k))).collect();
        SegmentFit::new(&observations, &SpecularTuning::default()).unwrap().gloss()
    }

    #[test]
    fn what_follows_the_mirror_is_gloss() {
        let gloss = fitted([0.02, 0.01, -0.01, -0.02]);
        assert!(gloss.significant && (gloss.lobe_weight - 0.1).abs() < 0.01, "{gloss:?}");
    }

    #[test]
    fn a_wrong_exposure_of_a_picture_is_no_gloss() {
        let gloss = fitted([0.02, 0.0, 0.0, 0.0]);
        assert!(!gloss.significant, "{gloss:?}");
    }
}
