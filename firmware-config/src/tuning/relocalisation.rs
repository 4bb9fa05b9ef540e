//! Thresholds of relocalisation.

use crate::settings::section;

section! {
    /// Relocalisation against stored anchor frames.
    RelocalisationTuning = "relocalisation" {
        /// Longest time over which the last velocity is extrapolated to a start pose. Source: tuned by hand on recordings with dropped frames.
        max_extrapolation_s: f64 = 1.0, [0.0..=60.0], "s", "";
        /// Largest number of further alignments of the best pose, each to the anchor nearest to it. Source: tuned by hand on recordings.
        refinement_rounds: u32 = 4, [0..=64], "", "";
        /// Refinement stops when fit plus correlation grow by less than this. Source: tuned by hand on recordings.
        min_gain: f64 = 0.01, [0.0..=1.0], "", "";
        /// A pose is accepted from this multiple of `fusion.min_fit` on: a wrong pose must not be fused. Source: tuned by hand on recordings.
        fit_factor: f64 = 1.5, [0.0..=10.0], "", "";
        /// Upper bound of the fit that `fit_factor` asks for. Source: tuned by hand on recordings.
        max_required_fit: f64 = 0.9, [0.0..=1.0], "", "";
        /// Smallest share of the points with a model association that must agree with it. Source: tuned by hand on recordings.
        min_agreement: f64 = 0.7, [0.0..=1.0], "", "";
        /// Smallest share of the anchor's photometric points that must be in the image. Source: tuned by hand on recordings.
        min_photometric_share: f64 = 0.3, [0.0..=1.0], "", "";
    }
}
