//! Thresholds of closing holes and continuing texture.

use crate::settings::section;

section! {
    /// How the surface behind a removed object is continued. Source of the values: removals on the rendered and recorded scenes.
    InpaintingTuning = "inpainting" {
        /// An open border half of which lies within this distance of a removed component was hidden by it.
        hidden_edges: f64 = 2.0, [0.0..=50.0], "edges", "";
        /// Of a longer border that touches the component, the part within this distance was hidden.
        touching_edges: f64 = 4.0, [0.0..=50.0], "edges", "";
        /// Smallest hole, in vertices, whose texture is continued.
        smallest_hole: u32 = 24, [1..=1000000], "vertices", "";
        /// Share of a hole that a piece of texture must cover.
        coverage: f64 = 0.97, [0.0..=1.0], "", "";
        /// Largest spread of the log ratio along the border for a piece to be the same texture.
        largest_spread: f64 = 0.35, [0.0..=10.0], "ln", "";
        /// Normals of one surface agree to this cosine.
        same_surface: f64 = 0.8, [0.0..=1.0], "", "";
    }
}
