//! Segmentation into materials (§3.2, Eqs. 6–7). In: mesh, lit colours and their weights. Out: a segment number per vertex
//! ([`segment::segment`]). Steps: colour features and their filters ([`features`]), distances along mesh edges ([`distance`]
//! with [`shape_diameter`]), DBSCAN ([`dbscan`]), then growing and merging of regions ([`regions`]).

pub mod dbscan;
pub mod distance;
pub mod features;
pub mod labels;
pub mod materials;
pub mod regions;
pub mod segment;
pub mod shape_diameter;

pub use segment::segment;
