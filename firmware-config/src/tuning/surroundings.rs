//! Thresholds of completing the light from the background that keyframes observed.

use crate::settings::section;

section! {
    /// Light from directions that no surface responds to. Source of the values: relit views of the rendered scenes.
    SurroundingsTuning = "surroundings" {
        /// Pixels between samples of a keyframe's background.
        sample_step_px: u32 = 3, [1..=64], "px", "";
        /// Pixels around a sample that must also miss the mesh: its outline is blurred and its pose inexact.
        clearance_px: f64 = 4.0, [0.0..=64.0], "px", "";
        /// 8-bit values from which a channel counts as clipped: the radiance is a lower bound.
        clipped_from: u32 = 252, [2..=256], "", "";
        /// Relative spread between keyframes at which a direction shows something near, not the background.
        spread: f64 = 0.3, [0.001..=10.0], "", "";
        /// Maximum number of observed directions to extrapolate from.
        extrapolated_from: u32 = 400, [1..=10000], "", "";
        /// Sharpness s of their weight exp(s (cos - 1)).
        extrapolation_sharpness: f64 = 20.0, [0.1..=1000.0], "", "";
        /// Sum of their weights (1 = observed in all directions) at which extrapolation counts half.
        half_weight: f64 = 0.01, [0.00001..=1.0], "", "";
        /// Share of a peak that one step moves into a lamp (loop gain of CLEAN).
        loop_gain: f64 = 0.25, [0.01..=1.0], "", "";
        /// Maximum number of lamps.
        max_lamps: u32 = 120, [0..=10000], "", "";
        /// Standard deviation of a lamp at one band; it falls with the number of bands.
        lamp_width_rad: f64 = 0.35, [0.001..=3.0], "rad", "";
        /// Peaks below this share of the first become no lamp.
        faintest_lamp: f64 = 0.08, [0.0..=1.0], "", "";
        /// Standard deviations of the light (the posterior of its coefficients) below which a direction gets no lamp and no hue.
        lamp_significance: f64 = 2.0, [0.0..=100.0], "", "";
        /// Share of the unexplained light that the even level may take.
        even_share: f64 = 0.7, [0.0..=1.0], "", "";
        /// Bands of the residual after the lamps that are kept, with falling weight (a Hann window).
        residual_bands: f64 = 5.0, [0.1..=9.0], "", "";
        /// No direction is darker than this share of the even level.
        floor: f64 = 0.25, [0.0..=1.0], "", "";
    }
}
