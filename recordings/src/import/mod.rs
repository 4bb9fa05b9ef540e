//! Data of other programs: TUM RGB-D folders ([`tum`], text tables in [`lists`]) become recordings, a mesh with posed
//! photos ([`photos`]) becomes a scan.

pub mod lists;
pub mod photos;
pub mod tum;
