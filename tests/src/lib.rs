//! What tests across crates share: the truth scenes, their arrays, and the figures that results are judged by.
//!
//! ```
//! use tests::metrics::{adjusted_rand_index, percentile};
//!
//! assert_eq!(adjusted_rand_index(&[0, 0, 1, 1], &[5, 5, 2, 2]), 1.0);
//! assert_eq!(percentile(&[1.0, 2.0, 3.0, 4.0], 0.5), 2.5);
//! ```

// Test code: whatever is wrong with a fixture is to end the test.
#![allow(clippy::expect_used)]

pub mod corpus;
pub mod digests;
pub mod evaluation;
pub mod lamp_desk;
pub mod matching;
pub mod metrics;
pub mod scans;
pub mod seams;
pub mod synth;
pub mod truth;

use std::path::PathBuf;

/// The folder of shared test data. Tests that call this carry
/// `#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: …")]`.
///
/// # Panics
/// `LUMISCAN_SHARED` is not set.
#[must_use]
pub fn shared() -> PathBuf {
    std::env::var_os("LUMISCAN_SHARED").expect("LUMISCAN_SHARED names the folder of shared test data").into()
}
