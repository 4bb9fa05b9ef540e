//! The Kinect V1 driver. In: USB transfers. Out: depth and colour frames with device time stamps, and accelerometer readings.
//!
//! [`usb`] finds and opens devices, [`isochronous`] receives packets into the [`packet_ring`]; [`transport`] is the boundary
//! to a simulated device. [`packet_assembler`] makes frames of packets, [`depth_unpacking`] and [`registration`] make depth
//! images of raw frames ([`depth_decoder`]), [`clock`] unwraps time stamps, [`decoder`] joins them. [`protocol`] sends
//! commands and reads the [`calibration`], [`driver`] opens, starts and stops one device, [`live`] runs a session.

pub mod calibration;
mod clock;
pub mod decoder;
pub mod depth_decoder;
mod depth_unpacking;
pub mod driver;
mod isochronous;
pub mod live;
pub mod packet_assembler;
pub mod packet_ring;
pub mod protocol;
pub mod registration;
pub mod transport;
pub mod usb;
