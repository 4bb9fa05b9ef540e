//! Mixed reality (§4.1). In: a result, its keyframe pictures, objects to insert, parts to remove, new light. Out: pictures.
//!
//! [`objects`] are read and placed, [`removal`] selects vertices, [`inpainting`] closes what they hid, [`lighting`]
//! completes the light; [`change`] builds the [`before_after_scene`]; [`compose`] renders its difference over a picture
//! (differential rendering, Debevec 1998), [`relight`] renders it under another light (precomputed radiance transfer,
//! Sloan et al. 2002).

pub mod before_after_scene;
pub mod bounding_sphere;
pub mod change;
pub mod compose;
pub mod error;
pub mod inpainting;
pub mod lighting;
mod local_light;
pub mod objects;
pub mod relight;
pub mod removal;
pub mod sampling;
pub mod surface_detail;
pub mod view;
