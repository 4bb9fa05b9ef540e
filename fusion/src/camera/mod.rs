//! The sensor's geometry.

pub mod rig;
pub mod rolling_shutter;
