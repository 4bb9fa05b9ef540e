//! The TSDF.

pub mod integrate;
pub mod marching_cubes;
pub mod visibility;
pub mod volume;
