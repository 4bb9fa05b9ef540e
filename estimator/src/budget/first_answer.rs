//! How much of everything the first answer takes.

use crate::budget::cost_model::Size;

/// About as many vertices as tell the light and the albedo of large segments.
const VERTICES: usize = 2200;
/// At most this many keyframes.
const KEYFRAMES: f64 = 8.0;
/// Rays per vertex.
const RAYS: u32 = 16;
/// SH bands.
const BANDS: u32 = 3;

/// Reference seconds per pixel of a keyframe: most of the work is with pictures.
const PER_PIXEL: f64 = 1.0e-7;
/// Reference seconds per vertex of the scan.
const PER_VERTEX_SKETCHED: f64 = 3.0e-7;

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
    pub(crate) fn of(size: &Size) -> Self {
        let keyframe_stride = (size.keyframes / KEYFRAMES).ceil().max(1.0) as usize;
        Self { vertices: VERTICES, keyframe_stride, rays: RAYS, bands: BANDS }
    }

    /// Reference seconds, the writing included.
    pub(crate) fn cost(self, size: &Size) -> f64 {
        let keyframes = (size.keyframes / self.keyframe_stride as f64).ceil();
        PER_PIXEL * keyframes * size.pixels + PER_VERTEX_SKETCHED * size.scanned
    }
}

/// Work that is done, and the time that it took.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Done {
    /// Reference seconds.
    pub reference_seconds: f64,
    /// Seconds of the clock.
    pub seconds: f64,
}
