//! Tracking: the camera's pose from frame to frame.
//!
//! In: preprocessed frames, the TSDF volume. Out: `world_from_camera` per frame, or loss. Gauss–Newton on point-to-plane
//! residuals n · (T p) − d and photometric residuals I(π(x)) − (gain · I_ref + offset), coarse to fine. Residuals are divided
//! by their standard deviations, so the normal matrix is an information matrix; its eigenvalues say which directions are
//! observed. The pose is updated on the camera's side, T ← T · exp(δ), δ = (translation, rotation).

pub mod effort;
pub mod pose_tracker;
pub mod problem;

mod align;
mod anchors;
mod gates;
mod geometric;
mod margin;
mod ncc;
mod normal_equations;
mod photometric;
mod reference;
mod relocalise;
mod rotate;
mod schedule;
mod solve;
mod tilt;
mod timing;
mod timing_system;
