//! Thresholds of the exposure estimate.

use crate::settings::section;

section! {
    /// Exposures of the keyframes (Eq. 5).
    ExposureTuning = "exposure" {
        /// Edge of a surface patch. Source: measured on the rendered scenes.
        patch_edges: f64 = 10.0, [1.0..=1000.0], "edges", "";
        /// Sum of observation weights at which a keyframe of a patch has half its full weight. Source: measured on the rendered scenes.
        half_weight: f64 = 20.0, [1e-6..=1e6], "", "";
        /// Log deviation between keyframes that a diffuse patch may show. Source: noise of the rendered scenes.
        diffuse_log: f64 = 0.02, [1e-6..=10.0], "ln", "";
        /// Share of the patches whose deviation sets the tolerance where it is larger than that of diffuse patches. Source: measured on the rendered scenes.
        better_share: f64 = 0.25, [0.0..=1.0], "", "";
        /// Share of a picture's veiling glare that its values may hold: what is dark beside it tells little of the exposure. Source: measured on generated scenes.
        veil_share: f64 = 0.05, [0.0..=1.0], "", "";
        /// Largest number of rounds of reweighting. Source: measured on the rendered scenes.
        rounds: u32 = 15, [1..=1000], "rounds", "";
        /// One gain per channel is used if it lowers the disagreement of held-out patches to this share. Source: measured on the rendered scenes.
        rgb_disagreement: f64 = 0.9, [0.0..=1.0], "", "";
        /// Vignetting is undone if it lowers the disagreement of held-out patches to this share; 0 never asks for it. Source: measured on generated scenes and recordings.
        vignetting_disagreement: f64 = 0.995, [0.0..=1.0], "", "";
        /// Highlights are expanded if it lowers the disagreement of held-out patches to this share; 0 never asks for it. Source: measured on generated scenes and recordings.
        shoulder_disagreement: f64 = 0.985, [0.0..=1.0], "", "";
        /// Weight of glossy vertices when exposures are estimated again from matte ones. Source: measured on the rendered scenes.
        glossy_weight: f64 = 0.003, [0.0..=1.0], "", "";
        /// Smallest share of a keyframe's observations that must be matte for that. Source: measured on the rendered scenes.
        min_matte_share: f64 = 0.03, [0.0..=1.0], "", "";
    }
}
