//! One Kinect: opening, calibration, start and stop of the streams, LED, accelerometer and exposure register.

use crate::kinect::frame_queue::FrameSource;
use crate::kinect::protocol::{Commands, KinectError};
use crate::kinect::transport::{Bus, Found, Setup, Transport, UsbError};
use firmware_config::KinectConfig;
use firmware_config::kinect_models::{BAYER_SXGA, BAYER_VGA, DEPTH_10, DEPTH_11, Model, Part, StreamFormat};
use recordings::types::UsbPacket;
use std::time::Duration;

/// Motor request: LED; the value is its state.
const SET_LED: u8 = 0x06;
/// Motor request: tilt and accelerometer.
const MOTOR_STATE: u8 = 0x32;
/// RGB sensor register of the shutter width.
const SHUTTER_WIDTH: u16 = 0x0009;
/// Microseconds per unit of the shutter width, for Bayer at 30 Hz.
const SHUTTER_UNIT_US: f64 = 54.21;
/// Minimum time between two readings of the shutter width: at most two commands per second.
const SHUTTER_INTERVAL: Duration = Duration::from_millis(500);
/// Longest wait for LED, accelerometer or exposure while packets queue up.
const AUXILIARY_TIMEOUT: Duration = Duration::from_millis(100);
/// The same while nothing streams.
const IDLE_AUXILIARY_TIMEOUT: Duration = Duration::from_millis(500);
/// Failures in a row after which LED and accelerometer are no longer used.
const AUXILIARY_FAILURES: u32 = 3;
/// Replies to earlier commands that are skipped before the expected one counts as missing.
const AUDIO_REPLIES: u32 = 4;
/// Accelerometer counts per g.
const COUNTS_PER_G: f32 = 819.0;
/// Standard gravity, m/s².
const GRAVITY: f32 = 9.806_65;

/// State that the LED shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Led {
    /// Ready: green.
    Ready,
    /// Scanning: blinking green.
    Scanning,
    /// Processing a scan, not available: yellow, or off where there is no yellow.
    Busy,
    /// Error: red.
    Error,
}

/// An opened Kinect.
pub struct Kinect {
    usb: Box<dyn Transport>,
    found: Found,
    commands: Commands,
    depth: &'static StreamFormat,
    color: &'static StreamFormat,
    streaming: bool,
    auxiliary: Auxiliary,
    last_shutter: Option<Duration>,
}

/// The device with LED and accelerometer: motor or audio.
#[derive(Debug)]
struct Auxiliary {
    /// The device; `None` where there is none, or after repeated failures.
    part: Option<Part>,
    failures: u32,
    tag: u32,
}

impl Kinect {
    /// Opens the Kinect with this serial number, or the first one if `serial` is empty.
    ///
    /// # Errors
    /// There is none, access is denied, or it does not answer as a Kinect does.
    pub fn open(bus: &mut dyn Bus, serial: &str, config: &KinectConfig) -> Result<Self, KinectError> {
        let found = choose(&bus.list()?, serial)?;
        let mut usb = bus.open(&found)?;
        if let Some(setting) = found.model.alternate_setting() {
            usb.select_alternate(setting)?;
        }
        // Tags differ from those of an earlier session, whose replies may still be queued.
        let first_tag = std::process::id() as u16 ^ usb.now().as_micros() as u16;
        let mut commands = Commands::new(Duration::from_millis(u64::from(config.command_limit_ms)), first_tag);
        commands.read_calibration(usb.as_mut())?;
        Ok(Self {
            usb,
            commands,
            depth: if config.depth_bits == 10 { &DEPTH_10 } else { &DEPTH_11 },
            color: if config.color_sxga { &BAYER_SXGA } else { &BAYER_VGA },
            streaming: false,
            auxiliary: Auxiliary {
                part: Some(if found.model == Model::K1414 { Part::Motor } else { Part::Audio }),
                failures: 0,
                tag: 1,
            },
            found,
            last_shutter: None,
        })
    }

    /// The device.
    #[must_use]
    pub fn found(&self) -> &Found {
        &self.found
    }

    /// Format of its depth stream.
    #[must_use]
    pub fn depth_format(&self) -> &'static StreamFormat {
        self.depth
    }

    /// Format of its colour stream.
    #[must_use]
    pub fn color_format(&self) -> &'static StreamFormat {
        self.color
    }

    /// Commands and replies that define its streams: the first input of [`crate::kinect::decoder::Decoder`].
    #[must_use]
    pub fn traffic(&self) -> &[UsbPacket] {
        self.commands.traffic()
    }

    /// Starts depth and colour, whose frames go to `source`. The transfers are submitted first, then the registers are written.
    ///
    /// # Errors
    /// Unplugged, no bandwidth, or no answer; nothing streams then.
    pub fn start(&mut self, source: &mut FrameSource) -> Result<(), KinectError> {
        self.usb.start(&[self.depth.endpoint, self.color.endpoint], source.sink())?;
        self.streaming = true;
        let registers = self.depth.start.iter().chain(self.color.start);
        for &(register, value) in registers {
            if let Err(e) = self.commands.write_register(self.usb.as_mut(), register, value) {
                self.stop();
                return Err(e);
            }
        }
        // Frames pile up while slow commands are waited for.
        source.discard_if_overflowed();
        Ok(())
    }

    /// Stops both streams: registers first, then the transfers are cancelled and drained.
    pub fn stop(&mut self) {
        if !std::mem::take(&mut self.streaming) {
            return;
        }
        for &(register, value) in self.depth.stop.iter().chain(self.color.stop) {
            // It may be unplugged; the transfers must be drained anyway.
            if let Err(e) = self.commands.write_register(self.usb.as_mut(), register, value) {
                tracing::debug!("stopping: {e}");
                break;
            }
        }
        self.usb.stop();
    }

    /// Time on the clock that timeouts use.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.usb.now()
    }

    /// True if the device waits for the reader, as only a simulated one does.
    #[must_use]
    pub fn waits(&self) -> bool {
        self.usb.waits()
    }

    /// Shows a state on the LED, if there is one. Failures do not affect the capture.
    pub fn set_led(&mut self, led: Led) {
        let outcome = match self.auxiliary.part {
            Some(Part::Motor) => {
                let value = match led {
                    Led::Ready => 1,
                    Led::Scanning => 4,
                    Led::Error => 2,
                    Led::Busy => 3,
                };
                let setup = Setup { part: Part::Motor, request: SET_LED, value, limit: self.auxiliary_timeout() };
                self.usb.control_out(setup, &[])
            }
            Some(_) => {
                let value = match led {
                    Led::Ready => 3,
                    Led::Scanning => 2,
                    Led::Error => 4,
                    Led::Busy => 1,
                };
                self.audio_command(&[0, 0x10, value]).and_then(|tag| self.audio_status(tag))
            }
            None => return,
        };
        self.auxiliary_result(outcome);
    }

    /// Specific force in m/s², camera axes; `None` where it is not available.
    pub fn accelerometer(&mut self) -> Option<[f32; 3]> {
        let outcome = match self.auxiliary.part? {
            Part::Motor => self.motor_accelerometer(),
            _ => self.audio_accelerometer(),
        };
        let counts = self.auxiliary_result(outcome)?;
        let [x, y, z] = counts.map(|c| c as f32 / COUNTS_PER_G * GRAVITY);
        // Its axes are left, up and forward.
        Some([-x, -y, z])
    }

    /// Exposure time in microseconds according to the sensor's register, not calibrated. `None` where it is unknown or was read
    /// less than [`SHUTTER_INTERVAL`] ago.
    pub fn exposure_us(&mut self) -> Option<f64> {
        let now = self.usb.now();
        if self.last_shutter.is_some_and(|t| now.saturating_sub(t) < SHUTTER_INTERVAL) {
            return None;
        }
        self.last_shutter = Some(now);
        let width = self.commands.read_cmos(self.usb.as_mut(), SHUTTER_WIDTH, AUXILIARY_TIMEOUT).ok()?;
        Some(f64::from(width) * SHUTTER_UNIT_US)
    }

    fn auxiliary_timeout(&self) -> Duration {
        if self.streaming { AUXILIARY_TIMEOUT } else { IDLE_AUXILIARY_TIMEOUT }
    }

    fn motor_accelerometer(&mut self) -> Result<[i32; 3], UsbError> {
        let mut state = [0u8; 10];
        let setup = Setup { part: Part::Motor, request: MOTOR_STATE, value: 0, limit: self.auxiliary_timeout() };
        let n = self.usb.control_in(setup, &mut state)?;
        if n < 8 {
            return Err(UsbError::Other(format!("{n} bytes of motor state")));
        }
        Ok([2, 4, 6].map(|i| i32::from(i16::from_be_bytes([state[i], state[i + 1]]))))
    }

    fn audio_accelerometer(&mut self) -> Result<[i32; 3], UsbError> {
        let tag = self.audio_command(&[0x68, 0x8032])?;
        let mut state = [0u8; 512];
        let n = self.usb.bulk_in(&mut state, self.auxiliary_timeout())?;
        let bytes =
            state.get(..n).and_then(|s| s.get(16..28)).ok_or_else(|| UsbError::Other(format!("{n} bytes of state")))?;
        let counts = [0, 4, 8].map(|i| i32::from_le_bytes([bytes[i], bytes[i + 1], bytes[i + 2], bytes[i + 3]]));
        self.audio_status(tag)?;
        Ok(counts)
    }

    /// Sends `{magic, tag, words…}` to the audio device; returns the tag.
    fn audio_command(&mut self, words: &[u32]) -> Result<u32, UsbError> {
        let tag = self.auxiliary.tag;
        self.auxiliary.tag = tag.wrapping_add(1);
        let bytes: Vec<u8> = [0x0602_2009, tag].iter().chain(words).flat_map(|w| w.to_le_bytes()).collect();
        self.usb.bulk_out(&bytes, self.auxiliary_timeout())?;
        Ok(tag)
    }

    fn audio_status(&mut self, tag: u32) -> Result<(), UsbError> {
        let mut status = [0u8; 512];
        let expected: Vec<u8> = [0x0a6f_e000, tag, 0u32].iter().flat_map(|w| w.to_le_bytes()).collect();
        // The reply to a command that timed out may arrive late.
        for _ in 0..AUDIO_REPLIES {
            let n = self.usb.bulk_in(&mut status, self.auxiliary_timeout())?;
            if status.get(..n) == Some(&expected[..]) {
                return Ok(());
            }
        }
        Err(UsbError::Other("the audio device sent another reply".into()))
    }

    /// Stops using a device that is missing or fails repeatedly.
    fn auxiliary_result<T>(&mut self, outcome: Result<T, UsbError>) -> Option<T> {
        match outcome {
            Ok(value) => {
                self.auxiliary.failures = 0;
                Some(value)
            }
            Err(e) => {
                self.auxiliary.failures += 1;
                if e == UsbError::NoDevice || self.auxiliary.failures >= AUXILIARY_FAILURES {
                    tracing::info!("no LED and accelerometer: {e}");
                    self.auxiliary.part = None;
                }
                None
            }
        }
    }
}

impl Drop for Kinect {
    fn drop(&mut self) {
        self.stop();
    }
}

/// The one with this serial number, or the first one.
fn choose(all: &[Found], serial: &str) -> Result<Found, UsbError> {
    let chosen = if serial.is_empty() { all.first() } else { all.iter().find(|f| f.serial == serial) };
    chosen.cloned().ok_or(UsbError::NoDevice)
}
