//! What programs and the page itself ask for and order; `capture/API.md` describes it.

pub mod device;
pub mod files;
pub mod live;
pub mod ranges;
pub mod render;
pub mod scan;
pub mod scans;
pub mod status;
