//! One loop over threads: the items are independent, so their number never shows in the result.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// `(0..count).map(work)`, spread over `threads` threads in pieces of `grain` items.
pub fn map<T: Send>(count: usize, grain: usize, threads: usize, work: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let grain = grain.max(1);
    let pieces = count.div_ceil(grain);
    let next = AtomicUsize::new(0);
    let done = Mutex::new(Vec::with_capacity(pieces));
    std::thread::scope(|scope| {
        for _ in 0..threads.clamp(1, pieces.max(1)) {
            scope.spawn(|| {
                loop {
                    let piece = next.fetch_add(1, Ordering::Relaxed);
                    if piece >= pieces {
                        break;
                    }
                    let items: Vec<T> = (piece * grain..count.min((piece + 1) * grain)).map(&work).collect();
                    done.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push((piece, items));
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    done.sort_by_key(|(piece, _)| *piece);
    done.into_iter().flat_map(|(_, items)| items).collect()
}
