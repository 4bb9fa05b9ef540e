//! The scene's surface (§3.1). In: a scanned or imported triangle mesh. Out: a regular mesh with edges of about one length
//! ([`regularise`], which edits a [`surface`]), its vertex adjacency ([`graph`]), a z-buffer of it ([`raster`]) and the weight
//! of each vertex in the equations of light ([`vertex_weight`]). [`cells`] groups vertices by place and direction.

pub mod cells;
pub mod graph;
pub mod raster;
pub mod regularise;
pub mod surface;
pub mod vertex_weight;
