//! Thresholds of segmentation.

use crate::settings::section;

section! {
    /// Segmentation into materials (Eqs. 6–7): colour features, distances, borders between regions.
    SegmentationTuning = "segmentation" {
        /// Weight of lightness against chromaticity in the colour distance: shading changes lightness far more. Source: measured on the rendered scenes.
        lightness_share: f64 = 0.25, [0.0..=1.0], "", "";
        /// Passes of the edge-sharpening (Kuwahara) filter over the colour features. Source: measured on the rendered scenes.
        sharpening_passes: u32 = 3, [0..=16], "passes", "";
        /// Lower bound of the robust scale of colour differences in Eq. (6). Source: noise of lit colours on the rendered scenes.
        min_color_scale: f64 = 0.25, [1e-6..=100.0], "CIELAB", "";
        /// Lower bound of the robust scale of concavity in Eq. (6). Source: normals of smooth rendered surfaces.
        min_concavity_scale_rad: f64 = 0.05, [1e-6..=3.0], "rad", "";
        /// Lower bound of the robust scale of relative shape-diameter differences in Eq. (6). Source: measured on the rendered scenes.
        min_diameter_scale: f64 = 0.05, [1e-6..=10.0], "", "";
        /// Rays per vertex for the shape diameter. Source: the paper, about 30.
        shape_diameter_rays: u32 = 30, [3..=1000], "rays", "";
        /// One-sided smoothing passes before features are read near a border: images blur a border over a few vertices. Source: measured on the rendered scenes.
        border_near_steps: u32 = 3, [0..=64], "passes", "";
        /// Further smoothing passes before features are read far from a border, so that gradients can be separated from steps. Source: measured on the rendered scenes.
        border_far_steps: u32 = 9, [0..=64], "passes", "";
        /// Steps in which the merging threshold rises. Source: measured on the rendered scenes.
        merge_steps: u32 = 5, [1..=64], "steps", "";
        /// Weighted lightness difference that shading alone may cause across a crease. Source: measured on the rendered scenes.
        crease_lightness: f64 = 4.0, [0.0..=100.0], "CIELAB", "";
        /// Cosine between the normals of two neighbours at or below which their edge is a crease. Source: measured on the rendered scenes.
        crease_cosine: f64 = 0.9, [-1.0..=1.0], "", "";
        /// Gain in strength of a fully concave border. Source: measured on the rendered scenes.
        concave_border_gain: f64 = 0.6, [0.0..=100.0], "", "";
        /// Mean concavity from which a border counts as fully concave. Source: measured on the rendered scenes.
        concave_border_rad: f64 = 0.3, [1e-6..=3.0], "rad", "";
        /// Borders of fewer edges are strengthened: where two regions nearly touch in a point, images mix their colours. Source: measured on the rendered scenes.
        short_border_edges: f64 = 6.0, [0.0..=1000.0], "edges", "";
        /// Difference of the logarithms of two albedos up to which they are one material, in the mean of the channels. Source: measured on the generated scenes.
        material_level: f64 = 0.3, [0.0001..=10.0], "", "";
        /// The same for what the channels differ from their mean by, as a length. Source: measured on the generated scenes.
        material_chroma: f64 = 0.1, [0.0001..=10.0], "", "";
    }
}
