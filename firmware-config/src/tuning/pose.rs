//! Thresholds of pose refinement.

use crate::settings::section;

section! {
    /// Pose refinement of the keyframes (Lucas–Kanade).
    PoseTuning = "pose" {
        /// Largest number of Gauss–Newton steps at a pyramid level. Source: measured on the rendered scenes.
        gauss_newton_steps: u32 = 8, [1..=1000], "steps", "";
        /// A smaller step ends a pyramid level. Source: far below the pose error.
        settled_px: f64 = 0.01, [0.0..=10.0], "px", "";
        /// A smaller RMS step over all keyframes ends the refinement. Source: measured on the rendered scenes.
        converged_px: f64 = 0.05, [0.0..=10.0], "px", "";
        /// Steps of tracked keyframes on the finest level are this many times as long as each alone asks for, while they shrink. Source: measured on recordings and generated scenes.
        over_relaxation: f64 = 1.3, [1.0..=1.9], "", "";
        /// Pixels that count as one independent observation: errors of neighbouring pixels are correlated. Source: measured on the rendered scenes.
        pixels_per_observation: f64 = 25.0, [1.0..=1e6], "px", "";
        /// Edge pixels that are compared at a pyramid level, evenly chosen among those that there are; less than twice as many where those are no multiple. Source: measured on recordings and generated scenes.
        edge_pixels: u32 = 40000, [1000..=100000000], "", "";
        /// Standard deviation of the given poses, which the prior assumes. Source: tracking errors on recordings.
        prior_px: f64 = 5.0, [1e-3..=1e6], "px", "";
        /// Standard deviation of tracked poses about the motion that all of them have in common. Source: measured on generated recordings.
        tracked_px: f64 = 1.0, [1e-3..=1e6], "px", "";
        /// Smallest number of moved keyframes whose motions tell how far given poses are off; with fewer, the prior alone holds them. Source: a median of fewer is uncertain.
        deviation_keyframes: u32 = 6, [2..=1000000], "", "";
        /// A keyframe whose motion is longer than this many robust deviations of all motions ran away: the prior holds it with that deviation from then on. Source: measured on the rendered scenes.
        runaway_deviations: f64 = 8.0, [0.1..=1e6], "σ", "";
        /// Where translations alone would move the pictures by this many times what the whole motions move them, and those by more than `ambiguous_px`, pictures do not tell the two apart: given translations stay, unless they were tracked. Source: measured on generated scenes.
        ambiguous_share: f64 = 1.25, [1.0..=1e6], "", "";
        /// See `ambiguous_share`. Source: generated closed rooms begin at 1.8 pixels, plain bodies end at 1.2.
        ambiguous_px: f64 = 1.5, [0.0..=1e6], "px", "";
        /// Rings of unseen vertices that take their neighbours' lit colour in the predicted image. Source: measured on the rendered scenes.
        fill_rings: u32 = 8, [0..=1000], "edges", "";
        /// Smallest number of edge pixels with which a keyframe is aligned. Source: far above the six unknowns.
        min_edge_pixels: u32 = 50, [6..=1000000], "px", "";
        /// Smallest squared gradient of an edge pixel, in square roots of linear light per pixel. Source: above the noise of an 8-bit image.
        min_edge_strength: f64 = 3e-5, [0.0..=1.0], "", "";
        /// Pixels around the mesh's outline that may still show the mesh. Source: measured on scans.
        outline_px: u32 = 4, [0..=64], "px", "";
    }
}
