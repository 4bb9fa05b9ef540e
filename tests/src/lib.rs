//! What tests across crates share: the truth scenes, their arrays, and the figures that results are judged by.

// Test code: whatever is wrong with a fixture is to end the test.
#![allow(clippy::expect_used)]

pub mod metrics;
pub mod scans;
pub mod synth;
pub mod truth;

use std::path::PathBuf;

/// The folder of shared test data, or `None`, with a word on the console, where `LUMISCAN_SHARED` is not set. Once it is
/// set, a missing file is a failure.
#[must_use]
pub fn shared() -> Option<PathBuf> {
    let folder = std::env::var_os("LUMISCAN_SHARED").map(PathBuf::from);
    if folder.is_none() {
        println!("skipped: LUMISCAN_SHARED is not set (it names the folder of shared test data)");
    }
    folder
}
