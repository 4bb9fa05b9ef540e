//! Data of other programs: TUM RGB-D folders ([`tum`], text tables in [`lists`], camera paths in [`trajectory`]) become
//! recordings, a mesh with posed photos ([`photos`], cameras in [`transforms`]) becomes a scan; arrays in [`npy`].

mod camera_file;
pub mod lists;
pub mod npy;
pub mod photos;
pub mod trajectory;
pub mod transforms;
pub mod tum;
