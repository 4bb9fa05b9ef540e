//! The boundary between the driver and what carries it: a real USB stack ([`crate::kinect::usb`]) or a simulated Kinect
//! ([`crate::simulator`]). Below it transfers, above it the protocol.

use crate::kinect::frame_queue::PacketSink;
use firmware_config::kinect_models::{Model, Part};
use std::time::Duration;

/// What went wrong below the boundary, by what the caller can do about it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}; {}", self.problem(), self.remedy())]
pub enum UsbError {
    /// There is no such device, or no longer.
    NoDevice,
    /// Only the motor, which runs on USB power, is there.
    NoPower,
    /// A Kinect V2 is plugged in, and no other.
    KinectV2,
    /// The system does not let this user open it.
    Access,
    /// Another program holds it.
    Busy,
    /// No answer in time.
    Timeout,
    /// The bus has no room for its streams.
    Bandwidth,
    /// Anything else.
    Other(String),
}

impl UsbError {
    /// What is wrong.
    #[must_use]
    pub fn problem(&self) -> String {
        match self {
            Self::NoDevice => "no Kinect is plugged in".into(),
            Self::NoPower => "only the Kinect's motor shows on USB: its 12 V power supply is missing".into(),
            Self::KinectV2 => "this is a Kinect V2, which is not supported".into(),
            Self::Access => "this user may not open the Kinect".into(),
            Self::Busy => "another program uses the Kinect".into(),
            Self::Timeout => "the Kinect did not answer in time".into(),
            Self::Bandwidth => {
                "the kernel refuses the Kinect's streams: no bandwidth or no transfer memory is left".into()
            }
            Self::Other(detail) => format!("USB: {detail}"),
        }
    }

    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::NoDevice => "plug one in, and its power supply",
            Self::NoPower => "plug it in",
            Self::KinectV2 => "plug in a Kinect V1",
            Self::Access => "install the udev rule and join group `lumiscan` (see capture/README.md)",
            Self::Busy => "end it",
            Self::Timeout | Self::Other(_) => "unplug the Kinect and plug it in again",
            Self::Bandwidth => {
                "give it a USB 2 controller of its own, and check the usbfs memory with `lumiscan check`"
            }
        }
    }
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

/// A set of buses with devices.
pub trait Bus: Send {
    /// Every Kinect V1 camera that is plugged in.
    ///
    /// # Errors
    /// The USB stack fails (its absence gives an empty list), or only an unusable Kinect is there.
    fn list(&mut self) -> Result<Vec<Found>, UsbError>;
    /// True while this one is plugged in; opens nothing.
    fn is_here(&mut self, found: &Found) -> bool;
    /// Opens one of them.
    ///
    /// # Errors
    /// It is gone, in use by another program, or access is denied.
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
    /// Any [`UsbError`]; `NoDevice` where the Kinect has no such part.
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
    /// Submits the isochronous transfers of the endpoints, whose packets go to `sink`.
    ///
    /// # Errors
    /// No bandwidth, or unplugged; nothing is in flight then.
    fn start(&mut self, endpoints: &[u8], sink: PacketSink) -> Result<(), UsbError>;
    /// Cancels the transfers and waits until none is in flight.
    fn stop(&mut self);
    /// True if the streams wait for the reader, which only simulated ones can.
    fn waits(&self) -> bool;
    /// Time on the clock that timeouts use.
    fn now(&self) -> Duration;
    /// Lets that clock advance.
    fn pause(&mut self, time: Duration);
}
