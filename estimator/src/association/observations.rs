//! The result of association: observations of the vertices by the keyframes, lit colours, exposures and poses.

use crate::association::lampless_air::LamplessAir;
use crate::association::seen_lamps::SeenLamp;
use crate::association::veil::Veil;
use crate::association::vignetting::Vignetting;
use firmware_config::tuning::ExposureTuning;
use glam::Vec3;
use recordings::decision::Decision;
use recordings::types::{Pose, Response};

/// The sample of one keyframe at one vertex.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Index of the vertex.
    pub vertex: u32,
    /// Index of the keyframe.
    pub keyframe: u16,
    /// Linear RGB: e_j f~_ij, after exposure.
    pub color: [f32; 3],
    /// Reliability, 0 to 1, from viewing angle, resolution and clipping.
    pub weight: f32,
    /// A pixel of the sample is clipped: the colour is a lower bound.
    pub clipped: bool,
}

/// Pose and exposure of a keyframe after association.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RefinedView {
    /// Refined pose.
    pub world_from_camera: Pose,
    /// Gain g_j = 1/e_j per channel; geometric mean 1 over keyframes and channels.
    pub gain: [f64; 3],
    /// RMS of the last Lucas–Kanade step in pixels; 0 if the pose was not refined.
    pub residual_px: f64,
}

/// True if exposures were estimated: not all gains are 1.
#[must_use]
pub fn are_exposed(views: &[RefinedView]) -> bool {
    views.iter().any(|v| v.gain != [1.0; 3])
}

/// What a camera and its lens do to the pictures.
#[derive(Debug, Clone, Copy, Default)]
pub struct Lens {
    /// Share of the veil that the colours of the vertices are free of.
    pub veil_share: f64,
    /// Vignetting that they are free of.
    pub vignetting: Vignetting,
    /// By which the pictures were decoded.
    pub response: Response,
}

/// The surface light field and the values estimated from it.
#[derive(Clone)]
pub struct Association {
    /// f: robust lit colour, linear RGB, `[vertex]`.
    pub lit_color: Vec<Vec3>,
    /// Sum of the weights behind it, `[vertex]`; 0 for vertices that were never seen.
    pub lit_weight: Vec<f32>,
    /// Share of its weight that a lit colour keeps beside brighter surface, 0 to 1: `[vertex]`.
    pub reliability: Vec<f32>,
    /// Seen, but clipped in every keyframe: the lit colour is a lower bound. `[vertex]`
    pub clipped: Vec<bool>,
    /// `[keyframe]`.
    pub views: Vec<RefinedView>,
    /// Every observation, sorted by vertex, then keyframe.
    pub observations: Vec<Observation>,
    /// Row starts in `observations`: `[vertex + 1]`.
    pub offsets: Vec<u32>,
    /// What the lens scatters over each picture at a share of 1; `None` for keyframes without a picture. `[keyframe]`
    pub veils: Vec<Option<Veil>>,
    /// What the colours were freed of.
    pub lens: Lens,
    /// Lamps that the pictures show in the air.
    pub seen_lamps: Vec<SeenLamp>,
    /// Where they show that there is none.
    pub lampless_air: LamplessAir,
    /// Exposure model and pose refinement, with their evidence.
    pub decisions: Vec<Decision>,
    /// Linear samples below this are not used for exposures.
    pub dark_below: f32,
    /// Thresholds of the exposure estimate.
    pub exposure: ExposureTuning,
}

/// Vertices with observations, all of which are clipped. Rows of `observations` start at `offsets`, `[vertex + 1]`.
#[must_use]
pub fn always_clipped(observations: &[Observation], offsets: &[u32]) -> Vec<bool> {
    let rows = offsets.windows(2).map(|row| &observations[row[0] as usize..row[1] as usize]);
    rows.map(|row| !row.is_empty() && row.iter().all(|o| o.clipped)).collect()
}
