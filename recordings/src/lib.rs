//! Everything Lumiscan writes to disk: the chunk container, RGB-D recordings (`.lrec`), scans (`.lscan`), results
//! (`.lres`), the types in them, and the importers.
//!
//! ```
//! use recordings::recording::{Event, RecordingReader};
//!
//! let path = concat!(env!("CARGO_MANIFEST_DIR"), "/data/tiny.lrec");
//! let mut reader = RecordingReader::open(path.as_ref())?;
//! assert_eq!(reader.sensor().depth.intrinsics.width, 160);
//! let mut depth_frames = 0;
//! while let Some(event) = reader.next_event()? {
//!     if let Event::Depth(frame) = event {
//!         assert_eq!(frame.depth.len(), 160 * 120);
//!         depth_frames += 1;
//!     }
//! }
//! assert_eq!(depth_frames, 6);
//! # Ok::<(), recordings::Error>(())
//! ```

mod camera;
pub mod codec;
pub mod decision;
pub mod decision_text;
pub mod error;
pub mod import;
pub mod local_light;
pub mod ply;
pub mod recording;
pub mod result;
#[cfg(test)]
mod samples;
pub mod scan;
pub mod shoulder;
pub mod source;
#[cfg(test)]
mod testing;
pub mod types;
mod v1;

pub use crate::codec::chunk::crc32_of_file;
pub use crate::codec::digest::sha256;
pub use crate::error::{Error, Result};
pub use crate::import::lists::{format_seconds, parse_seconds};
