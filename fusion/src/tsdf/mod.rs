//! The model: a truncated signed distance function (TSDF) in a fixed pool of 8³-voxel blocks, and its mesh.
//!
//! In: filtered depth images with poses. Out: distance and gradient for tracking, and the mesh by marching cubes. Readings
//! are averaged with weights 1 / σ_z (Curless, Levoy 1996): new = (d · w + d_k · w_k) / (w + w_k).

pub mod components;
pub mod marching_cubes;
pub mod model;
pub mod sampling;
pub mod surfels;
pub mod visibility;
pub mod volume;

mod coarsen;
mod integrate;
mod kernel;
mod marching_cubes_table;
