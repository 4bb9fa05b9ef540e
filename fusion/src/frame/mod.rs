//! Preprocessing of a frame.

pub mod preprocess;
