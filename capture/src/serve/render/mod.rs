//! Pictures of a finished scan with a change in it, at full quality: what `lumiscan render` makes of it, on the box, as a process of the
//! lowest priority. In: a description of the picture, and files to insert or to light with. Out: one picture, the newest.

pub mod desk;
pub mod picture;
