//! Scans (`.lscan`): the mesh and keyframes that fusion gives to the estimator, and their file form.

pub(crate) mod contents;
mod file;
mod identity;

pub use contents::{CaptureStats, FrameId, KeptFrame, Scan, ScanSource, ScanTail};
pub use file::ScanWriter;
pub use identity::ScanIdentity;
