//! Preprocessing of a frame.
//!
//! In: an RGB-D frame as read. Out: [`preprocess::Frame`]: the grey pyramid of the undistorted colour image, depth without
//! grazing and flying pixels, and a grid of denoised points with normals.

mod depth_filter;
pub mod grey;
pub mod preprocess;
