//! How much of everything the first answer takes.

use crate::budget::cost_model::{self, Size};
use crate::budget::workload::Workload;

/// About as many vertices as tell the light and the albedo of large segments.
const VERTICES: usize = 2200;
/// At most this many keyframes.
const KEYFRAMES: f64 = 8.0;
/// Rays per vertex.
const RAYS: u32 = 16;
/// SH bands.
const BANDS: u32 = 3;

/// Effort of the first answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FirstAnswer {
    /// Vertices that it works on, roughly.
    pub vertices: usize,
    /// Every n-th keyframe is used.
    pub keyframe_stride: usize,
    /// Rays per vertex.
    pub rays: u32,
    /// SH bands.
    pub bands: u32,
}

impl FirstAnswer {
    /// For a scan of this size.
    pub(super) fn of(size: &Size) -> Self {
        let keyframe_stride = (size.keyframes / KEYFRAMES).ceil().max(1.0) as usize;
        Self { vertices: VERTICES, keyframe_stride, rays: RAYS, bands: BANDS }
    }

    /// Reference seconds.
    pub(super) fn cost(self, full: &Size) -> f64 {
        let size = Size {
            vertices: full.vertices.min(self.vertices as f64),
            keyframes: (full.keyframes / self.keyframe_stride as f64).ceil(),
            ..*full
        };
        cost_model::mesh(full, size.vertices < full.vertices)
            + cost_model::pictures(&size)
            + cost_model::association(&size)
            + cost_model::segmentation(&size)
            + cost_model::rays(size.vertices, self.rays)
            + Workload::SOLUTIONS * cost_model::solution(self.bands as usize)
            + cost_model::output(&size)
    }
}
