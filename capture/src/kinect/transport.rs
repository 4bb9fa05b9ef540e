//! The boundary between the driver and what carries it: a real USB stack ([`crate::kinect::usb`]) or a simulated Kinect
//! ([`crate::simulator`]). Below it transfers, above it the protocol.

use crate::kinect::packet_ring::PacketSink;
use firmware_config::kinect_models::{Model, Part};
use std::time::Duration;

/// What went wrong below the boundary, by what the caller can do about it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum UsbError {
    /// There is no such device, or no longer.
    #[error("no Kinect is plugged in; plug one in, and its power supply")]
    NoDevice,
    /// Only the motor shows, which lives on USB power alone.
    #[error("only the Kinect's motor shows on USB: its 12 V power supply is missing; plug it in")]
    NoPower,
    /// A Kinect V2 is plugged in, and no other.
    #[error("this is a Kinect V2, which is not supported; plug in a Kinect V1")]
    KinectV2,
    /// The system does not let this user open it.
    #[error(
        "the Kinect may not be opened by this user; install the udev rule and join group `lumiscan` (see capture/README.md)"
    )]
    Access,
    /// Another program holds it.
    #[error("another program uses the Kinect; end it")]
    Busy,
    /// No answer in time.
    #[error("the Kinect did not answer in time; unplug it and plug it in again")]
    Timeout,
    /// The bus has no room for its streams.
    #[error(
        "the kernel takes no stream of the Kinect: no bandwidth is left, or no memory for transfers; give it a USB 2 \
         controller of its own, and look what `lumiscan check` says of the usbfs memory"
    )]
    Bandwidth,
    /// Anything else.
    #[error("USB: {0}; unplug the Kinect and plug it in again")]
    Other(String),
}

/// A Kinect that is plugged in.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// Model.
    pub model: Model,
    /// Serial number; empty where it cannot be read.
    pub serial: String,
    /// Bus number.
    pub bus: u8,
    /// Ports from the root hub to the camera ("2.1").
    pub path: String,
    /// Device address on the bus.
    pub address: u8,
    /// True if the device node can be opened.
    pub accessible: bool,
}

/// Where devices are found.
pub trait Bus: Send {
    /// Every Kinect V1 camera that is plugged in.
    ///
    /// # Errors
    /// The USB stack fails (that there is none counts as an empty list), or something like a Kinect is there, but none
    /// that can be used.
    fn list(&mut self) -> Result<Vec<Found>, UsbError>;
    /// True while this one is plugged in; nothing is opened for it.
    fn is_here(&mut self, found: &Found) -> bool;
    /// Opens one of them.
    ///
    /// # Errors
    /// It is gone, held by another program, or not permitted.
    fn open(&mut self, found: &Found) -> Result<Box<dyn Transport>, UsbError>;
}

/// A vendor control transfer with `wIndex` 0.
#[derive(Debug, Clone, Copy)]
pub struct Setup {
    /// The device it goes to.
    pub part: Part,
    /// `bRequest`.
    pub request: u8,
    /// `wValue`.
    pub value: u16,
    /// Longest wait.
    pub limit: Duration,
}

/// One opened Kinect.
pub trait Transport: Send {
    /// Vendor control transfer to a part.
    ///
    /// # Errors
    /// As USB has them; [`UsbError::NoDevice`] where the Kinect has no such part.
    fn control_out(&mut self, setup: Setup, data: &[u8]) -> Result<(), UsbError>;
    /// Vendor control transfer from a part; returns the bytes read.
    ///
    /// # Errors
    /// As [`Transport::control_out`].
    fn control_in(&mut self, setup: Setup, data: &mut [u8]) -> Result<usize, UsbError>;
    /// Bulk transfer to the audio device's endpoint 0x01.
    ///
    /// # Errors
    /// As [`Transport::control_out`].
    fn bulk_out(&mut self, data: &[u8], limit: Duration) -> Result<(), UsbError>;
    /// Bulk transfer from the audio device's endpoint 0x81; returns the bytes read.
    ///
    /// # Errors
    /// As [`Transport::control_out`].
    fn bulk_in(&mut self, data: &mut [u8], limit: Duration) -> Result<usize, UsbError>;
    /// Selects an alternate setting of the camera's interface.
    ///
    /// # Errors
    /// As [`Transport::control_out`].
    fn select_alternate(&mut self, setting: u8) -> Result<(), UsbError>;
    /// Submits the isochronous transfers of the endpoints; what comes goes to `sink`.
    ///
    /// # Errors
    /// No bandwidth, or unplugged; nothing is in flight then.
    fn start(&mut self, endpoints: &[u8], sink: PacketSink) -> Result<(), UsbError>;
    /// Cancels the transfers and waits until none is in flight.
    fn stop(&mut self);
    /// True if the streams wait for who reads: only simulated ones can.
    fn waits(&self) -> bool;
    /// Time on the clock that limits are measured with.
    fn now(&self) -> Duration;
    /// Lets that clock go on.
    fn pause(&mut self, time: Duration);
}
