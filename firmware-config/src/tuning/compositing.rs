//! Thresholds of lighting a changed scene and compositing it over a picture.

use crate::settings::section;

section! {
    /// Differential rendering. Source of the values: pictures of the rendered scenes against their truth.
    CompositingTuning = "compositing" {
        /// GGX width of a recovered glossy surface, whose roughness Eq. (13) does not recover.
        gloss_alpha: f64 = 0.2, [0.001..=1.0], "", "";
        /// Share of irradiance below which a change is not followed: an eighth of a level in a bright 8-bit picture.
        smallest_reach: f64 = 0.001, [0.0..=1.0], "", "";
        /// Share of irradiance from which a change is followed with all rays.
        full_reach: f64 = 0.1, [0.00001..=1.0], "", "";
        /// Smallest share of the rays.
        fewest_rays: f64 = 0.4, [0.0..=1.0], "", "";
        /// A surface with less than this share of the open scene's irradiance gives no measurement of its colour.
        dark_share: f64 = 0.1, [0.0..=1.0], "", "";
        /// Sweeps that average the level between albedo x light and the measured colour over neighbours.
        level_sweeps: u32 = 8, [0..=1000], "", "";
        /// Longest edge of an inserted object, which keeps its light per vertex; longer ones are split.
        longest_edge: f64 = 3.0, [0.1..=1000.0], "median edges", "";
        /// Triangles up to which they are split.
        max_triangles: u32 = 60000, [1..=10000000], "triangles", "";
        /// Ratios of light nearer to 1 than this leave a pixel as it is.
        no_change: f64 = 0.001, [0.0..=1.0], "", "";
        /// Changes of light below this share are shrunk: the error of unobserved lamps' places is as large.
        small_change: f64 = 0.03, [0.0..=1.0], "", "";
        /// Growth of light from which the photo (mostly noise, contact and blur there) fades to the model.
        fade_from: f64 = 1.5, [1.0..=100.0], "", "";
        /// Growth of light at which only the model is left.
        fade_to: f64 = 2.2, [1.0..=100.0], "", "";
        /// Half width of the filter over the change of light, which varies slowly along a surface.
        filter_px: u32 = 2, [0..=32], "px", "";
        /// Samples per pixel of the model as scanned.
        model_samples: u32 = 4, [1..=256], "", "";
        /// Rays per sample of a glossy reflection.
        gloss_rays: u32 = 16, [1..=4096], "", "";
        /// Light of a sample of an inserted thing, over what is recorded as white, beyond which it is cut: a lamp in one of a pixel's samples makes no white speck.
        brightest: f64 = 2.0, [1.0..=1000000000.0], "", "";
    }
}
