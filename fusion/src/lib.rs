//! Tracking, bounded TSDF fusion, meshing and greedy keyframes (§3.1, first half).
//!
//! In: the description of a sensor and its RGB-D frames. Out: the surface as a triangle mesh, the trajectory, and keyframes
//! (Eq. 1). The method is KinectFusion (Newcombe et al. 2011) on a CPU, with a photometric term, a block pool of fixed size
//! and relocalisation.

mod camera;
mod error;
mod frame;
mod isa;
mod keyframes;
mod pipeline;
mod report;
mod tracking;
mod tsdf;

pub use error::FusionError;
pub use pipeline::Fusion;
pub use report::{FrameReport, FusionOutput, Tracking};
