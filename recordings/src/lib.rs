//! Everything Lumiscan writes to disk: the chunk container, RGB-D recordings (`.lrec`), scans (`.lscan`), results
//! (`.lres`), the types in them, and the importers.

mod camera;
mod decode;
pub mod error;
mod lists;
pub mod photos;
pub mod recording;
pub mod result;
pub mod scan;
pub mod tum;
pub mod types;

pub use error::{Error, Result};
pub use lists::{format_seconds, parse_seconds};

#[cfg(test)]
mod testing;
