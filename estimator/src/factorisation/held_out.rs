//! Vertices that are held out of every fit, so that models can be compared on them.

use crate::numerics::random::hash;

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
