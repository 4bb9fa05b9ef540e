//! Lit colours without gloss.

use crate::association::Association;
use crate::numerics::robust::median;
use crate::specular::gloss::Gloss;
use crate::specular::mirror_rays::MirrorRays;
use crate::specular::observations::MirrorObservations;
use crate::specular::reflection::Reflection;
use firmware_config::tuning::SpecularTuning;
use glam::Vec3;
use rayon::prelude::*;

/// The median over views of the observations minus their gloss, linear RGB: `[vertex]`. `segment` is `[vertex]`, `gloss`
/// `[segment]`. Vertices of matte segments keep their lit colour.
#[must_use]
pub(super) fn clean(
    reflection: &Reflection,
    rays: &MirrorRays,
    association: &Association,
    segment: &[u32],
    gloss: &[Gloss],
    tuning: &SpecularTuning,
) -> Vec<Vec3> {
    let observations = MirrorObservations::new(reflection, rays, association, tuning.min_views);
    (0..segment.len())
        .into_par_iter()
        .map(|i| {
            let lit = association.lit_color[i];
            let gloss = gloss[segment[i] as usize];
            if !gloss.significant {
                return lit;
            }
            let found = observations.of(i, true);
            if found.is_empty() {
                return lit;
            }
            let matte = [0, 1, 2].map(|c| {
                median(found.iter().map(|o| o.matte(&gloss, c)))
                    .unwrap_or(0.0)
                    .max(tuning.min_matte_share * f64::from(lit[c])) as f32
            });
            Vec3::from_array(matte)
        })
        .collect()
}
