//! Thresholds of the texture.

use crate::settings::section;

section! {
    /// The texture atlas and its texels.
    TextureTuning = "texture" {
        /// Longest side of the atlas: memory and time grow with its square.
        max_side: u32 = 2048, [64..=4096], "texels", "";
        /// Share of the surface that is seen from near: the footprint of its pixels sets the width of a texel.
        near_share: f64 = 0.25, [0.0..=1.0], "", "";
        /// Width of a texel in that footprint. Texels as wide as pixels lose half of the finest octave to interpolation.
        texel_px: f64 = 0.7, [0.1..=10.0], "px", "";
        /// Normals of a chart deviate from its axis by less than this.
        chart_angle_deg: f64 = 45.0, [5.0..=75.0], "deg", "";
        /// Longest side of a chart.
        chart_side: u32 = 512, [16..=2048], "texels", "";
        /// Views at a smaller cosine between normal and view direction do not count.
        min_cosine: f64 = 0.17, [0.0..=1.0], "", "";
        /// What lies this much behind the visible surface is hidden.
        hidden_edges: f64 = 2.0, [0.0..=50.0], "edges", "";
        /// The same in pixels' footprints, added to it.
        hidden_footprints: f64 = 5.0, [0.0..=100.0], "px", "";
        /// Weights of the views fall to zero over this distance from the border of the picture.
        border_px: f64 = 40.0, [1.0..=1000.0], "px", "";
        /// The weights are raised to this power: high powers keep the best view alone, which is sharp, low ones the mean, which has less noise.
        weight_power: f64 = 1.5, [0.0..=16.0], "", "";
        /// Quality of the stored picture.
        jpeg_quality: u32 = 92, [50..=100], "", "";
    }
}
