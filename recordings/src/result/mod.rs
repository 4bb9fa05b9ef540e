//! Results (`.lres`): the estimator's answer, with the decisions behind it, and its file form.

pub(crate) mod estimate;
mod file;
mod origin;
mod texture;

pub use estimate::{Estimate, Light, ResultKeyframe, Segment, WitnessError};
pub use origin::Origin;
pub use texture::{Chart, MAX_TEXTURE_SIDE, Texture};
