//! Tracking, bounded TSDF fusion, meshing and greedy keyframes (§3.1, first half).

mod camera;
mod frame;
mod isa;
mod keyframes;
mod pipeline;
mod tracking;
mod tsdf;

pub use pipeline::{FrameReport, Fusion, FusionError, FusionOutput, Tracking};
