//! Tracking.

pub mod align;
pub mod anchors;
pub mod effort;
pub mod rotate;
pub mod timing;
