//! Tracking, bounded TSDF fusion, meshing and greedy keyframes (§3.1, first half).
//!
//! In: the description of a sensor and its RGB-D frames. Out: the surface as a triangle mesh, the trajectory, and keyframes
//! (Eq. 1). The method is KinectFusion (Newcombe et al. 2011) on a CPU, with a photometric term, a block pool of fixed size
//! and relocalisation.
//!
//! A camera in front of a wall:
//!
//! ```
//! use firmware_config::FusionConfig;
//! use fusion::{Fusion, Tracking};
//! use recordings::types::{
//!     CameraModel, ColorEncoding, ColorFrame, DepthFrame, Distortion, Intrinsics, Pose, Response, RgbImage, RgbdFrame, Sensor,
//! };
//!
//! let (width, height) = (160, 120);
//! let intrinsics = Intrinsics { width, height, fx: 131.0, fy: 131.0, cx: 79.5, cy: 59.5 };
//! let camera = CameraModel { intrinsics, distortion: Distortion::default() };
//! let sensor = Sensor {
//!     name: "example".into(),
//!     serial: String::new(),
//!     color: camera,
//!     depth: camera,
//!     color_from_depth: Pose::IDENTITY,
//!     depth_registered: true,
//!     depth_unit_m: 0.001,
//!     response: Response::Srgb,
//!     depth_to_color_offset_ns: 0,
//! };
//! // A textured wall, 1 m before the camera.
//! let frame = |timestamp_ns| RgbdFrame {
//!     depth: DepthFrame { timestamp_ns, width, height, depth: vec![1000; 160 * 120], missing_packets: 0 },
//!     color: ColorFrame {
//!         timestamp_ns,
//!         width,
//!         height,
//!         encoding: ColorEncoding::Rgb,
//!         bytes: Vec::new(),
//!         missing_packets: 0,
//!     },
//!     rgb: RgbImage { width, height, data: (0..3 * 160 * 120).map(|i| (i / 3 % 160 / 8 % 2 * 100 + 60) as u8).collect() },
//! };
//!
//! let mut fusion = Fusion::new(&sensor, &FusionConfig { pool_blocks: 16384, ..FusionConfig::default() })?;
//! for i in 0..5 {
//!     assert_eq!(fusion.push(&frame(i * 33_333_333))?.tracking, Tracking::Tracked);
//! }
//! let output = fusion.finish();
//! assert_eq!(output.trajectory.len(), 5);
//! assert!(output.mesh.triangles.len() > 1000);
//! # Ok::<(), fusion::FusionError>(())
//! ```

mod camera;
mod error;
mod frame;
mod keyframes;
mod pipeline;
mod report;
mod tracking;
mod tsdf;

pub use error::FusionError;
pub use pipeline::Fusion;
pub use report::{FrameReport, FusionOutput, Margin, Tracking};
pub use tsdf::surfels::{BlockSurface, CELLS, SurfaceReader, Surfel};
