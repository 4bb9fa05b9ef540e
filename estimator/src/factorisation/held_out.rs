//! Vertices that are held out of every fit, so that models can be compared on them.

use crate::numerics::random::hash;
use crate::numerics::robust::SampleMean;

/// Consecutive vertices that are held out together: errors of neighbours are correlated.
const BLOCK: u32 = 64;
/// One block of this many is held out.
const FOLDS: u32 = 5;

/// The block of held-out vertices that `vertex` is in; `None` if it takes part in fits.
#[must_use]
pub fn block(vertex: u32) -> Option<u32> {
    let block = vertex / BLOCK;
    hash(block, 0xf01d).is_multiple_of(FOLDS).then_some(block)
}

/// Errors of one block: block, their sum, number of vertices or weight of the samples.
pub type BlockError = (u32, f64, f64);

/// Sums errors of vertices by blocks. `errors` are pairs of block and error, ascending by block.
#[must_use]
pub fn by_block(errors: impl IntoIterator<Item = (u32, f64)>) -> Vec<BlockError> {
    let mut blocks: Vec<BlockError> = Vec::new();
    for (block, error) in errors {
        match blocks.last_mut() {
            Some(last) if last.0 == block => {
                last.1 += error;
                last.2 += 1.0;
            }
            _ => blocks.push((block, error, 1.0)),
        }
    }
    blocks
}

/// Mean error over all blocks.
#[must_use]
pub fn mean(blocks: &[BlockError]) -> f64 {
    let (sum, weight) = blocks.iter().fold((0.0, 0.0), |(s, w), b| (s + b.1, w + b.2));
    if weight > 0.0 { sum / weight } else { 0.0 }
}

/// How much lower the errors are than `others`, over the same blocks.
#[must_use]
pub fn gain(blocks: &[BlockError], others: &[BlockError]) -> SampleMean {
    let gains: Vec<f64> = blocks.iter().zip(others).map(|(a, b)| (b.1 - a.1) / a.2).collect();
    SampleMean::of(&gains)
}
