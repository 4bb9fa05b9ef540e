//! A lamp at infinity beside the harmonics, whose bands hold no shadows as sharp as it casts.

use recordings::local_light::Lamp;

/// The sun: one direction of the light with a transfer of its own.
#[derive(Debug, Clone)]
pub struct Sun {
    /// Where it stands, and what it radiates where its coefficient is 1.
    pub lamp: Lamp,
    /// Irradiance over π straight from it at that coefficient: `[vertex]`.
    pub direct: Vec<f32>,
}
