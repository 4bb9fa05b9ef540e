//! The Kinect V1 driver. In: USB transfers ([`usb`], [`transport`]). Out: depth and colour frames with device time stamps:
//! isochronous packets are assembled ([`packet`]), decoded ([`decoder`], [`depth`]) and delivered by [`live`]; [`protocol`]
//! holds the commands, [`driver`] opens and configures the device.

pub mod clock;
pub mod decoder;
pub mod depth;
pub mod driver;
pub mod live;
pub mod packet;
pub mod protocol;
pub mod transport;
pub mod usb;
