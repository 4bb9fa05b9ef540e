//! How bytes are laid out. In: chunks of files, pixels, vertices, triangles. Out: the append-only chunk container
//! ([`chunk`]), lossless depth ([`depth`]), PNG and JPEG ([`image`]), packed vertices and connectivity.

pub mod chunk;
pub mod connectivity;
pub mod depth;
pub mod digest;
pub mod exclusive;
pub(crate) mod header;
pub mod image;
pub mod pack;
pub mod vertices;
