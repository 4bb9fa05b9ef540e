//! Instruction sets of the hot loops, selected once at run time. The code is the same for each, sums are never reordered and
//! products never fused, so the results are the same bits.

mod dispatch;
mod selection;

pub use dispatch::{Hot, dispatch};
pub use selection::Isa;
