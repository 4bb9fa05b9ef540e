//! What the box ships: every tunable constant with unit, range, default and paper symbol, in one place.

#[cfg(test)]
mod appliance;
pub mod capture;
mod config;
pub mod daemon;
pub mod estimator;
pub mod fusion;
pub mod kinect;
pub mod kinect_models;
pub mod memory;
pub mod reality;
mod settings;
pub mod tuning;

pub use capture::{CaptureConfig, ResponseChoice};
pub use config::Config;
pub use daemon::DaemonConfig;
pub use estimator::{EstimatorConfig, ExposureChoice, Quality, SolverChoice, Switch, TransferChoice};
pub use fusion::FusionConfig;
pub use kinect::{CameraConfig, KinectConfig};
pub use memory::{Planned, memory_plan};
pub use reality::RealityConfig;
pub use settings::{ConfigError, SettingInfo};
