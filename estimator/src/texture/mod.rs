//! Albedo at the resolution of the photographs. In: mesh, keyframes with refined poses and exposures, lit colour and albedo at the
//! vertices. Out: [`Texture`](recordings::result::Texture), an atlas of orthographic charts.
//!
//! The mesh is cut into [`charts`] that see little distortion, these are [`pack`]ed into an [`atlas`] page; [`views`] are sampled at
//! every texel and blended in [`texels`]; [`filling`] divides that by the light at the vertices, [`albedo`] makes the picture. [`detail`] reads a
//! texture back, [`seams`] cuts the mesh for programs with one texture coordinate per vertex, [`sharpness`] measures
//! what a rendering keeps of a picture.

pub mod albedo;
pub mod atlas;
pub mod charts;
pub mod detail;
pub mod filling;
pub mod mutual;
pub mod pack;
pub mod registration;
pub mod seams;
pub mod sharpness;
pub mod texels;
pub mod views;
