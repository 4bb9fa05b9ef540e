//! Light for rendering. In: spherical-harmonic light of a result, panoramas, keyframe pictures. Out: an
//! [`environment::Environment`] that can be sampled by importance; directions that no surface observed are completed from
//! what keyframes saw beyond the scan ([`observed_background`], [`completion`]). Lamps and emitting surfaces light from
//! where they are ([`local_sources`]); a request may change them ([`lamp_change`]).

pub mod completion;
pub mod environment;
pub mod lamp_change;
pub mod local_sources;
pub mod observed_background;
pub mod panorama;
