//! The configuration that the appliance ships: every setting with unit, range, default and paper symbol; tables of Kinect
//! models; the memory plan.
//!
//! Sections (`[fusion]`, `[estimator]`, …) hold the settings of a stage as a whole; [`tuning`] holds the thresholds of single
//! steps. Both are read from TOML and from `section.key=value`:
//!
//! ```
//! use firmware_config::Config;
//!
//! let mut config = Config::from_toml("[fusion]\nvoxel_size_m = 0.01").unwrap();
//! config.set("estimator.transfer=shade").unwrap();
//! config.set("depth_noise.floor_m=0.002").unwrap();
//! assert_eq!(config.fusion.voxel_size_m, 0.01);
//!
//! // A value out of range names its range; an unknown key names the nearest one.
//! assert!(config.set("fusion.voxel_size_m=7").unwrap_err().to_string().contains("0.001"));
//! assert!(config.set("fusion.voxel_sise_m=0.01").unwrap_err().to_string().contains("voxel_size_m"));
//! ```

#[cfg(test)]
mod appliance;
pub mod capture;
mod config;
pub mod daemon;
pub mod estimator;
pub mod fusion;
pub mod handoff;
pub mod kinect;
pub mod kinect_models;
pub mod memory;
pub mod reality;
pub mod serve;
mod settings;
pub mod tuning;

pub use capture::{CaptureConfig, ResponseChoice};
pub use config::Config;
pub use daemon::DaemonConfig;
pub use estimator::{EstimatorConfig, ExposureChoice, Quality, SolverChoice, Switch, TextureChoice, TransferChoice};
pub use fusion::FusionConfig;
pub use handoff::HandoffConfig;
pub use kinect::{CameraConfig, KinectConfig};
pub use memory::{Planned, memory_plan};
pub use reality::RealityConfig;
pub use serve::ServeConfig;
pub use settings::{ConfigError, SettingInfo};
