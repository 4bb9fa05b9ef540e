//! The observations of all keyframes, by vertex.

use crate::association::context::AssociationContext;
use crate::association::eligibility::EligibilityRules;
use crate::association::keyframe_image::KeyframeImage;
use crate::association::observations::{Observation, RefinedView};
use crate::association::sampling::{KeyframeObservations, observe};
use crate::mesh::raster::Raster;
use crate::numerics::lists::by_key;
use rayon::prelude::*;

/// Z-buffers of all keyframes are kept if they take so many bytes at most.
const KEPT_RASTERS: usize = 32 << 20;

/// Observations before exposure: `color` is the linear value f~_ij of the image itself.
pub struct LightField {
    /// Sorted by vertex, then keyframe.
    pub observations: Vec<Observation>,
    /// Row starts in `observations`: `[vertex + 1]`.
    pub offsets: Vec<u32>,
}

impl LightField {
    /// Observations under `rules`, with those of `last_resort` at vertices that have no better ones. Keyframes without an
    /// image give none. Also the z-buffers of the keyframes; none where they would take much memory, nor with observations of last resort,
    /// after which no pose is refined.
    pub fn gather(
        context: &AssociationContext,
        images: &[Option<KeyframeImage>],
        views: &[RefinedView],
        rules: &EligibilityRules,
        last_resort: Option<EligibilityRules>,
    ) -> (Self, Vec<Option<Raster>>) {
        let pixels = |i: &KeyframeImage| i.camera.width as usize * i.camera.height as usize;
        let bytes = images.iter().flatten().map(pixels).sum::<usize>() * Raster::PIXEL_BYTES;
        let keeps = last_resort.is_none() && bytes <= KEPT_RASTERS;
        let (per_view, rasters): (Vec<KeyframeObservations>, Vec<Option<Raster>>) = images
            .par_iter()
            .zip(views)
            .enumerate()
            .map(|(j, (image, view))| match image {
                Some(image) => {
                    let (observed, raster) =
                        observe(context, image, &view.world_from_camera, j as u16, rules, last_resort);
                    (observed, keeps.then_some(raster))
                }
                None => Default::default(),
            })
            .unzip();
        let n = context.mesh.positions.len();
        let mut well_seen = vec![false; n];
        per_view.iter().flat_map(|v| &v.good).for_each(|o| well_seen[o.vertex as usize] = true);
        let kept = || {
            let poor = per_view.iter().flat_map(|v| &v.poor).filter(|o| !well_seen[o.vertex as usize]);
            per_view.iter().flat_map(|v| &v.good).chain(poor)
        };
        let (offsets, observations) = by_key(n, kept().map(|o| (o.vertex, *o)));
        (Self { observations, offsets }, rasters)
    }

    /// Number of vertices.
    pub fn vertices(&self) -> usize {
        self.offsets.len() - 1
    }

    /// Observations of a vertex.
    pub fn row(&self, vertex: usize) -> &[Observation] {
        &self.observations[self.offsets[vertex] as usize..self.offsets[vertex + 1] as usize]
    }
}
