//! Results in the formats of other tools. In: a result, for pictures its scan. Out: a folder of plain files ([`folder`]),
//! PLY, glTF ([`glb`]), panoramas ([`hdr`]), COLMAP and NeRF cameras ([`cameras`]), a page for browsers ([`html`]).

pub mod cameras;
mod file;
pub mod folder;
pub mod glb;
pub mod hdr;
pub mod html;
mod html_lamps;
pub mod obj;
pub mod picture;
pub mod ply;
#[cfg(test)]
pub(crate) mod testing;
