//! Observations of a vertex beside the reflected light that is predicted for them.

use crate::association::Association;
use crate::numerics::robust::median;
use crate::numerics::sh;
use crate::specular::gloss::{Gloss, LOBES};
use crate::specular::mirror_rays::{MirrorRay, MirrorRays};
use crate::specular::reflection::{BLURRED, Reflection};

/// One observation of a vertex. Colours are linear RGB.
pub(super) struct MirrorObservation {
    /// e_j f~_ij.
    pub seen: [f64; 3],
    /// f_i.
    pub lit: [f64; 3],
    /// E_i.
    pub irradiance: [f64; 3],
    /// f_s,ij for every lobe.
    pub mirror: [[f64; 3]; LOBES.len()],
    /// Weight of the observation.
    pub weight: f64,
    /// Index of the keyframe.
    pub keyframe: usize,
}

impl MirrorObservation {
    /// What was seen in a channel, less this gloss.
    pub fn matte(&self, gloss: &Gloss, channel: usize) -> f64 {
        self.seen[channel] - gloss.lobe_weight * self.mirror[gloss.lobe][channel]
    }
}

/// The observations of the surface with predicted reflections.
pub(super) struct MirrorObservations<'a> {
    reflection: Reflection<'a>,
    rays: &'a MirrorRays<'a>,
    /// `[k][lobe and channel]`.
    lights: Vec<[f64; BLURRED]>,
    association: &'a Association,
    min_views: usize,
}

impl<'a> MirrorObservations<'a> {
    /// Vertices with fewer than `min_views` views have no observations.
    pub fn new(
        reflection: &Reflection<'a>,
        rays: &'a MirrorRays<'a>,
        association: &'a Association,
        min_views: u32,
    ) -> Self {
        let min_views = min_views as usize;
        Self { reflection: reflection.clone(), rays, lights: reflection.blurred(), association, min_views }
    }

    /// The observations of a vertex whose mirror direction is free. With `blocked`, also those whose mirror direction hits a
    /// surface that was seen: Eq. (13) drops them, but they hold gloss like the others.
    pub fn of(&self, vertex: usize, blocked: bool) -> Vec<MirrorObservation> {
        let Self { reflection, rays, lights, association, .. } = self;
        let lit = association.lit_color[vertex].to_array().map(f64::from);
        let irradiance = reflection.irradiance[vertex].to_array().map(f64::from);
        let range = association.offsets[vertex] as usize..association.offsets[vertex + 1] as usize;
        let found: Vec<MirrorObservation> = association.observations[range]
            .iter()
            .zip(rays.of(association, vertex))
            .filter_map(|(o, ray)| {
                let MirrorRay { direction, hit } = (*ray)?;
                let mirror = match hit {
                    None => {
                        let seen = sh::radiance(lights, direction.as_dvec3()).map(|x| x.max(0.0));
                        std::array::from_fn(|lobe| [0, 1, 2].map(|c| seen[3 * lobe + c]))
                    }
                    Some(hit) if blocked => [reflection.lit_at(association, direction, &hit)?; LOBES.len()],
                    _ => return None,
                };
                let (seen, weight) = (o.color.map(f64::from), f64::from(o.weight));
                let keyframe = usize::from(o.keyframe);
                Some(MirrorObservation { seen, lit, irradiance, mirror, weight, keyframe })
            })
            .collect();
        if found.len() < self.min_views { Vec::new() } else { found }
    }
}

/// Medians of f_s over the views of one vertex, for every lobe; 0 without views.
pub(super) fn mirror_medians(views: &[MirrorObservation]) -> [[f64; 3]; LOBES.len()] {
    let middle = |lobe: usize, channel: usize| median(views.iter().map(|o| o.mirror[lobe][channel])).unwrap_or(0.0);
    std::array::from_fn(|lobe| std::array::from_fn(|channel| middle(lobe, channel)))
}
