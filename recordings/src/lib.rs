//! Everything Lumiscan writes to disk: the chunk container, RGB-D recordings (`.lrec`), scans (`.lscan`), results
//! (`.lres`), the types in them, and the importers.

mod camera;
pub mod chunk;
mod connectivity;
mod decode;
mod depth_codec;
pub mod error;
mod lists;
mod pack;
pub mod photos;
pub mod ply;
pub mod recording;
pub mod result;
pub mod scan;
pub mod source;
pub mod synth;
pub mod tum;
pub mod types;
mod v1;
mod vertices;

pub use chunk::crc32_of_file;
pub use error::{Error, Result};
pub use lists::{format_seconds, parse_seconds};

#[cfg(test)]
mod samples;
#[cfg(test)]
mod testing;
