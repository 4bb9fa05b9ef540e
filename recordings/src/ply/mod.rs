//! PLY meshes. In: files of every format and property order. Out: a [`Mesh`](crate::types::Mesh) and further per-vertex
//! columns; and the way back, as binary little-endian.

pub mod read;
pub mod write;
