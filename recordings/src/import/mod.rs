//! Data of other programs: TUM RGB-D folders ([`tum`], text tables in [`lists`], camera paths in [`trajectory`]) become
//! recordings, a mesh with posed photos ([`photos`]) becomes a scan; arrays in [`npy`].

pub mod lists;
pub mod npy;
pub mod photos;
pub mod trajectory;
pub mod tum;
