//! What is likely of the scale of the albedo: cameras balance white, and surfaces are neither all of one colour nor brighter
//! than white.
//!
//! With x the logarithm of the albedo's factor, e the median log irradiance, a the mean log albedo (outliers bounded), a_u that
//! of segment u, all per channel, P x = x less the mean of its channels, and q(x) a high quantile of the albedo's luminance:
//!
//! ```text
//! (S1) min_x  |P(x − e)|²/σ_e² + |P(x + a)|²/σ_a² + Σ_u w_u ρ(|P(x + a_u)|/σ_w) + (log q(x) − log q₀)²/σ_q² + Σ_c x_c²/σ_c²
//! ```
//!
//! Cameras balance white, so irradiance is neutral on the whole; so are surfaces, if less so; a bright segment that is nearly
//! white is white (ρ(r) = r²/(1+r²): what is not nearly white says nothing; w_u grows with the segment's luminance). σ_c is the
//! deviation of the scale that secondary light fixes (N5), where it does.

use crate::factorisation::albedo::Detail;
use crate::factorisation::problem::Colors;
use crate::factorisation::solution::Solution;
use crate::numerics::channels;
use crate::numerics::cielab::luminance_f64;
use crate::numerics::robust::{quantile, weighted_median};
use firmware_config::tuning::FactorisationTuning;
use glam::{DVec3, Vec3};
use nalgebra::{Matrix3, Vector3};
use recordings::decision::{Decision, ScaleBasis};

/// Rounds of (S1), whose weights and quantile depend on x.
const ROUNDS: usize = 20;
/// Vertices that (S1) looks at.
const SAMPLES: usize = 10_000;
/// A log albedo counts as no further from the median chroma than this.
const MAX_CHROMA: f64 = 1.0;
/// Least deviation of a scale: colours and form factors err together.
const MIN_DEVIATION: f64 = 0.05;
/// A segment counts as white from this share of the brightest luminance.
const BRIGHT: f64 = 0.5;

/// Seen vertices and segments before the scale is fixed.
pub(super) struct Surface {
    /// Log albedo: `[sample]`.
    albedo: Vec<[f64; 3]>,
    /// Chroma of the median log irradiance.
    irradiance: [f64; 3],
    /// Mean chroma of the log albedo.
    mean_albedo: [f64; 3],
    /// Log albedo of the segments, and their share of the sum of confidence.
    segments: Vec<([f64; 3], f64)>,
    /// Seen vertices.
    seen: usize,
}

impl Surface {
    /// What (S1) looks at, under a scale that is not fixed yet.
    pub(super) fn sampled(solution: &Solution, detail: &Detail, irradiance: &[Vec3], colors: &Colors) -> Self {
        let log = |v: Vec3| v.to_array().map(|x| libm::log(f64::from(x)));
        let seen: Vec<usize> = (0..irradiance.len())
            .filter(|&i| detail.confidence[i] > 0.0 && log(detail.albedo[i]).iter().all(|x| x.is_finite()))
            .collect();
        let sampled: Vec<usize> = seen.iter().copied().step_by(seen.len().div_ceil(SAMPLES).max(1)).collect();
        let weight: Vec<f64> = sampled.iter().map(|&i| f64::from(detail.confidence[i])).collect();
        let albedo: Vec<[f64; 3]> = sampled.iter().map(|&i| log(detail.albedo[i])).collect();
        let total = weight.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        let median_light = |c: usize| {
            let values = sampled.iter().zip(&weight).map(|(i, w)| (log(irradiance[*i])[c], *w));
            weighted_median(&mut values.collect::<Vec<_>>()).unwrap_or(0.0)
        };
        let tint: Vec<[f64; 3]> = albedo.iter().map(chroma).collect();
        let mean = |c: usize| {
            let values = || tint.iter().zip(&weight).map(|(t, w)| (t[c], *w));
            let middle = weighted_median(&mut values().collect::<Vec<_>>()).unwrap_or(0.0);
            middle + values().map(|(t, w)| (t - middle).clamp(-MAX_CHROMA, MAX_CHROMA) * w).sum::<f64>() / total
        };
        let mut shares = vec![0.0; colors.segments];
        for (i, w) in sampled.iter().zip(&weight) {
            shares[colors.segment[*i] as usize] += w / total;
        }
        let logs = solution.albedo.iter().map(|a| a.map(libm::log)).zip(shares);
        let segments = logs.filter(|(a, share)| *share > 0.0 && a.iter().all(|x| x.is_finite())).collect();
        let (irradiance, mean_albedo) = ([0, 1, 2].map(median_light), [0, 1, 2].map(mean));
        let (irradiance, mean_albedo) = (chroma(&irradiance), chroma(&mean_albedo));
        Self { irradiance, mean_albedo, albedo, segments, seen: seen.len() }
    }

    /// Log of the high quantile of the albedo's luminance under a log factor; `None` where nothing was seen.
    fn brightest(&self, log_factor: &[f64; 3], tuning: &FactorisationTuning) -> Option<f64> {
        quantile(self.albedo.iter().map(|a| luminance_of(a, log_factor)), tuning.scale_quantile).map(libm::log)
    }

    /// Solves (S1): the log factor, and what fixed it. `deviation` is that of the scale as it is.
    pub(super) fn likely(&self, deviation: [f64; 3], tuning: &FactorisationTuning) -> ([f64; 3], ScaleBasis) {
        let per = |sigma: f64| 1.0 / (sigma * sigma);
        let (light, surface) = (per(tuning.scale_light_sigma), per(tuning.scale_albedo_sigma));
        let (white, bright) = (per(tuning.scale_white_sigma), per(tuning.scale_bright_sigma));
        let own = deviation.map(|s| if s.is_finite() { per(s.max(MIN_DEVIATION)) } else { 0.0 });
        let neutral = [0, 1, 2].map(|c| light * self.irradiance[c] - surface * self.mean_albedo[c]);
        // The weights of the first round do not depend on the factor that was left in.
        let mut x = neutral.map(|n| n / (light + surface));
        for _ in 0..ROUNDS {
            let Some(brightest) = self.brightest(&x, tuning) else { return ([0.0; 3], ScaleBasis::Likely) };
            let (mut pull, mut weight) = (neutral, light + surface);
            for (albedo, evidence) in self.whites(&x, brightest, tuning) {
                (0..3).for_each(|c| pull[c] -= white * evidence * albedo[c]);
                weight += white * evidence;
            }
            // P is the identity less the mean of the channels; the quantile moves with the mean of x.
            let wanted = libm::log(tuning.scale_albedo) - brightest + x.iter().sum::<f64>() / 3.0;
            let matrix = Matrix3::from_fn(|i, j| {
                let diagonal = if i == j { weight + own[i] } else { 0.0 };
                diagonal + (bright / 3.0 - weight) / 3.0
            });
            let right = Vector3::from_fn(|c, _| pull[c] + bright * wanted / 3.0);
            let Some(solved) = matrix.cholesky().map(|m| m.solve(&right)) else { break };
            x = solved.into();
        }
        // Most albedos stay plausible whatever the evidence.
        let over = self.brightest(&x, tuning).map_or(0.0, |b| (b - libm::log(tuning.scale_max_albedo)).max(0.0));
        let observed = own.iter().sum::<f64>() / 3.0 > bright;
        (x.map(|x| x - over), if observed { ScaleBasis::SecondaryLight } else { ScaleBasis::Likely })
    }

    /// Chroma of the segments, and how far each counts as white: 0 to 1.
    fn whites<'a>(
        &'a self,
        log_factor: &'a [f64; 3],
        brightest: f64,
        tuning: &'a FactorisationTuning,
    ) -> impl Iterator<Item = ([f64; 3], f64)> + 'a {
        self.segments.iter().map(move |(albedo, share)| {
            let relative = luminance_of(albedo, log_factor) / libm::exp(brightest);
            let bright = ((relative - BRIGHT) / (1.0 - BRIGHT)).clamp(0.0, 1.0);
            let scaled = chroma(&[0, 1, 2].map(|c| albedo[c] + log_factor[c]));
            let off = scaled.iter().map(|x| x * x).sum::<f64>() / (tuning.scale_white_sigma * tuning.scale_white_sigma);
            let large = (share / tuning.scale_min_share.max(1e-9)).min(1.0);
            (chroma(albedo), large * bright / ((1.0 + off) * (1.0 + off)))
        })
    }

    /// The evidence, and what fixed the scale.
    pub(super) fn decision(&self, factor: DVec3, chosen: ScaleBasis, tuning: &FactorisationTuning) -> Decision {
        let x = factor.to_array().map(libm::log);
        let color = |log: [f64; 3]| chroma(&log).map(libm::exp);
        let brightest = self.brightest(&x, tuning);
        let whites = self.segments.iter().zip(self.whites(&x, brightest.unwrap_or(0.0), tuning));
        Decision::AlbedoScale {
            chosen,
            irradiance_color: color([0, 1, 2].map(|c| self.irradiance[c] - x[c])),
            albedo_color: color([0, 1, 2].map(|c| self.mean_albedo[c] + x[c])),
            near_white: whites.filter(|(_, (_, evidence))| *evidence > 0.0).map(|((_, share), (_, e))| share * e).sum(),
            quantile: tuning.scale_quantile,
            brightest: brightest.map_or(0.0, libm::exp),
            vertices: self.seen as u32,
        }
    }
}

/// A logarithm less the mean of its channels.
fn chroma(log: &[f64; 3]) -> [f64; 3] {
    let mean = channels::mean(log);
    log.map(|x| x - mean)
}

fn luminance_of(log_albedo: &[f64; 3], log_factor: &[f64; 3]) -> f64 {
    luminance_f64(&std::array::from_fn(|c| libm::exp(log_albedo[c] + log_factor[c])))
}
