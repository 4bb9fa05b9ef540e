//! The machine's USB buses through libusb (`rusb`): enumeration, opening, control and bulk transfers.

use crate::kinect::frame_queue::PacketSink;
use crate::kinect::isochronous::Streams;
use crate::kinect::transport::{Bus, Found, Setup, Transport, UsbError};
use firmware_config::kinect_models::{Model, Part, part_of};
use rusb::{Context, Device, DeviceHandle, Direction, Recipient, RequestType, UsbContext, request_type};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Interface of every part.
const INTERFACE: u8 = 0;
/// Interfaces of an audio device with firmware; with fewer it is a boot loader, which would take commands for firmware pages.
const AUDIO_INTERFACES: u8 = 2;
/// Longest wait for a string descriptor.
const STRING_LIMIT: Duration = Duration::from_millis(500);

/// The machine's USB buses.
#[derive(Default)]
pub struct UsbBus {
    context: Option<Context>,
}

impl UsbBus {
    /// `None` on a machine without USB; tried again at the next call.
    fn context(&mut self) -> Option<&Context> {
        if self.context.is_none() {
            self.context = Context::new().inspect_err(|e| tracing::debug!("libusb: {e}")).ok();
        }
        self.context.as_ref()
    }

    /// Every device that is a part of a Kinect.
    fn parts(&mut self) -> Vec<(Part, Device<Context>)> {
        let Some(devices) = self.context().and_then(|c| c.devices().ok()) else { return Vec::new() };
        let part = |d: &Device<Context>| {
            let descriptor = d.device_descriptor().ok()?;
            part_of(descriptor.vendor_id(), descriptor.product_id())
        };
        devices.iter().filter_map(|d| part(&d).map(|p| (p, d))).collect()
    }
}

impl Bus for UsbBus {
    fn list(&mut self) -> Result<Vec<Found>, UsbError> {
        let mut parts = self.parts();
        let has = |parts: &[(Part, Device<Context>)], part| parts.iter().any(|(p, _)| *p == part);
        if !has(&parts, Part::Camera) {
            // Hotplug events may not arrive (containers); a new context enumerates again.
            self.context = None;
            parts = self.parts();
        }
        let cameras = parts.iter().filter(|(part, _)| *part == Part::Camera);
        let all: Vec<_> = cameras.filter_map(|(_, device)| found(device, &parts)).collect();
        match all.is_empty() {
            true if has(&parts, Part::KinectV2) => Err(UsbError::KinectV2),
            true if has(&parts, Part::Motor) => Err(UsbError::NoPower),
            _ => Ok(all),
        }
    }

    fn is_here(&mut self, found: &Found) -> bool {
        let is_it = |d: &Device<Context>| (d.bus_number(), d.address()) == (found.bus, found.address);
        self.parts().iter().any(|(p, d)| *p == Part::Camera && is_it(d))
    }

    fn open(&mut self, found: &Found) -> Result<Box<dyn Transport>, UsbError> {
        let parts = self.parts();
        let is_it = |d: &Device<Context>| (d.bus_number(), d.address()) == (found.bus, found.address);
        let (_, device) = parts.iter().find(|(p, d)| *p == Part::Camera && is_it(d)).ok_or(UsbError::NoDevice)?;
        let camera = claim(device)?;
        let usable = |part: Part, d: &Device<Context>| {
            part != Part::Audio || d.active_config_descriptor().is_ok_and(|c| c.num_interfaces() >= AUDIO_INTERFACES)
        };
        let auxiliary =
            |part: Part| sibling(device, &parts, part).filter(|d| usable(part, d)).and_then(|d| claim(d).ok());
        let (motor, audio) =
            if found.model == Model::K1414 { (auxiliary(Part::Motor), None) } else { (None, auxiliary(Part::Audio)) };
        Ok(Box::new(UsbKinect {
            camera: Arc::new(camera),
            motor,
            audio,
            streams: None,
            alternate: 0,
            opened: Instant::now(),
        }))
    }
}

fn found(camera: &Device<Context>, parts: &[(Part, Device<Context>)]) -> Option<Found> {
    let descriptor = camera.device_descriptor().ok()?;
    let version = descriptor.device_version();
    let release = u16::from(version.major()) << 8 | u16::from(version.minor()) << 4 | u16::from(version.sub_minor());
    let model = Model::of_camera(descriptor.product_id(), release)?;
    let opened = camera.open();
    let own = opened.as_ref().ok().and_then(|h| serial_of(camera, h));
    // Cameras of later models report zeros; their audio device has the number.
    let serial = own.filter(|s| s.bytes().any(|b| b != b'0')).or_else(|| {
        let audio = sibling(camera, parts, Part::Audio)?;
        serial_of(audio, &audio.open().ok()?)
    });
    let ports = camera.port_numbers().unwrap_or_default();
    Some(Found {
        model,
        serial: serial.unwrap_or_default(),
        bus: camera.bus_number(),
        path: ports.iter().map(u8::to_string).collect::<Vec<_>>().join("."),
        address: camera.address(),
        accessible: opened.is_ok(),
    })
}

fn serial_of(device: &Device<Context>, handle: &DeviceHandle<Context>) -> Option<String> {
    let descriptor = device.device_descriptor().ok()?;
    descriptor.serial_number_string_index()?;
    let language = *handle.read_languages(STRING_LIMIT).ok()?.first()?;
    let text = handle.read_serial_number_string(language, &descriptor, STRING_LIMIT).ok()?;
    Some(text.chars().filter(char::is_ascii_graphic).take(64).collect())
}

/// Another part of the same Kinect: the one below the same hub, else the only one on the same bus, else the only one.
fn sibling<'a>(
    camera: &Device<Context>,
    parts: &'a [(Part, Device<Context>)],
    part: Part,
) -> Option<&'a Device<Context>> {
    let hub = |d: &Device<Context>| {
        let mut ports = d.port_numbers().ok()?;
        ports.pop()?;
        Some((d.bus_number(), ports))
    };
    let all: Vec<_> = parts.iter().filter(|(p, _)| *p == part).map(|(_, d)| d).collect();
    let on_bus: Vec<_> = all.iter().copied().filter(|d| d.bus_number() == camera.bus_number()).collect();
    let home = hub(camera);
    let below_same_hub = all.iter().copied().find(|d| home.is_some() && hub(d) == home);
    let only = |some: &[&'a Device<Context>]| if let [one] = some { Some(*one) } else { None };
    below_same_hub.or_else(|| only(&on_bus)).or_else(|| only(&all))
}

/// Opens a part and claims its interface; detaches the kernel's driver until the handle is dropped.
fn claim(device: &Device<Context>) -> Result<DeviceHandle<Context>, UsbError> {
    let handle = device.open().map_err(from_rusb)?;
    // Not supported on every system.
    let _ = handle.set_auto_detach_kernel_driver(true);
    handle.claim_interface(INTERFACE).map_err(from_rusb)?;
    Ok(handle)
}

fn from_rusb(e: rusb::Error) -> UsbError {
    match e {
        rusb::Error::NoDevice | rusb::Error::NotFound => UsbError::NoDevice,
        rusb::Error::Access => UsbError::Access,
        rusb::Error::Busy => UsbError::Busy,
        rusb::Error::Timeout => UsbError::Timeout,
        other => UsbError::Other(other.to_string()),
    }
}

/// An opened Kinect. Fields are dropped in order: the streams before the handle they run on.
struct UsbKinect {
    streams: Option<Streams>,
    camera: Arc<DeviceHandle<Context>>,
    motor: Option<DeviceHandle<Context>>,
    audio: Option<DeviceHandle<Context>>,
    /// Alternate setting of the camera's interface.
    alternate: u8,
    opened: Instant,
}

impl UsbKinect {
    fn part(&self, part: Part) -> Result<&DeviceHandle<Context>, UsbError> {
        match part {
            Part::Camera => Ok(&self.camera),
            Part::Motor => self.motor.as_ref().ok_or(UsbError::NoDevice),
            Part::Audio => self.audio.as_ref().ok_or(UsbError::NoDevice),
            Part::KinectV2 => Err(UsbError::NoDevice),
        }
    }
}

impl Transport for UsbKinect {
    fn control_out(&mut self, setup: Setup, data: &[u8]) -> Result<(), UsbError> {
        let kind = request_type(Direction::Out, RequestType::Vendor, Recipient::Device);
        let part = self.part(setup.part)?;
        let n = part.write_control(kind, setup.request, setup.value, 0, data, setup.limit).map_err(from_rusb)?;
        if n == data.len() { Ok(()) } else { Err(UsbError::Other(format!("{n} of {} bytes were sent", data.len()))) }
    }

    fn control_in(&mut self, setup: Setup, data: &mut [u8]) -> Result<usize, UsbError> {
        let kind = request_type(Direction::In, RequestType::Vendor, Recipient::Device);
        let part = self.part(setup.part)?;
        part.read_control(kind, setup.request, setup.value, 0, data, setup.limit).map_err(from_rusb)
    }

    fn bulk_out(&mut self, data: &[u8], limit: Duration) -> Result<(), UsbError> {
        self.part(Part::Audio)?.write_bulk(0x01, data, limit).map(|_| ()).map_err(from_rusb)
    }

    fn bulk_in(&mut self, data: &mut [u8], limit: Duration) -> Result<usize, UsbError> {
        self.part(Part::Audio)?.read_bulk(0x81, data, limit).map_err(from_rusb)
    }

    fn select_alternate(&mut self, setting: u8) -> Result<(), UsbError> {
        self.camera.set_alternate_setting(INTERFACE, setting).map_err(from_rusb)?;
        self.alternate = setting;
        Ok(())
    }

    fn start(&mut self, endpoints: &[u8], sink: PacketSink) -> Result<(), UsbError> {
        self.stop();
        self.streams = Some(Streams::start(&self.camera, (INTERFACE, self.alternate), endpoints, sink, self.opened)?);
        Ok(())
    }

    fn stop(&mut self) {
        // Its `drop` cancels and drains.
        self.streams = None;
    }

    fn waits(&self) -> bool {
        false
    }

    fn now(&self) -> Duration {
        self.opened.elapsed()
    }

    fn pause(&mut self, time: Duration) {
        std::thread::sleep(time);
    }
}
