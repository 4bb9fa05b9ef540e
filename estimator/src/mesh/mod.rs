//! The scene's surface (§3.1). In: a scanned or imported triangle mesh. Out: a regular mesh with edges of about one length
//! ([`regularise`], which edits a [`surface`] once [`repair`] has mended its defects and [`clustering`] has made it coarser where it
//! is much too fine), its vertex adjacency ([`graph`]), a z-buffer of it ([`raster`]) and the weight of each vertex in the
//! equations of light ([`vertex_weight`]). [`cells`] groups vertices by place and direction.

pub mod cells;
pub mod clustering;
pub mod graph;
pub mod raster;
pub mod regularise;
pub mod repair;
pub mod surface;
pub mod unions;
pub mod vertex_weight;
