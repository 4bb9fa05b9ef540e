//! Sources of frames. In: a recording, a TUM folder, an OpenNI2 sensor or a Kinect ([`source`], [`streaming`]). Out: pairs of
//! a colour and a depth frame, mutually nearest in time ([`pairing`], [`pairs`]), with the sensor's description ([`sensor`]), at the
//! recording's own speed where someone watches ([`pace`]).

pub mod motion;
#[cfg(feature = "openni")]
pub mod openni;
pub mod pace;
mod pairing;
pub mod pairs;
pub mod sensor;
mod source;
pub mod streaming;
