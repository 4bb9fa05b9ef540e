//! Thresholds of the specular weights.

use crate::settings::section;

section! {
    /// Specular weights and the removal of gloss.
    SpecularTuning = "specular" {
        /// Largest number of observations of one segment in the fit.
        max_observations: u32 = 60000, [100..=10000000], "observations", "";
        /// Vertices at which the prediction of the keyframes is judged.
        judged_vertices: u32 = 5000, [100..=1000000], "vertices", "";
        /// Smallest number of views of a vertex whose changes are used.
        min_views: u32 = 3, [2..=100], "views", "";
        /// Residuals beyond this many robust standard deviations get less weight (Huber).
        huber: f64 = 1.5, [0.1..=100.0], "σ", "";
        /// Errors of a picture grow with its brightness, from this share of the segment's median on. Source: measured on the rendered scenes.
        dark_floor: f64 = 0.03, [0.0..=1.0], "", "";
        /// Observations of neighbouring vertices that count as one independent measurement. Source: measured on the rendered scenes.
        correlated_observations: f64 = 30.0, [1.0..=10000.0], "observations", "";
        /// A specular weight is significant from this many standard errors on.
        min_significance: f64 = 3.0, [0.0..=100.0], "σ", "w_s, Eq. (13)";
        /// The level of the colours may raise the specular weight from the changes between views by this factor. Source: measured on the rendered scenes.
        max_level_ratio: f64 = 4.0, [1.0..=100.0], "", "";
        /// Largest weight of a lobe; a larger one is no gloss of a surface with an albedo, but an error of the light. Source: what dielectrics reflect; generated scenes and recordings.
        max_weight: f64 = 0.3, [0.0..=100.0], "", "";
        /// Smallest share of a lit colour that is diffuse.
        min_matte_share: f64 = 0.1, [0.0..=1.0], "", "";
        /// Largest number of passes of cleaning and factorising.
        max_passes: u32 = 3, [1..=20], "passes", "";
        /// RMS change of the log gains from which lit colours are factorised again.
        min_gain_change: f64 = 0.002, [0.0..=1.0], "ln", "";
        /// The prediction of the keyframes must improve by this many standard errors for more bands.
        min_prediction_gain: f64 = 1.0, [0.0..=100.0], "σ", "";
        /// Touching segments whose albedos differ by less are one material.
        similar_albedo: f64 = 10.0, [0.0..=100.0], "CIELAB", "";
    }
}
