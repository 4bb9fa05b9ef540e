//! How well light, albedo and gloss predict the keyframes.

use crate::association::Association;
use crate::numerics::robust::SampleMean;
use crate::specular::gloss::Gloss;
use crate::specular::mirror_rays::MirrorRays;
use crate::specular::observations::MirrorObservations;
use crate::specular::reflection::Reflection;
use firmware_config::tuning::SpecularTuning;
use rayon::prelude::*;

/// Errors of the predicted keyframes at evenly strided vertices.
#[derive(Debug, Clone)]
pub struct Prediction {
    /// Sum of the relative errors of the views, each at most 1, and their number: `[vertex]`.
    vertices: Vec<(f64, f64)>,
}

impl Prediction {
    /// Mean relative error of all views.
    #[must_use]
    pub fn error(&self) -> f64 {
        let (sum, views) = self.vertices.iter().fold((0.0, 0.0), |(s, n), v| (s + v.0, n + v.1));
        sum / f64::max(views, 1.0)
    }

    /// How much lower the mean error of a vertex is than in `other`, in standard errors of the difference.
    #[must_use]
    pub fn gain_over(&self, other: &Self) -> f64 {
        let both = self.vertices.iter().zip(&other.vertices).filter(|(a, _)| a.1 > 0.0);
        let gains: Vec<f64> = both.map(|(a, b)| (b.0 - a.0) / a.1).collect();
        let SampleMean { mean, error } = SampleMean::of(&gains);
        if error > 0.0 { mean / error } else { 0.0 }
    }
}

/// Materials of the segments.
#[derive(Clone, Copy)]
pub struct Materials<'a> {
    /// Segment index: `[vertex]`.
    pub segment: &'a [u32],
    /// Albedo: `[segment][channel]`.
    pub albedo: &'a [[f64; 3]],
    /// Specular weights: `[segment]`.
    pub gloss: &'a [Gloss],
}

/// Predicts the observations as albedo · E plus gloss per segment.
#[must_use]
pub(super) fn predict(
    reflection: &Reflection,
    rays: &MirrorRays,
    association: &Association,
    materials: Materials,
    tuning: &SpecularTuning,
) -> Prediction {
    let Materials { segment, albedo, gloss } = materials;
    let observations = MirrorObservations::new(reflection, rays, association, tuning.min_views);
    let stride = segment.len().div_ceil(tuning.judged_vertices as usize).max(1);
    let judged: Vec<usize> = (0..segment.len()).step_by(stride).collect();
    let vertices = judged.par_iter().map(|&i| {
        let (gloss, albedo) = (gloss[segment[i] as usize], albedo[segment[i] as usize]);
        let weight = if gloss.significant { gloss.lobe_weight } else { 0.0 };
        let (mut sum, mut count) = (0.0, 0.0);
        for o in observations.of(i, true) {
            let size = (o.lit[0] + o.lit[1] + o.lit[2]) / 3.0;
            for (c, albedo) in albedo.iter().enumerate() {
                let predicted = albedo * o.irradiance[c] + weight * o.mirror[gloss.lobe][c];
                sum += ((o.seen[c] - predicted).abs() / size.max(f64::MIN_POSITIVE)).min(1.0);
                count += 1.0;
            }
        }
        (sum, count)
    });
    Prediction { vertices: vertices.collect() }
}
