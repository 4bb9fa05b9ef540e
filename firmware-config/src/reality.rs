//! Settings of mixed-reality rendering.

use crate::settings::section;

section! {
    /// Inserting, removing, relighting.
    RealityConfig = "reality" {
        /// Rays for the light that arrives at a vertex near a change.
        vertex_rays: u32 = 128, [8..=65536], "", "";
        /// Rays for how that light changes.
        change_rays: u32 = 64, [8..=65536], "", "";
        /// Rays for the light that arrives at a vertex of an inserted object.
        object_rays: u32 = 64, [8..=65536], "", "";
        /// Rays per pixel for how the light on a kept surface changes.
        pixel_change_rays: u32 = 32, [4..=65536], "", "";
        /// Rays per pixel for light on surfaces that were not in the picture before.
        pixel_rays: u32 = 256, [16..=65536], "", "";
        /// Samples within a pixel where an inserted object shows.
        pixel_samples: u32 = 16, [1..=256], "", "";
        /// Blur of the camera: standard deviation of a pixel's footprint.
        camera_blur_px: f64 = 0.65, [0.0..=5.0], "px", "";
        /// Surface nearer to a removed object than this has its colour continued from farther away.
        contact_edges: f64 = 2.5, [0.0..=50.0], "edges", "";
        /// Rays per vertex for the transfer that relighting keeps.
        relight_rays: u32 = 256, [8..=65536], "", "N";
        /// Pixels by which a removed object's outline grows: its blur and the error of its pose.
        removal_margin_px: u32 = 5, [0..=32], "px", "";
        /// Seed of every random direction.
        seed: u32 = 1, [0..=4294967295], "", "";
    } with crate::tuning::RealityTuning
}
