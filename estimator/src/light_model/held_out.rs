//! How well an irradiance explains the lit colours of surface that was held out.

use crate::factorisation::held_out::{BlockError, mean};
use crate::light_model::samples::{DARK_FLOOR, FOLDS, Samples};
use crate::numerics::robust::segment_medians;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// A richer model must lower the held-out error by this share, and by more than one standard error.
pub const LEAST_GAIN: f64 = 0.02;
/// Relative errors count up to this.
const CAPPED: f64 = 1.0;

/// Errors of the blocks that were held out.
pub type Blocks = Vec<BlockError>;

/// The new model's error is lower by more than one standard error and by more than [`LEAST_GAIN`].
#[must_use]
pub fn is_better(new: &Blocks, old: &Blocks) -> bool {
    let total: f64 = old.iter().map(|b| b.2).sum();
    let gain = mean(old) - mean(new);
    let variance: f64 = new.iter().zip(old).map(|(n, o)| ((o.1 - n.1 - gain * o.2) / total).powi(2)).sum();
    gain > libm::sqrt(variance) && gain > LEAST_GAIN * mean(old)
}

/// Relative errors of f = a E on the blocks that were held out, for an irradiance over π that is given at every sample. The albedo
/// of a segment is the median of f / E over its other samples, whatever the model: least squares would lose to it in prints.
pub fn errors(samples: &Samples, irradiance: impl Fn(usize) -> [f64; 3]) -> Blocks {
    let albedo = segment_albedo(samples, &irradiance);
    let mut sums = BTreeMap::<u32, (f64, f64)>::new();
    for n in 0..samples.len() {
        if let Some(block) = samples.held_out(n) {
            let error = relative_error(samples, n, &albedo[samples.segment[n] as usize], &irradiance(n));
            let sum = sums.entry(block).or_default();
            sum.0 += samples.weight[n] * error;
            sum.1 += samples.weight[n];
        }
    }
    sums.into_iter().map(|(block, (sum, weight))| (block, sum, weight)).collect()
}

/// What an answer leaves unexplained of surface that was held out from it.
pub struct CrossValidated {
    /// Sample by sample.
    pub blocks: Blocks,
    /// Of the means of patches.
    pub patches: Blocks,
}

/// Errors of all of the surface, each fold of its blocks held out from the irradiance over π, `[sample]`, that `of` makes of the rest.
pub fn cross_validated(samples: &Samples, of: impl Fn(&Samples) -> Vec<[f64; 3]> + Sync) -> CrossValidated {
    let of_fold = |fold: u32| {
        let samples = samples.in_fold(fold);
        let irradiance = of(&samples);
        let means = samples.patch_means(|n| irradiance[n]);
        (errors(&samples, |n| irradiance[n]), errors(&samples.patches(), |p| means[p]))
    };
    let folds: Vec<(Blocks, Blocks)> = (0..FOLDS).into_par_iter().map(of_fold).collect();
    let (blocks, patches): (Vec<Blocks>, Vec<Blocks>) = folds.into_iter().unzip();
    CrossValidated { blocks: blocks.concat(), patches: patches.concat() }
}

/// Weighted median of f / E over the samples of each segment that are not held out.
pub fn segment_albedo(samples: &Samples, irradiance: &impl Fn(usize) -> [f64; 3]) -> Vec<[f64; 3]> {
    let ratio = |n: usize| {
        let e = irradiance(n);
        let ratio = [0, 1, 2].map(|c| samples.color[n][c] / e[c].max(1e-30));
        (samples.segment[n], ratio, samples.weight[n])
    };
    segment_medians(samples.segments, samples.fitted().map(ratio))
}

/// |f − a E| relative to f, but not below a share of the segment's median; mean over the channels, capped.
fn relative_error(samples: &Samples, n: usize, albedo: &[f64; 3], irradiance: &[f64; 3]) -> f64 {
    let (f, medians) = (samples.color[n], samples.medians[samples.segment[n] as usize]);
    let size = (f.iter().sum::<f64>()).max(DARK_FLOOR * medians.iter().sum::<f64>()) / 3.0;
    let off = (0..3).map(|c| (f[c] - albedo[c] * irradiance[c]).abs()).sum::<f64>() / 3.0;
    (off / size.max(f64::MIN_POSITIVE)).min(CAPPED)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Forty patches of 25 samples in one segment, a chequered print on each; every fourth is held out. Light falls off from the first
    /// to the last.
    fn print() -> (Samples, impl Fn(usize) -> [f64; 3]) {
        let (patches, each) = (40, 25);
        let count = patches * each;
        let light = move |n: usize| [1.0 + (n / each) as f64 / patches as f64; 3];
        let paint = |n: usize| if n.is_multiple_of(2) { 0.2 } else { 0.6 };
        let samples = Samples {
            vertex: (0..count as u32).collect(),
            segment: vec![0; count],
            weight: vec![1.0; count],
            block: (0..count).map(|n| (n / each) as u32).map(|patch| FOLDS * patch + patch % 4).collect(),
            fold: 0,
            patch: (0..count).map(|n| (n / each) as u32).collect(),
            color: (0..count).map(|n| light(n).map(|e| paint(n) * e)).collect(),
            segments: 1,
            medians: vec![[0.4; 3]],
        };
        (samples, light)
    }

    #[test]
    fn means_of_patches_tell_what_a_print_hides() {
        let (samples, light) = print();
        let patches = samples.patches();
        let of = |irradiance: &dyn Fn(usize) -> [f64; 3]| {
            let means = samples.patch_means(irradiance);
            (mean(&errors(&samples, irradiance)), mean(&errors(&patches, |p| means[p])))
        };
        let (right, flat) = (of(&light), of(&|_| [1.0; 3]));
        assert!(right.0 > 0.8 * flat.0, "sample by sample the print is most of the error: {} and {}", right.0, flat.0);
        assert!(right.1 < 0.3 * flat.1, "{} and {}", right.1, flat.1);
    }

    #[test]
    fn every_sample_is_held_out_in_one_fold() {
        let (samples, light) = print();
        let held_out = (0..FOLDS).flat_map(|fold| errors(&samples.in_fold(fold), &light));
        let (blocks, weights): (Vec<u32>, Vec<f64>) = held_out.map(|(block, _, weight)| (block, weight)).unzip();
        assert_eq!(blocks.iter().collect::<std::collections::BTreeSet<_>>().len(), blocks.len(), "{blocks:?}");
        assert_eq!(weights.iter().sum::<f64>(), samples.len() as f64);
    }
}
