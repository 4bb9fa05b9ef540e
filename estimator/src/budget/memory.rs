//! Memory at the peak of a run, and the highest workload that fits a limit. Source of the figures: peaks of runs, docs/experiments/budget.md.

use crate::budget::cost_model::Size;
use crate::budget::workload::Workload;
use firmware_config::tuning::BudgetTuning;

/// The program, its threads and its buffers.
const BASE: f64 = 50.0e6;
/// The scan's mesh, per vertex of the scan.
const PER_VERTEX_SCANNED: f64 = 60.0;
/// Mesh, rays, bounces and answer, per vertex.
const PER_VERTEX: f64 = 1500.0;
/// A coefficient of the transfer, while rays are added to those before.
const PER_COEFFICIENT: f64 = 12.0;
/// A hit of a ray, likewise; so many of them are kept at most.
const PER_HIT: f64 = 8.0;
const MOST_HITS: f64 = 33.5e6;
/// Share of the rays that hit.
const LIKELY_BLOCKED: f64 = 0.45;
/// An observation; a third of the keyframes see any one vertex.
const PER_OBSERVATION: f64 = 64.0;
/// A pixel of a keyframe.
const PER_PIXEL: f64 = 9.0;
/// Share of the limit that is planned with: memory that was given back is not always free again.
const USABLE_SHARE: f64 = 0.9;
/// Share of the vertices that one step down keeps.
const STEP: f64 = 0.9;

/// Bytes of a run at these levels.
fn bytes(workload: &Workload, full: &Size) -> f64 {
    let size = workload.size(full);
    let coefficients = (workload.bands * workload.bands) as f64;
    let per_vertex = PER_VERTEX + PER_COEFFICIENT * coefficients + PER_OBSERVATION * size.keyframes / 3.0;
    let hits = (LIKELY_BLOCKED * f64::from(workload.rays) * size.vertices).min(MOST_HITS);
    BASE + PER_VERTEX_SCANNED * size.scanned
        + per_vertex * size.vertices
        + PER_HIT * hits
        + PER_PIXEL * size.pixels * size.keyframes
}

/// `workload` with as few vertices as `limit_mb` megabytes require; every second keyframe goes before light and gloss
/// lose the vertices that they are told by. The least there is if nothing fits.
pub(super) fn fitting(workload: Workload, size: &Size, limit_mb: u32, tuning: &BudgetTuning) -> Workload {
    let limit = USABLE_SHARE * f64::from(limit_mb) * 1e6;
    let mut fitting = workload;
    let steps = [(f64::from(tuning.sufficient_vertices), 1), (f64::from(tuning.min_vertices), 2)];
    for (least, keyframe_stride) in steps {
        if bytes(&fitting, size) > limit && size.keyframes >= f64::from(tuning.min_keyframes) {
            fitting.keyframe_stride = fitting.keyframe_stride.max(keyframe_stride);
        }
        while bytes(&fitting, size) > limit && fitting.size(size).vertices * STEP >= least {
            fitting.vertices = (fitting.size(size).vertices * STEP) as usize;
        }
    }
    fitting
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_config::EstimatorConfig;

    #[test]
    fn a_limit_costs_vertices_first_and_is_kept() {
        let config = EstimatorConfig::default();
        let tuning = &config.tuning.budget;
        let full = Workload::full(&config, None);
        let pixels = 640.0 * 480.0;
        let size = Size { scanned: 9e5, remeshed: false, vertices: 9e5, keyframes: 20.0, pixels, witnesses: 0.0 };
        assert_eq!(fitting(full, &size, 4000, tuning), full, "nothing is reduced without need");
        let small = fitting(full, &size, 629, tuning);
        assert!(bytes(&small, &size) <= 629e6 && small.keyframe_stride == 1, "{small:?}");
        let rays_and_bands = |w: &Workload| (w.rays, w.bands, w.specular, w.texture);
        assert_eq!(rays_and_bands(&small), rays_and_bands(&full));
        let smaller = fitting(full, &size, 300, tuning);
        assert!(smaller.vertices < small.vertices && bytes(&smaller, &size) <= 300e6, "{smaller:?}");
        let least = fitting(full, &size, 16, tuning);
        assert!(least.keyframe_stride == 2 && (least.vertices as f64) < 2300.0, "{least:?}");
    }
}
