//! The sensor's geometry: projection, lens, depth correction, rolling shutter, world frame.
//!
//! In: the sensor's description ([`recordings::types::Sensor`]) and the depth correction of the settings. Out: [`rig::Rig`],
//! everything about the sensor that stays the same during a scan. Camera axes are +X right, +Y down, +Z forward.

pub mod depth_correction;
pub mod lens;
pub mod pinhole;
pub mod rig;
pub mod rolling_shutter;
pub mod twist;
pub mod world_frame;
