//! The synthetic Kinect: a small path tracer, and the sensor in front of it. It shares no code with the estimator, so
//! that what it renders can be held against what the estimator finds.
//!
//! A [`scene::Scene`] is lit by an [`environment::Environment`] and [`emitters`]; [`render`] makes linear pictures and depth of it,
//! [`color_sensor`] and [`depth_sensor`] turn those into what a Kinect V1 would have delivered along a [`path::Arc`].
//!
//! ```
//! use tests::synth::{kinect::Kinect, render::Shading, scenes};
//!
//! let (scene, mut kinect) = (scenes::room(), Kinect::new(8, 1, 1));
//! kinect.samples = 1;
//! let frame = kinect.frame(&scene, Shading::Flat, 0, &|time_s| scenes::room_tour(time_s, 24.0)).into_rgbd();
//! assert_eq!((frame.rgb.width, frame.depth.width), (80, 80));
//! ```

pub mod bvh;
pub mod cache;
pub mod color_sensor;
pub mod depth_sensor;
pub mod emitters;
pub mod environment;
pub mod exchange;
mod fruit;
pub mod glare;
pub mod kinect;
pub mod material;
pub mod parallel;
pub mod path;
mod placement;
pub mod random;
pub mod render;
pub mod scene;
pub mod scenes;
pub mod solid;
pub mod tabletop;
pub mod texture;
pub mod trace;

#[cfg(test)]
mod tests;
