//! The camera's command protocol over the control endpoint, and the contents of its replies.

use crate::kinect::calibration::{Calibration, Registration, ZeroPlane};
use crate::kinect::transport::{Setup, Transport, UsbError};
use firmware_config::kinect_models::Part;
use recordings::types::UsbPacket;
use std::time::Duration;

/// Bytes of a message header: magic, payload length in words, command, tag.
pub const HEADER: usize = 8;
/// Bytes asked for in a reply; a reply of exactly this length means "not ready", as one of length 0 does.
pub const REPLY_BYTES: usize = 0x200;
/// Magic of commands.
pub const MAGIC_OUT: [u8; 2] = *b"GM";
/// Magic of replies.
pub const MAGIC_IN: [u8; 2] = *b"RB";
/// Endpoint that marks commands in a recording of packets.
pub const CONTROL_OUT: u8 = 0x00;
/// Endpoint that marks replies there.
pub const CONTROL_IN: u8 = 0x80;

/// Reads a register.
pub const READ_REGISTER: u16 = 0x02;
/// Writes a register.
pub const WRITE_REGISTER: u16 = 0x03;
/// Fixed parameters: geometry of emitter and cameras.
pub const FIXED_PARAMETERS: u16 = 0x04;
/// Algorithm parameters.
pub const ALGORITHM: u16 = 0x16;
/// RGB sensor registers.
pub const CMOS: u16 = 0x95;

/// Algorithm parameters: depth-to-colour registration.
pub const REGISTRATION: u16 = 0x40;
/// Algorithm parameters: padding.
pub const PADDING: u16 = 0x41;
/// Algorithm parameters: constant shift.
pub const CONST_SHIFT: u16 = 0x00;

/// Attempts at each command.
const ATTEMPTS: u32 = 3;
/// Replies to other commands before a command is sent again.
const MAX_STALE: u32 = 64;
/// Pause between two attempts: a Kinect that is being unplugged shows as failed transfers first.
const RETRY_PAUSE: Duration = Duration::from_millis(50);
/// Pause between two requests for a reply.
const REPLY_POLL: Duration = Duration::from_millis(1);

/// Why the Kinect cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum KinectError {
    /// The transfer failed.
    #[error(transparent)]
    Usb(#[from] UsbError),
    /// Its replies violate the protocol.
    #[error("command {command:#04x}: {problem}; unplug the Kinect and plug it in again")]
    Protocol {
        /// The command.
        command: u16,
        /// What was wrong.
        problem: String,
    },
    /// Its calibration is missing or implausible.
    #[error("the Kinect's calibration is invalid ({0}); unplug it and plug it in again")]
    Calibration(String),
}

impl KinectError {
    /// True if the device is not, or no longer, plugged in.
    #[must_use]
    pub fn is_gone(&self) -> bool {
        *self == Self::Usb(UsbError::NoDevice)
    }
}

/// Sends commands and waits for their replies.
#[derive(Debug)]
pub struct Commands {
    tag: u16,
    limit: Duration,
    /// Commands and replies that define the streams, for a recording of packets.
    traffic: Vec<UsbPacket>,
}

impl Commands {
    /// Waits at most `limit` for each reply. Tags start at `first_tag`, which should differ from an earlier session's.
    #[must_use]
    pub fn new(limit: Duration, first_tag: u16) -> Self {
        Self { tag: first_tag, limit, traffic: Vec::new() }
    }

    /// Commands and replies so far that define the streams.
    #[must_use]
    pub fn traffic(&self) -> &[UsbPacket] {
        &self.traffic
    }

    /// Sends a command and returns the payload of its reply.
    ///
    /// # Errors
    /// Unplugged, no reply in time, or an invalid reply.
    pub fn send(&mut self, usb: &mut dyn Transport, command: u16, payload: &[u16]) -> Result<Vec<u8>, KinectError> {
        let mut attempt = 1;
        loop {
            match self.send_once(usb, command, payload, self.limit) {
                Err(e) if !e.is_gone() && attempt < ATTEMPTS => {
                    tracing::debug!("{e}");
                    usb.pause(RETRY_PAUSE);
                }
                outcome => return outcome,
            }
            attempt += 1;
        }
    }

    /// One attempt, of at most about `limit`.
    fn send_once(
        &mut self,
        usb: &mut dyn Transport,
        command: u16,
        payload: &[u16],
        limit: Duration,
    ) -> Result<Vec<u8>, KinectError> {
        self.tag = self.tag.wrapping_add(1);
        let message = message(MAGIC_OUT, command, self.tag, payload);
        usb.control_out(Setup { part: Part::Camera, request: 0, value: 0, limit }, &message)?;
        let reply = self.reply(usb, command, limit)?;
        self.keep(CONTROL_OUT, message);
        let payload = reply[HEADER..].to_vec();
        self.keep(CONTROL_IN, reply);
        Ok(payload)
    }

    /// Waits for the reply to the newest tag; skips replies to earlier commands and sessions.
    fn reply(&self, usb: &mut dyn Transport, command: u16, limit: Duration) -> Result<Vec<u8>, KinectError> {
        let deadline = usb.now() + limit;
        let mut buffer = [0u8; REPLY_BYTES];
        let mut problem = None;
        let mut stale = 0;
        loop {
            let n = usb.control_in(Setup { part: Part::Camera, request: 0, value: 0, limit }, &mut buffer)?;
            if n != 0 && n != REPLY_BYTES {
                let reply = buffer.get(..n).unwrap_or(&buffer);
                match check(reply, command, self.tag) {
                    Ok(()) => return Ok(reply.to_vec()),
                    Err(e) => problem = Some(e),
                }
                stale += 1;
            }
            if usb.now() >= deadline || stale > MAX_STALE {
                return Err(match problem {
                    Some(problem) => KinectError::Protocol { command, problem },
                    None => UsbError::Timeout.into(),
                });
            }
            usb.pause(REPLY_POLL);
        }
    }

    /// Writes a register.
    ///
    /// # Errors
    /// As [`Commands::send`].
    pub fn write_register(&mut self, usb: &mut dyn Transport, register: u16, value: u16) -> Result<(), KinectError> {
        self.send(usb, WRITE_REGISTER, &[register, value]).map(|_| ())
    }

    /// Reads a register of the RGB sensor: one attempt of at most about `limit`, for use while streaming.
    ///
    /// # Errors
    /// As [`Commands::send`].
    pub fn read_cmos(&mut self, usb: &mut dyn Transport, register: u16, limit: Duration) -> Result<u16, KinectError> {
        let reply = self.send_once(usb, CMOS, &[1, register & 0x7fff, 0], limit)?;
        word(&reply, 2).ok_or_else(|| too_short(CMOS, &reply))
    }

    /// Reads the device's calibration, in the order that is known to work.
    ///
    /// # Errors
    /// As [`Commands::send`]; an implausible calibration.
    pub fn read_calibration(&mut self, usb: &mut dyn Transport) -> Result<Calibration, KinectError> {
        const VGA: u16 = 1;
        const FPS: u16 = 30;
        self.send(usb, ALGORITHM, &[PADDING, 0, VGA, FPS, 0])?;
        self.send(usb, FIXED_PARAMETERS, &[0; 5])?;
        self.send(usb, ALGORITHM, &[REGISTRATION, 0, VGA, FPS, 0])?;
        self.send(usb, ALGORITHM, &[CONST_SHIFT, 0, VGA, FPS, 0])?;
        let mut parameters = StreamParameters::default();
        self.traffic.iter().for_each(|p| parameters.observe(p.endpoint, &p.data));
        parameters.calibration()
    }

    fn keep(&mut self, endpoint: u8, data: Vec<u8>) {
        let command = word(&data, 2);
        // Register writes select the formats. Exposure readings do not concern the streams.
        if matches!(command, Some(WRITE_REGISTER | FIXED_PARAMETERS | ALGORITHM)) && self.traffic.len() < 256 {
            self.traffic.push(UsbPacket { timestamp_ns: 0, endpoint, data });
        }
    }
}

/// Bytes of a command or reply.
#[must_use]
pub fn message(magic: [u8; 2], command: u16, tag: u16, payload: &[u16]) -> Vec<u8> {
    let mut bytes = magic.to_vec();
    for word in [payload.len() as u16, command, tag].iter().chain(payload) {
        bytes.extend_from_slice(&word.to_le_bytes());
    }
    bytes
}

/// Word `index` of little-endian bytes.
#[must_use]
pub fn word(bytes: &[u8], index: usize) -> Option<u16> {
    bytes.get(2 * index..2 * index + 2).map(|b| u16::from_le_bytes([b[0], b[1]]))
}

fn check(reply: &[u8], command: u16, tag: u16) -> Result<(), String> {
    let [Some(words), Some(reply_command), Some(reply_tag)] = [1, 2, 3].map(|i| word(reply, i)) else {
        return Err(format!("its reply has {} bytes, too few for a header", reply.len()));
    };
    if reply[..2] != MAGIC_IN {
        Err(format!("its reply starts with {:02x} {:02x}", reply[0], reply[1]))
    } else if (reply_command, reply_tag) != (command, tag) {
        Err(format!("the reply is to command {reply_command:#04x} tag {reply_tag}, expected was tag {tag}"))
    } else if HEADER + 2 * usize::from(words) != reply.len() {
        Err(format!("its reply announces {words} words and has {} bytes", reply.len() - HEADER))
    } else {
        Ok(())
    }
}

fn too_short(command: u16, reply: &[u8]) -> KinectError {
    KinectError::Protocol { command, problem: format!("its reply has only {} bytes", reply.len()) }
}

/// Formats and calibration of the streams, collected from commands and replies of a device or a recording.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StreamParameters {
    /// The algorithm parameter of the last command.
    requested: Option<u16>,
    geometry: Option<[f32; 4]>,
    registration: Option<Registration>,
    start_lines: Option<u16>,
    const_shift: Option<u16>,
    /// Depth format register.
    depth_format: Option<u16>,
    /// Colour resolution register.
    color_resolution: Option<u16>,
}

impl StreamParameters {
    /// Takes a message.
    pub fn observe(&mut self, endpoint: u8, data: &[u8]) {
        let (Some(command), Some(payload)) = (word(data, 2), data.get(HEADER..)) else { return };
        match (endpoint, command) {
            (CONTROL_OUT, ALGORITHM) => self.requested = word(payload, 0),
            (CONTROL_OUT, WRITE_REGISTER) => match (word(payload, 0), word(payload, 1)) {
                (Some(0x12), value) => self.depth_format = value,
                (Some(0x0d), value) => self.color_resolution = value,
                _ => {}
            },
            (CONTROL_IN, FIXED_PARAMETERS) => self.geometry = geometry(payload),
            (CONTROL_IN, ALGORITHM) => match self.requested.take() {
                Some(REGISTRATION) => self.registration = Registration::from_reply(payload),
                Some(PADDING) => self.start_lines = word(payload, 1),
                Some(CONST_SHIFT) => self.const_shift = word(payload, 1),
                _ => {}
            },
            _ => {}
        }
    }

    /// True if depth comes with 10 bits a pixel.
    #[must_use]
    pub fn is_depth_10(&self) -> bool {
        self.depth_format == Some(2)
    }

    /// True if colour comes with 1280×1024 pixels.
    #[must_use]
    pub fn is_color_sxga(&self) -> bool {
        self.color_resolution == Some(2)
    }

    /// The calibration.
    ///
    /// # Errors
    /// A part is missing or implausible.
    pub fn calibration(&self) -> Result<Calibration, KinectError> {
        let missing = |what: &str| KinectError::Calibration(format!("{what} is missing"));
        let [emitter_cm, _, distance, pixel_size] = self.geometry.ok_or_else(|| missing("the geometry"))?;
        let const_shift = self.const_shift.ok_or_else(|| missing("the constant shift"))?;
        let zero_plane = ZeroPlane { emitter_cm, distance, pixel_size, const_shift };
        if !zero_plane.is_plausible() {
            return Err(KinectError::Calibration(format!("{zero_plane:?}")));
        }
        Ok(Calibration {
            zero_plane,
            registration: self.registration.ok_or_else(|| missing("the registration block"))?,
            start_lines: self.start_lines.ok_or_else(|| missing("the padding"))?,
        })
    }
}

/// Distance emitter–infrared and infrared–colour camera (cm), reference distance and pixel size at byte 94.
fn geometry(payload: &[u8]) -> Option<[f32; 4]> {
    let bytes = payload.get(94..110)?;
    Some(std::array::from_fn(|i| {
        f32::from_le_bytes([bytes[4 * i], bytes[4 * i + 1], bytes[4 * i + 2], bytes[4 * i + 3]])
    }))
}
