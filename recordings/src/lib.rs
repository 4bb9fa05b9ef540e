//! Everything Lumiscan writes to disk: the chunk container, RGB-D recordings (`.lrec`), scans (`.lscan`), results
//! (`.lres`), the types in them, and the importers.

mod camera;
pub mod codec;
pub mod decision;
pub mod decision_text;
pub mod error;
pub mod import;
pub mod ply;
pub mod recording;
pub mod result;
#[cfg(test)]
mod samples;
pub mod scan;
pub mod source;
#[cfg(test)]
mod testing;
pub mod types;
mod v1;

pub use crate::codec::chunk::crc32_of_file;
pub use crate::error::{Error, Result};
pub use crate::import::lists::{format_seconds, parse_seconds};
