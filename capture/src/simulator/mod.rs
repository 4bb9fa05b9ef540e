//! A simulated Kinect behind the driver's transport boundary, with seeded faults. In: a [`plan`] (`--simulate`) and pictures
//! ([`scenery`]). Out: a [`bus`] whose [`device`] answers commands, registers and calibration and whose [`stream`] sends
//! isochronous packets.

pub mod bus;
pub mod calibration;
pub mod depth_encoder;
mod device;
pub mod plan;
mod random;
mod scenery;
mod shared;
mod stream;
