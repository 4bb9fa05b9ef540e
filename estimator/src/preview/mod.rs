//! The preview sheet. In: a scan and its result. Out: one PNG with a keyframe, its re-rendering, albedo, segments, gloss
//! and light, and the facts of the result ([`sheet`]).

pub mod canvas;
mod color;
pub(crate) mod font;
mod keyframe_view;
mod lamps;
pub mod sheet;
mod spheres;
mod vertex_light;
