//! PrimeSense sensors and `.oni` files through OpenNI2 (feature `openni`): a source of frames.
//!
//! # Safety
//! The second file of this crate with `unsafe`, in builds with the feature only. Each block refers to a point of the
//! argument by number:
//!
//! 1. OpenNI2's C functions are called from the thread that owns the [`Device`] only; the library is initialised before
//!    the first of them, and shut down after the last, by [`Library`], of which there is one at a time.
//! 2. Handles are valid from the call that filled them in, which is checked, to their destruction in `drop`, streams
//!    before their device before the library.
//! 3. A frame is OpenNI2's until it is released. Its data is copied before that, no further than `dataSize` says.
#![allow(unsafe_code)]

use openni2_sys as ni;
use recordings::recording::Event;
use recordings::types::{
    CameraModel, ColorEncoding, ColorFrame, DepthFrame, Distortion, Intrinsics, Pose, Response, Sensor, TimestampNs,
};
use std::ffi::{CStr, CString, c_int, c_void};
use std::ptr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// OpenNI 2.2, major × 1000 + minor.
const API_VERSION: c_int = 2002;
/// Longest wait for a frame.
const FRAME_LIMIT: Duration = Duration::from_secs(3);
/// Pixels of the largest plausible image.
const MAX_PIXELS: usize = 4096 * 4096;

/// An error of OpenNI2, with the remedy.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("OpenNI2: {0}; plug the sensor in, or give an .oni file")]
pub struct OpenNiError(String);

static IN_USE: AtomicBool = AtomicBool::new(false);

/// The library, initialised.
struct Library;

impl Library {
    fn initialise() -> Result<Self, OpenNiError> {
        if IN_USE.swap(true, Ordering::AcqRel) {
            return Err(OpenNiError("another device is open".into()));
        }
        let library = Self;
        // SAFETY: (1).
        checked(unsafe { ni::oniInitialize(API_VERSION) })?;
        Ok(library)
    }
}

impl Drop for Library {
    fn drop(&mut self) {
        // SAFETY: (1), (2). Shutting down what was not initialised is allowed.
        unsafe { ni::oniShutdown() };
        IN_USE.store(false, Ordering::Release);
    }
}

fn checked(status: ni::OniStatus) -> Result<(), OpenNiError> {
    if status == ni::ONI_STATUS_OK {
        return Ok(());
    }
    // SAFETY: (1); the text is valid until the next call and ends with a zero.
    let text = unsafe {
        let text = ni::oniGetExtendedError();
        if text.is_null() { String::new() } else { CStr::from_ptr(text).to_string_lossy().trim().to_owned() }
    };
    Err(OpenNiError(if text.is_empty() { format!("status {status}") } else { text.replace('\n', " ") }))
}

/// A sensor or a file that plays. Fields are dropped in order: streams, device, library.
pub struct Device {
    depth: Stream,
    color: Option<Stream>,
    handle: Handle,
    is_file: bool,
    /// Depth frames of a file that are still to come.
    left: usize,
    sensor: Sensor,
    _library: Library,
}

struct Handle(ni::OniDeviceHandle);

// SAFETY: (1): it moves to the thread that uses it, with everything else of the `Device`.
unsafe impl Send for Handle {}

impl Drop for Handle {
    fn drop(&mut self) {
        // SAFETY: (2).
        unsafe { ni::oniDeviceClose(self.0) };
    }
}

struct Stream {
    handle: ni::OniStreamHandle,
    mode: ni::OniVideoMode,
}

// SAFETY: as for `Handle`.
unsafe impl Send for Stream {}

impl Drop for Stream {
    fn drop(&mut self) {
        // SAFETY: (2).
        unsafe {
            ni::oniStreamStop(self.handle);
            ni::oniStreamDestroy(self.handle);
        }
    }
}

impl Device {
    /// Opens a sensor by its address, the first one (an empty `address`), or an `.oni` file.
    ///
    /// # Errors
    /// There is none, it has no depth, or OpenNI2 and its drivers are not installed.
    pub fn open(address: &str) -> Result<Self, OpenNiError> {
        let library = Library::initialise()?;
        let text = CString::new(address).map_err(|_| OpenNiError("the address contains a zero byte".into()))?;
        let mut device = ptr::null_mut();
        // SAFETY: (1), (2); a null address means any device.
        checked(unsafe {
            ni::oniDeviceOpen(if address.is_empty() { ptr::null() } else { text.as_ptr() }, &raw mut device)
        })?;
        let handle = Handle(device);
        // SAFETY: (2).
        let is_file = unsafe { ni::oniDeviceIsPropertySupported(device, ni::ONI_DEVICE_PROPERTY_PLAYBACK_SPEED) } != 0;
        let depth = Stream::create(device, ni::ONI_SENSOR_DEPTH)?;
        let color = Stream::create(device, ni::ONI_SENSOR_COLOR).ok();
        if is_file {
            // Plays once, as fast as it is read.
            set_device(device, ni::ONI_DEVICE_PROPERTY_PLAYBACK_SPEED, &-1.0f32);
            set_device(device, ni::ONI_DEVICE_PROPERTY_PLAYBACK_REPEAT_ENABLED, &(0 as ni::OniBool));
        } else {
            // Depth registered to the colour camera, where the sensor can.
            let mode: c_int = ni::ONI_IMAGE_REGISTRATION_DEPTH_TO_COLOR as c_int;
            set_device(device, ni::ONI_DEVICE_PROPERTY_IMAGE_REGISTRATION, &mode);
        }
        let left = if is_file { frames_of(&depth) } else { usize::MAX };
        let sensor = describe(&depth, color.as_ref());
        for stream in [Some(&depth), color.as_ref()].into_iter().flatten() {
            // SAFETY: (2).
            checked(unsafe { ni::oniStreamStart(stream.handle) })?;
        }
        Ok(Self { depth, color, handle, is_file, left, sensor, _library: library })
    }

    /// The sensor.
    #[must_use]
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    /// True if it is a file, which waits for the reader.
    #[must_use]
    pub fn is_file(&self) -> bool {
        self.is_file && !self.handle.0.is_null()
    }

    /// The next frame of either stream; `None` at the end of a file, or when a sensor sends no more.
    ///
    /// # Errors
    /// The sensor is unplugged, or a frame is invalid.
    pub fn next_event(&mut self) -> Result<Option<Event>, OpenNiError> {
        if self.left == 0 {
            return Ok(None);
        }
        let mut handles = [self.depth.handle, self.color.as_ref().map_or(ptr::null_mut(), |c| c.handle)];
        let count = 1 + c_int::from(self.color.is_some());
        let (mut which, limit) = (0, FRAME_LIMIT.as_millis() as c_int);
        // SAFETY: (1), (2): as many handles as `count` states.
        let status = unsafe { ni::oniWaitForAnyStream(handles.as_mut_ptr(), count, &raw mut which, limit) };
        if status == ni::ONI_STATUS_TIME_OUT {
            return Ok(None);
        }
        checked(status)?;
        let is_depth = which == 0;
        let mut frame = ptr::null_mut();
        // SAFETY: (2), (3).
        unsafe {
            checked(ni::oniStreamReadFrame(handles[usize::from(!is_depth)], &raw mut frame))?;
            let event = if frame.is_null() { Err(OpenNiError("no frame".into())) } else { copied(&*frame, is_depth) };
            ni::oniFrameRelease(frame);
            self.left -= usize::from(is_depth);
            event.map(Some)
        }
    }
}

impl Stream {
    fn create(device: ni::OniDeviceHandle, sensor: ni::OniSensorType) -> Result<Self, OpenNiError> {
        let mut handle = ptr::null_mut();
        // SAFETY: (2).
        checked(unsafe { ni::oniDeviceCreateStream(device, sensor, &raw mut handle) })?;
        let zero = ni::OniVideoMode { pixelFormat: 0, resolutionX: 0, resolutionY: 0, fps: 0 };
        let mut stream = Self { handle, mode: zero };
        stream.mode = stream
            .property(ni::ONI_STREAM_PROPERTY_VIDEO_MODE, zero)
            .ok_or_else(|| OpenNiError("a stream without a format".into()))?;
        // Not mirrored.
        let off: ni::OniBool = 0;
        // SAFETY: (2); the value has the stated size. A stream without this property is not mirrored.
        unsafe {
            ni::oniStreamSetProperty(
                handle,
                ni::ONI_STREAM_PROPERTY_MIRRORING as c_int,
                (&raw const off).cast(),
                size_of_val(&off) as c_int,
            )
        };
        Ok(stream)
    }

    fn property<T: Copy>(&self, id: ni::OniStreamProperty, initial: T) -> Option<T> {
        let (mut value, mut size) = (initial, size_of::<T>() as c_int);
        // SAFETY: (2); OpenNI2 writes no more than `size` bytes, and only plain numbers are read.
        let status = unsafe {
            ni::oniStreamGetProperty(self.handle, id as c_int, (&raw mut value).cast::<c_void>(), &raw mut size)
        };
        (status == ni::ONI_STATUS_OK && size as usize == size_of::<T>()).then_some(value)
    }
}

/// Sets a property that not every device has.
fn set_device<T>(device: ni::OniDeviceHandle, id: ni::OniDeviceProperty, value: &T) {
    // SAFETY: (2); the value has the stated size.
    let status =
        unsafe { ni::oniDeviceSetProperty(device, id as c_int, ptr::from_ref(value).cast(), size_of::<T>() as c_int) };
    if status != ni::ONI_STATUS_OK {
        tracing::debug!("OpenNI2: property {id} is refused");
    }
}

fn frames_of(stream: &Stream) -> usize {
    stream.property(ni::ONI_STREAM_PROPERTY_NUMBER_OF_FRAMES, 0i32).map_or(usize::MAX, |n| n.max(0) as usize)
}

/// Intrinsics from the field of view that the sensor reports.
fn describe(depth: &Stream, color: Option<&Stream>) -> Sensor {
    let camera = |s: &Stream| {
        let (width, height) = (s.mode.resolutionX.max(0) as u32, s.mode.resolutionY.max(0) as u32);
        let fov = |id, fallback: f64| {
            let angle = s.property(id, 0f32).map(f64::from).filter(|a| (0.1..3.0).contains(a));
            angle.unwrap_or(fallback)
        };
        let focal = |size: u32, angle: f64| f64::from(size) / 2.0 / libm::tan(angle / 2.0);
        let intrinsics = Intrinsics {
            width,
            height,
            fx: focal(width, fov(ni::ONI_STREAM_PROPERTY_HORIZONTAL_FOV, 1.015)),
            fy: focal(height, fov(ni::ONI_STREAM_PROPERTY_VERTICAL_FOV, 0.789)),
            cx: f64::from(width) / 2.0 - 0.5,
            cy: f64::from(height) / 2.0 - 0.5,
        };
        CameraModel { intrinsics, distortion: Distortion::default() }
    };
    Sensor {
        name: "OpenNI2 sensor".into(),
        serial: String::new(),
        depth: camera(depth),
        color: camera(color.unwrap_or(depth)),
        color_from_depth: Pose::IDENTITY,
        depth_registered: true,
        depth_unit_m: if depth.mode.pixelFormat == ni::ONI_PIXEL_FORMAT_DEPTH_100_UM { 1e-4 } else { 1e-3 },
        response: Response::Srgb,
        depth_to_color_offset_ns: 0,
    }
}

/// Copies a frame.
///
/// # Safety
/// (3): the frame is not yet released.
unsafe fn copied(frame: &ni::OniFrame, is_depth: bool) -> Result<Event, OpenNiError> {
    let timestamp_ns: TimestampNs = i64::try_from(frame.timestamp).unwrap_or(i64::MAX).saturating_mul(1000);
    let (width, height) = (frame.width.max(0) as usize, frame.height.max(0) as usize);
    let (stride, size) = (frame.stride.max(0) as usize, frame.dataSize.max(0) as usize);
    let format = frame.videoMode.pixelFormat;
    let pixel = match (is_depth, format) {
        (true, ni::ONI_PIXEL_FORMAT_DEPTH_1_MM | ni::ONI_PIXEL_FORMAT_DEPTH_100_UM) => 2,
        (false, ni::ONI_PIXEL_FORMAT_RGB888) => 3,
        (false, ni::ONI_PIXEL_FORMAT_GRAY8) => 1,
        _ => return Err(OpenNiError(format!("pixel format {format} is not supported"))),
    };
    let fits = width > 0 && height > 0 && width <= MAX_PIXELS / height && stride >= width * pixel;
    if !fits || frame.data.is_null() || size < stride * (height - 1) + width * pixel {
        return Err(OpenNiError(format!("a frame of {width}×{height} in {size} bytes")));
    }
    // SAFETY: (3).
    let data = unsafe { std::slice::from_raw_parts(frame.data.cast::<u8>(), size) };
    let rows = data.chunks(stride).take(height).map(|row| &row[..width * pixel]);
    let (width, height) = (width as u32, height as u32);
    if is_depth {
        let depth = rows.flat_map(|r| r.chunks_exact(2)).map(|b| u16::from_le_bytes([b[0], b[1]])).collect();
        return Ok(Event::Depth(DepthFrame { timestamp_ns, width, height, depth, missing_packets: 0 }));
    }
    let bytes = match pixel {
        1 => rows.flatten().flat_map(|&v| [v; 3]).collect(),
        _ => rows.flatten().copied().collect(),
    };
    let encoding = ColorEncoding::Rgb;
    Ok(Event::Color(ColorFrame { timestamp_ns, width, height, encoding, bytes, missing_packets: 0 }))
}
