//! The scan in progress, as clients see it. In: fusion after each frame. Out: the newest picture, the surface since a client
//! last asked, figures and advice. Nothing queues: who is slow misses pictures.

pub mod advice;
pub mod hub;
pub mod pictures;
pub mod surface;
