//! Thresholds of the factorisation.

use crate::settings::section;

section! {
    /// Factorisation of lit colours into light and albedo.
    FactorisationTuning = "factorisation" {
        /// Lamps and emitting surfaces are looked for where distant light does not explain the surface. Source: the light so far needs an answer within a second.
        near_light: bool = true, [()], "", "";
        /// Veiling glare is looked for, and taken out of the colours. Source: the light so far needs an answer within a second.
        veil: bool = true, [()], "", "";
        /// Albedo of every vertex before anything is known of it. Source: mid grey.
        initial_albedo: f64 = 0.5, [0.01..=1.0], "", "a0, Eq. (10)";
        /// Bands of the first solution, whose albedo only bounces light. Source: measured on the rendered scenes.
        first_bands: u32 = 4, [1..=9], "bands", "";
        /// Share of the seen vertices from which a segment counts as large. Source: measured on the rendered scenes.
        scale_min_share: f64 = 0.02, [0.0..=1.0], "", "";
        /// Albedo that the brightest large segment gets, per channel, while light and albedo are solved for in turn. Source: white paint and paper.
        normalised_albedo: f64 = 0.75, [0.01..=1.0], "", "";
        /// Luminance of the albedo at `scale_quantile` of the seen vertices: the factor that albedo × light leaves free. Source: white paint and paper.
        scale_albedo: f64 = 0.8, [0.01..=1.0], "", "";
        /// Share of the seen vertices whose albedo is below `scale_albedo`. Source: measured on the generated scenes.
        scale_quantile: f64 = 0.98, [0.5..=1.0], "", "";
        /// Deviation of the logarithm of `scale_albedo`. Source: measured on the generated scenes.
        scale_bright_sigma: f64 = 0.25, [0.001..=10.0], "", "σ_q, (S1)";
        /// Largest luminance of the albedo at `scale_quantile`, whatever the evidence. Source: the whitest paints.
        scale_max_albedo: f64 = 0.95, [0.01..=1.0], "", "";
        /// Deviation of the mean irradiance's chroma from neutral, in logarithms: what the white balance leaves. Source: measured on the generated scenes.
        scale_light_sigma: f64 = 0.15, [0.001..=10.0], "", "σ_e, (S1)";
        /// Deviation of the mean albedo's chroma from neutral, in logarithms. Source: measured on the generated scenes.
        scale_albedo_sigma: f64 = 0.4, [0.001..=10.0], "", "σ_a, (S1)";
        /// Deviation of a white surface's chroma from neutral, in logarithms. Source: white paint and paper.
        scale_white_sigma: f64 = 0.1, [0.001..=10.0], "", "σ_w, (S1)";
        /// Vertices of the fit, shared out by the size of the segments. Source: many times the unknowns.
        samples: u32 = 12000, [100..=1000000], "vertices", "";
        /// Smallest number of vertices of one segment in the fit, if it has so many.
        min_segment_samples: u32 = 100, [1..=100000], "vertices", "";
        /// Errors of a lit colour are relative to it, but to no less than this share of its segment's median. Source: measured on the rendered scenes.
        dark_floor: f64 = 0.15, [0.0..=1.0], "", "";
        /// Errors of a channel are relative to no less than this share of the brightest channel. Source: measured on the rendered scenes.
        dark_channel: f64 = 0.001, [0.0..=1.0], "", "";
        /// Gloss that was not detected, relative to the brightest albedo, in units of the relative error of a lit colour. Source: measured on the rendered scenes.
        undetected_gloss: f64 = 0.25, [0.0..=100.0], "", "";
        /// Residuals beyond this many robust standard deviations get less weight (Huber).
        huber: f64 = 1.5, [0.1..=100.0], "σ", "";
        /// A weaker regularisation must lower the held-out error by this share to be chosen. Source: measured on the rendered scenes.
        regularisation_min_gain: f64 = 0.01, [0.0..=1.0], "", "";
        /// Most steps of light and albedo in one solution; most take six. Source: measured on the recordings.
        max_turns: u32 = 25, [1..=1000], "steps", "";
        /// Largest number of bands by which the regularisation is chosen. Source: measured on the rendered scenes.
        regularisation_bands: u32 = 7, [1..=9], "bands", "";
        /// Directions that the surfaces observe less than this share of the best observed one are regularised more. Source: measured on the rendered scenes.
        min_observability: f64 = 0.005, [0.0..=1.0], "", "";
        /// Neighbouring vertices that count as one independent measurement. Source: measured on the rendered scenes.
        correlated_vertices: f64 = 25.0, [1.0..=10000.0], "vertices", "";
        /// Relative error of a lit colour, however often it was seen. Source: measured on the rendered scenes.
        color_error: f64 = 0.02, [0.0..=1.0], "", "";
        /// Relative error of the irradiance where it equals its segment's median. Source: measured on the rendered scenes.
        light_error: f64 = 0.02, [0.0..=1.0], "", "";
        /// Share of the surface that counts as plain, plainest segments first: what spreads their albedo is error.
        plain_share: f64 = 0.5, [0.0..=1.0], "", "";
        /// Largest standard deviation of log albedo that is taken as error; beyond it is paint.
        max_unexplained: f64 = 0.07, [0.0..=2.0], "", "";
        /// Relative error of an albedo at which its confidence is one half.
        half_confidence_error: f64 = 0.15, [0.001..=10.0], "", "";
    }
}
