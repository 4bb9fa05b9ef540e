//! Thresholds of the planner.

use crate::settings::section;

section! {
    /// The planner of the time budget.
    BudgetTuning = "budget" {
        /// Rays per vertex where the budget does not bind and nothing is known of the scene.
        default_rays: u32 = 128, [8..=65536], "rays", "N";
        /// Rays per vertex below which other levels are cut first.
        few_rays: u32 = 32, [1..=65536], "rays", "N";
        /// Smallest number of rays per vertex.
        min_rays: u32 = 8, [1..=65536], "rays", "N";
        /// Smallest number of keyframes before alternate ones may be dropped.
        min_keyframes: u32 = 12, [2..=100000], "keyframes", "";
        /// Vertices that determine light and gloss nearly as well as more: those above are cut before gloss. Source: measured on the rendered scenes.
        sufficient_vertices: u32 = 40000, [100..=10000000], "vertices", "";
        /// Smallest number of vertices that a mesh is cut to.
        min_vertices: u32 = 2000, [10..=10000000], "vertices", "";
        /// Share of the vertices that one cut keeps.
        vertex_step: f64 = 0.7, [0.1..=0.95], "", "";
        /// Share of the time left that is planned with: costs are estimates, and machines stall.
        usable_share: f64 = 0.7, [0.1..=1.0], "", "";
        /// Share of the budget that the speed probe and the first answer before it may take where the budget may bind.
        probe_share: f64 = 0.04, [0.001..=0.5], "", "";
        /// The probe ends early if the whole run takes less than this share of the budget.
        clearly_enough_share: f64 = 0.35, [0.0..=1.0], "", "";
    }
}
