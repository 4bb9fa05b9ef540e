//! Rays from every vertex, in blocks that run in parallel.

use crate::mesh::graph::Graph;
use crate::mesh::vertex_weight::vertex_weights;
use crate::numerics::random::CosineDirections;
use crate::rays::RayScene;
use crate::transfer::neighbours::share;
use crate::transfer::traced::{Traced, unoccluded};
use crate::transfer::vertex::{self, Hits, INDIRECT};
use rayon::prelude::*;
use recordings::types::Mesh;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Vertices of one parallel task.
const BLOCK: usize = 256;
/// Maximum number of hits kept, 4 bytes each. With more, bounces use the first rays of every vertex alone.
pub(super) const MAX_HITS: u64 = 1 << 25;

/// Traces cosine-distributed rays from the vertices of a mesh.
#[derive(Clone, Copy)]
pub struct Tracer<'a> {
    /// Mesh with unit normals.
    pub mesh: &'a Mesh,
    /// Its edges.
    pub graph: &'a Graph,
    /// The same for rays.
    pub scene: &'a RayScene,
    /// SH bands of the transfer.
    pub bands: usize,
    /// Seed of the directions.
    pub seed: u32,
}

impl Tracer<'_> {
    /// Traces `rays` rays per vertex; `report` gets the share done, 0 to 1.
    #[must_use]
    pub fn trace(&self, rays: u32, report: &(dyn Fn(f64) + Sync)) -> Traced {
        let go_on = |share: f64| {
            report(share);
            true
        };
        self.trace_while(rays, None, &go_on).unwrap_or_else(|| unoccluded(self.mesh, self.bands))
    }

    /// Like [`Self::trace`], but cancellable: `None` once `go_on`, which gets the share done, returns false. Rays of `have`,
    /// traced with the same seed and bands, are not traced again, and its hits stay the only ones.
    #[must_use]
    pub fn trace_while(
        &self,
        rays: u32,
        have: Option<&Traced>,
        go_on: &(dyn Fn(f64) -> bool + Sync),
    ) -> Option<Traced> {
        match have.filter(|h| h.bands == self.bands && h.rays > 0 && h.rays < rays) {
            // Light that bounces is smoother than what is blocked: the hits that there are suffice.
            Some(have) => {
                let weights = || have.vertex_weight.clone();
                Some(have.join(self.trace_range(have.rays..rays, 0, weights, go_on)?, rays))
            }
            None => {
                let hit_rays = kept_rays(self.mesh.positions.len(), rays, MAX_HITS);
                self.trace_range(0..rays, hit_rays, || vertex_weights(self.mesh, self.graph), go_on)
            }
        }
    }

    /// Cosine-weighted share of blocked rays, with `rays` rays from about `samples` evenly strided vertices.
    #[must_use]
    pub fn blocked(&self, samples: usize, rays: u32) -> f64 {
        let directions = CosineDirections::new(rays, self.seed);
        let stride = self.mesh.positions.len().div_ceil(samples.max(1)).max(1);
        let vertices: Vec<usize> = (0..self.mesh.positions.len()).step_by(stride).collect();
        let blocked: Vec<f64> = vertices
            .par_iter()
            .map(|&v| {
                let mut row = [0.0f32; INDIRECT];
                let mut hits = Hits { rays: 0, corners: &mut Vec::new() };
                let target = (self.mesh, self.scene);
                f64::from(vertex::trace(target, &directions, v, 0..rays, &mut row, &mut hits).0)
            })
            .collect();
        blocked.iter().sum::<f64>() / vertices.len().max(1) as f64
    }

    /// Traces a range of the rays of every vertex and keeps the hits of the first `hit_rays` of all. `vertex_weight` is asked beside it.
    pub(super) fn trace_range(
        &self,
        range: Range<u32>,
        hit_rays: u32,
        vertex_weight: impl FnOnce() -> Vec<f32> + Send,
        go_on: &(dyn Fn(f64) -> bool + Sync),
    ) -> Option<Traced> {
        let Self { mesh, graph, scene, bands, seed } = *self;
        let k = bands * bands;
        let count = mesh.positions.len();
        let directions = CosineDirections::new(range.end, seed);
        let mut direct = vec![0.0f32; count * k];
        let mut blocked = vec![0.0f32; count];
        let mut error = vec![0.0f32; count];
        let done = AtomicUsize::new(0);
        let cancelled = AtomicBool::new(false);
        let blocks = direct
            .par_chunks_mut(BLOCK * k)
            .zip(blocked.par_chunks_mut(BLOCK))
            .zip(error.par_chunks_mut(BLOCK))
            .enumerate()
            .map(|(block, ((direct, blocked), error))| {
                let (mut ends, mut corners) = (Vec::with_capacity(blocked.len()), Vec::new());
                if cancelled.load(Ordering::Relaxed) {
                    return (ends, corners);
                }
                for (j, row) in direct.chunks_mut(k).enumerate() {
                    let mut hits = Hits { rays: hit_rays as usize, corners: &mut corners };
                    let (target, v) = ((mesh, scene), block * BLOCK + j);
                    (blocked[j], error[j]) = vertex::trace(target, &directions, v, range.clone(), row, &mut hits);
                    ends.push(corners.len() as u32);
                }
                let before = done.fetch_add(blocked.len(), Ordering::Relaxed);
                if !go_on((before + blocked.len()) as f64 / count as f64) {
                    cancelled.store(true, Ordering::Relaxed);
                }
                (ends, corners)
            });
        let (hits, vertex_weight): (Vec<(Vec<u32>, Vec<u32>)>, _) = rayon::join(|| blocks.collect(), vertex_weight);
        if cancelled.into_inner() {
            return None;
        }
        let mut offsets = Vec::with_capacity(count + 1);
        offsets.push(0);
        let mut corners = Vec::with_capacity(hits.iter().map(|(_, c)| c.len()).sum());
        for (ends, block) in hits {
            let start = corners.len() as u32;
            offsets.extend(ends.iter().map(|e| start + e));
            corners.extend(block);
        }
        let shared = share(graph, &mesh.normals, bands, &mut direct, &error);
        let rays = range.end - range.start;
        Some(Traced {
            bands,
            direct: direct.into(),
            blocked,
            error,
            shared,
            vertex_weight,
            rays,
            offsets: offsets.into(),
            corners: corners.into(),
            hit_rays,
            sun: None,
        })
    }
}

/// Rays per vertex whose hits are kept, so that all hits stay below `max_hits`: all rays, or a power of two of them, since
/// such a prefix of a Sobol set is as evenly spread as the whole.
pub(super) fn kept_rays(vertices: usize, rays: u32, max_hits: u64) -> u32 {
    let fitting = (max_hits / vertices.max(1) as u64).max(1);
    if u64::from(rays) <= fitting { rays } else { 1 << fitting.ilog2() }
}
