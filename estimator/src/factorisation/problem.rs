//! What is factorised, and how.

use crate::mesh::graph::Graph;
use crate::transfer::Transfer;
use firmware_config::SolverChoice;
use firmware_config::tuning::FactorisationTuning;
use glam::Vec3;

/// A surface whose albedo is known.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownAlbedo {
    /// Vertices, ascending.
    pub vertices: Vec<u32>,
    /// Their median albedo, linear RGB.
    pub albedo: [f64; 3],
}

/// Options of a factorisation.
#[derive(Debug, Clone, Copy)]
pub struct FactorisationOptions<'a> {
    /// Interreflection is modelled.
    pub gi: bool,
    /// SH bands of the light.
    pub bands: usize,
    /// Maximum number of bands once gloss is removed.
    pub max_bands: usize,
    /// Bounces, scaled to the converged series; 0 = until convergence.
    pub bounces: u32,
    /// Solver.
    pub solver: SolverChoice,
    /// Thresholds.
    pub tuning: &'a FactorisationTuning,
}

/// Lit colours and segments.
#[derive(Debug, Clone, Copy)]
pub struct Colors<'a> {
    /// Lit colour f, linear RGB: `[vertex]`.
    pub lit_color: &'a [Vec3],
    /// Weight of the lit colour, 0 = never seen: `[vertex]`.
    pub lit_weight: &'a [f32],
    /// Share of its weight that the lit colour keeps beside brighter surface: `[vertex]`; empty where all are alike.
    pub reliability: &'a [f32],
    /// The lit colour is a lower bound: `[vertex]`.
    pub clipped: &'a [bool],
    /// Segment index: `[vertex]`.
    pub segment: &'a [u32],
    /// Number of segments.
    pub segments: usize,
    /// Its edges.
    pub graph: &'a Graph,
    /// A surface whose albedo is known, which then fixes the scale.
    pub known: Option<&'a KnownAlbedo>,
}

impl<'a> Colors<'a> {
    /// Number of seen vertices: `[segment]`.
    #[must_use]
    pub fn seen(&self) -> Vec<f64> {
        let mut seen = vec![0.0; self.segments];
        let vertices = self.segment.iter().zip(self.lit_weight).filter(|(_, weight)| **weight > 0.0);
        vertices.for_each(|(segment, _)| seen[*segment as usize] += 1.0);
        seen
    }

    /// The same under a transfer.
    #[must_use]
    pub fn under(&self, transfer: &'a Transfer) -> Observed<'a> {
        let Self { lit_color, lit_weight, reliability, clipped, segment, segments, .. } = *self;
        Observed { transfer, lit_color, lit_weight, reliability, clipped, segment, segments }
    }
}

/// The terms of Eq. (9) that are known: f and T.
#[derive(Debug, Clone, Copy)]
pub struct Observed<'a> {
    /// Transfer.
    pub transfer: &'a Transfer,
    /// Lit colour f, linear RGB: `[vertex]`.
    pub lit_color: &'a [Vec3],
    /// Weight of the lit colour, 0 = never seen: `[vertex]`.
    pub lit_weight: &'a [f32],
    /// Share of its weight that the lit colour keeps beside brighter surface: `[vertex]`; empty where all are alike.
    pub reliability: &'a [f32],
    /// The lit colour is a lower bound: `[vertex]`.
    pub clipped: &'a [bool],
    /// Segment index: `[vertex]`.
    pub segment: &'a [u32],
    /// Number of segments.
    pub segments: usize,
}

/// How far a lit colour counts where distant light is solved, 0 to 1: its weight up to 1, times the share that is reliable. Both are
/// `[vertex]`.
#[must_use]
pub fn counted(lit_weight: &[f32], reliability: &[f32], vertex: usize) -> f64 {
    let share = reliability.get(vertex).copied().unwrap_or(1.0);
    f64::from(lit_weight[vertex].min(1.0) * share)
}
