//! Objects: a surface with materials. In: object files (glTF, PLY), or a scan's result or parts of it. Out: an
//! [`object::Object`], placed in the scan's world, that rays and light can meet.

pub mod gltf;
pub mod insert;
pub mod material;
pub mod object;
pub mod ply;
mod support;
