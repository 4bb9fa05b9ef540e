//! The scene's surface (§3.1). In: a scanned or imported triangle mesh. Out: a regular mesh of even edge lengths
//! ([`regularise`]), its vertex adjacency ([`graph`]), a z-buffer of it ([`raster`]) and how far each vertex can be relied
//! on ([`vertex_weight`]).

pub mod graph;
pub mod raster;
pub mod regularise;
pub mod surface;
pub mod vertex_weight;
