//! Albedo finer than the vertices in pictures of the scan: the result's texture, and its continuation into what was filled.

use crate::rays::Hit;
use crate::render::before_after_scene::{Body, Part};
use crate::render::inpainting::geometry::Cut;
use crate::render::objects::object::{interpolate, weights};
use crate::texture::detail::Detail;
use glam::Vec3;
use recordings::result::Estimate;

/// A point that a filled one is copied from lies within this many median edges of the surface.
const REACH_EDGES: f32 = 3.0;
/// Largest factor by which copied texture differs from the colour around it.
const MOST_CONTRAST: f32 = 4.0;

/// The texture of a result over the kept and the removed part of a cut.
#[derive(Debug)]
pub struct SurfaceDetail {
    detail: Detail<'static>,
    /// Triangles of the whole that those of the kept part were; patches have none.
    kept: Vec<u32>,
    /// The same of the removed part.
    removed: Vec<u32>,
    /// Where filled vertices were copied from, as a shift in metres: `[vertex]` of the kept part.
    copied: Vec<Option<Vec3>>,
    /// True where the colour of a vertex is continued: `[vertex]` of the kept part.
    filled: Vec<bool>,
}

impl SurfaceDetail {
    /// The texture of a result; `None` without one.
    #[must_use]
    pub fn new(estimate: &Estimate, cut: &Cut) -> Option<Self> {
        let texture = estimate.texture.as_ref()?;
        let detail = Detail::new(texture, &estimate.mesh, &estimate.albedo)
            .inspect_err(|e| tracing::warn!("the texture cannot be read, colours are those of the vertices: {e}"))
            .ok()?;
        Some(Self {
            detail: detail.into_owned(),
            kept: cut.kept_triangles.clone(),
            removed: cut.removed_triangles.clone(),
            copied: Vec::new(),
            filled: Vec::new(),
        })
    }

    /// The same, with what was `filled` and where it was `copied` from: `[vertex]` of the kept part.
    #[must_use]
    pub fn continued(self, filled: Vec<bool>, copied: Vec<Option<Vec3>>) -> Self {
        Self { filled, copied, ..self }
    }

    /// Factor from the colour of the vertices to that of the surface at a hit on this `part` of the scan.
    #[must_use]
    pub fn ratio(&self, body: &Body, part: Part, hit: &Hit) -> Vec3 {
        let own = |list: &[u32]| list.get(hit.triangle as usize).map(|t| self.detail.ratio(*t, weights(hit)));
        match part {
            Part::Inserted => Vec3::ONE,
            Part::Removed => own(&self.removed).unwrap_or(Vec3::ONE),
            Part::Kept => {
                let t = body.object.mesh.triangles[hit.triangle as usize];
                if t.iter().any(|i| self.filled.get(*i as usize) == Some(&true)) {
                    self.copied_ratio(body, t, hit).unwrap_or(Vec3::ONE)
                } else {
                    own(&self.kept).unwrap_or(Vec3::ONE)
                }
            }
        }
    }

    /// The texture of the place that a filled triangle was copied from.
    fn copied_ratio(&self, body: &Body, t: [u32; 3], hit: &Hit) -> Option<Vec3> {
        let shift = (*self.copied.get(t[0] as usize)?)?;
        if t.iter().any(|i| self.copied[*i as usize] != Some(shift)) {
            return None;
        }
        let mesh = &body.object.mesh;
        let normal = interpolate(&mesh.normals, t, hit).normalize_or_zero();
        let reach = REACH_EDGES * body.bvh.median_edge();
        let from = interpolate(&mesh.positions, t, hit) + shift + normal * reach;
        let source = body.bvh.closest_hit(from, -normal).filter(|h| h.distance <= 2.0 * reach)?;
        let known = mesh.triangles[source.triangle as usize].iter().all(|i| !self.filled[*i as usize]);
        let whole = self.kept.get(source.triangle as usize).filter(|_| known)?;
        let ratio = self.detail.ratio(*whole, weights(&source));
        Some(ratio.clamp(Vec3::splat(1.0 / MOST_CONTRAST), Vec3::splat(MOST_CONTRAST)))
    }
}
