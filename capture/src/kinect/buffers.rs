//! Pools of frame buffers. A buffer is written when it is made, so that the kernel backs it with memory then and not while
//! frames arrive; and it comes back when its frame is done with.

use crate::lock::lock;
use recordings::recording::Event;
use std::sync::{Arc, Mutex};

/// Spare buffers of one length, shared by those who fill them and those who empty them.
#[derive(Debug)]
pub struct Pool<T> {
    spare: Arc<Mutex<Vec<Vec<T>>>>,
    length: usize,
    most: usize,
}

impl<T> Clone for Pool<T> {
    fn clone(&self) -> Self {
        Self { spare: Arc::clone(&self.spare), ..*self }
    }
}

impl<T: Copy + From<u8>> Pool<T> {
    /// A pool that keeps at most `most` spare buffers of `length` elements, `made` of which are made at once.
    #[must_use]
    pub fn new(length: usize, made: usize, most: usize) -> Self {
        // Zeros would be memory that the kernel only promises.
        let mut spare: Vec<_> = (0..made).map(|_| vec![T::from(1); length]).collect();
        spare.reserve_exact(most.saturating_sub(made));
        Self { spare: Arc::new(Mutex::new(spare)), length, most }
    }

    /// A buffer with any contents; a new one if none is spare.
    #[must_use]
    pub fn take(&self) -> Vec<T> {
        let spare = lock(&self.spare).pop();
        spare.unwrap_or_else(|| vec![T::from(1); self.length])
    }

    /// Takes a buffer back; one of another length is none of this pool.
    pub fn give(&self, buffer: Vec<T>) {
        let mut spare = lock(&self.spare);
        if buffer.len() == self.length && spare.len() < self.most {
            spare.push(buffer);
        }
    }
}

impl<T> Default for Pool<T> {
    /// A pool that keeps nothing.
    fn default() -> Self {
        Self { spare: Arc::default(), length: 0, most: 0 }
    }
}

/// The buffers of a Kinect's frames. The default keeps nothing: for frames of other sources.
#[derive(Debug, Clone, Default)]
pub struct Buffers {
    /// Packed depth as it arrives.
    pub packed: Pool<u8>,
    /// The mosaic of a colour frame, which is delivered as it arrives.
    pub color: Pool<u8>,
    /// Depth in millimetres.
    pub depth: Pool<u16>,
}

impl Buffers {
    /// Takes back the buffer of a frame.
    pub fn recycle(&self, event: Event) {
        match event {
            Event::Depth(d) => self.depth.give(d.depth),
            Event::Color(c) => self.color.give(c.bytes),
            Event::Accelerometer(_) | Event::Packet(_) => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_given_back_is_taken_again() {
        let pool = Pool::<u16>::new(8, 1, 2);
        let first = pool.take();
        let address = first.as_ptr();
        pool.give(first);
        let second = pool.clone().take();
        assert_eq!(second.as_ptr(), address);
    }

    #[test]
    fn a_pool_keeps_no_more_than_it_may_and_no_other_length() {
        let pool = Pool::<u8>::new(4, 0, 2);
        [4, 4, 4, 5].into_iter().for_each(|n| pool.give(vec![7; n]));
        let taken: Vec<_> = (0..3).map(|_| pool.take()).collect();
        assert_eq!(taken, [vec![7; 4], vec![7; 4], vec![1; 4]]);
    }
}
