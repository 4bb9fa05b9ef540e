//! The trade of speed against accuracy. In: a scan whose albedo and light are known ([`truth`]). Out: a [`point::Point`]
//! a setting ([`run`]), as a table or a plot ([`plot`]).
//!
//! This is the one place that looks at ground truth. Nothing here feeds back into an estimate.

pub mod alignment;
pub mod plot;
pub mod point;
pub mod run;
pub mod truth;
