//! glTF 2.0 (`.glb`, or `.gltf` with files beside it or data in it), by the crate `gltf`. In: bytes. Out: an
//! [`Object`](super::object::Object) with the triangles, colours and textures of every node of the scene.

mod accessor;
pub mod document;
mod resources;
