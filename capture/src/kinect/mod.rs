//! The Kinect V1 driver. In: USB transfers. Out: depth and colour frames with device time stamps, and accelerometer readings.
//!
//! [`usb`] finds and opens devices, [`isochronous`] receives packets; [`transport`] is the boundary to a simulated device.
//! [`packet_assembler`] makes frames of packets where they arrive, [`frame_queue`] hands them over in [`buffers`] that come
//! back. [`depth_unpacking`] and [`registration`] make depth images of raw frames ([`depth_decoder`]), [`clock`] unwraps time
//! stamps, [`decoder`] joins them. [`protocol`] sends commands and reads the [`calibration`], [`driver`] opens, starts and
//! stops one device, [`live`] runs a session.

pub mod buffers;
pub mod calibration;
mod clock;
pub mod decoder;
pub mod depth_decoder;
mod depth_unpacking;
pub mod driver;
pub mod frame_queue;
mod isochronous;
pub mod live;
pub mod packet_assembler;
pub mod protocol;
pub mod registration;
pub mod transport;
pub mod usb;
