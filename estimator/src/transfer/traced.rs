//! The result of tracing: direct transfer, blocked shares and hits.

use crate::mesh::graph::Graph;
use crate::mesh::vertex_weight::vertex_weights;
use crate::transfer::sun::Sun;
use crate::transfer::vertex::{INDIRECT, cosine_lobe};
use rayon::prelude::*;
use recordings::types::Mesh;
use std::sync::Arc;

/// Error of the transfer with twice the rays of a scrambled Sobol set, over the error before. Measured.
pub const ERROR_OF_TWICE: f64 = 0.6;

/// Direct transfer and hits of every vertex. Light and albedo may change without another ray. Clones share what is large.
#[derive(Debug, Clone)]
pub struct Traced {
    /// SH bands of `direct`.
    pub bands: usize,
    /// Transfer without interreflection: `[vertex][bands²]`.
    pub direct: Arc<Vec<f32>>,
    /// Cosine-weighted share of the hemisphere that is blocked: `[vertex]`.
    pub blocked: Vec<f32>,
    /// Estimated error of the first five bands of what the vertex's own rays say, as a norm over them: `[vertex]`.
    pub error: Vec<f32>,
    /// Error of `direct` over that, over all vertices, since neighbours share their rays.
    pub shared: f64,
    /// Weight in the equations of the light, small at rims and creases, where normals are unreliable: `[vertex]`.
    pub vertex_weight: Vec<f32>,
    /// Rays per vertex.
    pub rays: u32,
    /// Start of each vertex's hits in `corners`: `[vertex + 1]`.
    pub(super) offsets: Arc<Vec<u32>>,
    /// One vertex of the triangle of each hit, drawn by its barycentric weight.
    pub(super) corners: Arc<Vec<u32>>,
    /// Rays per vertex whose hits are kept.
    pub(super) hit_rays: u32,
    /// The sun, where there is one beside the harmonics.
    pub sun: Option<Arc<Sun>>,
}

/// Transfer of the cosine alone, in closed form.
#[must_use]
pub fn unoccluded(mesh: &Mesh, bands: usize) -> Traced {
    let (k, vertices) = (bands * bands, mesh.positions.len());
    let mut direct = vec![0.0f32; vertices * k];
    direct.par_chunks_mut(k).zip(&mesh.normals).for_each(|(row, n)| cosine_lobe(*n, row));
    Traced {
        bands,
        direct: direct.into(),
        blocked: vec![0.0; vertices],
        error: vec![0.0; vertices],
        shared: 1.0,
        vertex_weight: vertex_weights(mesh, &Graph::of(mesh)),
        rays: 0,
        offsets: vec![0; vertices + 1].into(),
        corners: Arc::default(),
        hit_rays: 0,
        sun: None,
    }
}

impl Traced {
    /// Number of vertices.
    #[must_use]
    pub fn vertices(&self) -> usize {
        self.blocked.len()
    }

    /// Cosine-weighted share of blocked rays, mean over all vertices.
    #[must_use]
    pub fn mean_blocked(&self) -> f64 {
        self.blocked.iter().map(|b| f64::from(*b)).sum::<f64>() / self.vertices().max(1) as f64
    }

    /// Relative standard error of the first five bands over all vertices.
    #[must_use]
    pub fn relative_error(&self) -> f64 {
        let k = self.bands * self.bands;
        let error: f64 = self.error.iter().map(|e| f64::from(*e).powi(2)).sum();
        let size: f64 = self
            .direct
            .chunks(k)
            .map(|row| row.iter().take(INDIRECT).map(|t| f64::from(*t).powi(2)).sum::<f64>())
            .sum();
        if size > 0.0 { self.shared * libm::sqrt(error / size) } else { 0.0 }
    }

    /// Error of the first five bands by the vertex's own rays relative to their norm, at most 10: `[vertex]`. What is left of it where
    /// neighbours share their rays is alike in all of them, as paint is.
    #[must_use]
    pub fn relative_errors(&self) -> Vec<f32> {
        let k = self.bands * self.bands;
        self.direct
            .par_chunks(k)
            .zip(&self.error)
            .map(|(row, error)| {
                let size = row.iter().take(INDIRECT).map(|t| t * t).sum::<f32>().sqrt();
                if size > 0.0 { (error / size).min(10.0) } else { 10.0 }
            })
            .collect()
    }

    /// The same with the sun beside the harmonics.
    #[must_use]
    pub fn with_sun(&self, sun: Sun) -> Self {
        Self { sun: Some(Arc::new(sun)), ..self.clone() }
    }

    /// Rays per vertex whose hits are held.
    #[must_use]
    pub fn hit_rays(&self) -> u32 {
        self.hit_rays
    }

    /// Vertices whose front the held rays of one vertex hit, one for each such ray of [`Traced::hit_rays`].
    #[must_use]
    pub fn hits(&self, vertex: usize) -> &[u32] {
        &self.corners[self.offsets[vertex] as usize..self.offsets[vertex + 1] as usize]
    }

    /// Joins these rays with `more`, which follow them in the same sequence; `rays` is their sum. The hits of these stay.
    pub(super) fn join(&self, more: Self, rays: u32) -> Self {
        let share = self.rays as f32 / rays as f32;
        let mean = |old: &[f32], new: &[f32]| -> Vec<f32> {
            old.par_iter().zip(new).map(|(a, b)| share * a + (1.0 - share) * b).collect()
        };
        // The error of `more` was estimated from its own halves; it falls by ERROR_OF_TWICE for each doubling.
        let shrunk = libm::pow(f64::from(1.0 - share), -libm::log2(ERROR_OF_TWICE)) as f32;
        Self {
            direct: mean(&self.direct, &more.direct).into(),
            blocked: mean(&self.blocked, &more.blocked),
            error: more.error.iter().map(|e| shrunk * e).collect(),
            shared: more.shared,
            rays,
            ..self.clone()
        }
    }
}
