//! The light so far: while a scan is watched, a coarse estimate every few seconds from what has been seen. In: surface and
//! kept pictures of the [`crate::serve::live`] hub. Out: light as spherical harmonics, and which directions surfaces have told
//! of. The estimator runs as a process of its own with the lowest priority; the scan does not depend on it.

mod coarse_mesh;
mod snapshot;
pub mod so_far;
pub mod worker;
