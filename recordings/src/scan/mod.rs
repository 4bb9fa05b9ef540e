//! Scans (`.lscan`): the mesh and keyframes that fusion gives to the estimator, and their file form.

pub(crate) mod contents;
mod file;

pub use contents::{CaptureStats, FrameId, KeptFrame, Scan, ScanSource, ScanTail};
pub use file::ScanWriter;
