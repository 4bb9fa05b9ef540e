//! Thresholds of mesh regularisation.

use crate::settings::section;

section! {
    /// Mesh regularisation: edge lengths and vertex counts.
    MeshTuning = "mesh" {
        /// Rounds of split, collapse, flip and smoothing. Source: measured on scans.
        remesh_rounds: u32 = 3, [0..=64], "rounds", "";
        /// Relative tolerance of the number of vertices. Source: measured on scans.
        count_tolerance: f64 = 0.02, [0.0..=1.0], "", "";
        /// Longer edges are split. Source: Botsch and Kobbelt 2004, 4/3.
        longest_edge: f64 = 4.0 / 3.0, [1.0..=4.0], "target edges", "";
        /// Shorter edges are collapsed. Source: Botsch and Kobbelt 2004, 4/5.
        shortest_edge: f64 = 0.8, [0.0..=1.0], "target edges", "";
        /// Longest edge that a collapse towards the requested number of vertices may make. Source: measured on scans.
        longest_edge_to_count: f64 = 1.5, [1.0..=4.0], "target edges", "";
        /// Vertices nearer to each other are merged. Source: far below any edge, far above rounding.
        weld_distance: f64 = 1e-3, [0.0..=0.5], "edges", "";
        /// A mesh with a smaller share of edges outside 0.5 … 1.5 target edges keeps its vertices. Source: measured on scans.
        irregular_share: f64 = 0.02, [0.0..=1.0], "", "";
        /// A mesh with more than this multiple of the requested vertices is clustered before it is remeshed, in far less time and memory. Source: measured on scans.
        cluster_above: f64 = 3.0, [1.0..=1000.0], "", "";
        /// Multiple of the requested vertices that clustering aims at; the rest is left to remeshing, which keeps more of the shape. Source: measured on scans.
        cluster_to: f64 = 2.5, [1.0..=1000.0], "", "";
        /// The mesh may grow to this multiple of its vertices. Source: memory plan.
        max_growth: u32 = 4, [1..=64], "", "";
    }
}
