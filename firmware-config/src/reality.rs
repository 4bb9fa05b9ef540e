//! Settings of mixed-reality rendering.

use crate::settings::section;

section! {
    /// Insertion, removal, relighting.
    RealityConfig = "reality" {
        /// Rays per vertex near a change, for the incident light.
        vertex_rays: u32 = 128, [8..=65536], "", "";
        /// Rays per vertex near a change, for the change of the incident light.
        change_rays: u32 = 64, [8..=65536], "", "";
        /// Rays per vertex of an inserted object, for the incident light.
        object_rays: u32 = 64, [8..=65536], "", "";
        /// Rays per pixel for the change of light on an unchanged surface.
        pixel_change_rays: u32 = 32, [4..=65536], "", "";
        /// Rays per pixel for the light on surfaces that the image did not show before.
        pixel_rays: u32 = 256, [16..=65536], "", "";
        /// Samples per pixel that shows an inserted object.
        pixel_samples: u32 = 16, [1..=256], "", "";
        /// Blur of the camera: standard deviation of the pixel response.
        camera_blur_px: f64 = 0.65, [0.0..=5.0], "px", "";
        /// Surface closer to a removed object than this takes its colour from farther away.
        contact_edges: f64 = 2.5, [0.0..=50.0], "edges", "";
        /// Rays per vertex for the transfer of relighting.
        relight_rays: u32 = 256, [8..=65536], "", "N";
        /// Margin around the outline of a removed object, for blur and pose errors.
        removal_margin_px: u32 = 5, [0..=32], "px", "";
        /// Seed of all random directions.
        seed: u32 = 1, [0..=4294967295], "", "";
    } with crate::tuning::RealityTuning
}
