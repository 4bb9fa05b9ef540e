//! A recording at its own speed.

use crate::orders::Orders;
use crate::stop::Stop;
use recordings::types::TimestampNs;
use std::time::{Duration, Instant};

/// Longest time between two checks for an order to stop.
const POLL: Duration = Duration::from_millis(50);

/// Waits before each frame until it is due.
pub struct Pace<'a> {
    orders: &'a Orders,
    stop: &'a Stop,
    started: Option<(Instant, TimestampNs)>,
}

impl<'a> Pace<'a> {
    /// The first frame is due at once.
    #[must_use]
    pub fn new(orders: &'a Orders, stop: &'a Stop) -> Self {
        Self { orders, stop, started: None }
    }

    /// Waits until the frame of this time is due; false if the user ended the scan.
    pub fn wait(&mut self, time: TimestampNs) -> bool {
        let (since, first) = *self.started.get_or_insert((Instant::now(), time));
        let due = since + Duration::from_nanos(u64::try_from(time.saturating_sub(first)).unwrap_or(0));
        loop {
            if self.orders.take_stop() || self.stop.check().is_err() {
                return false;
            }
            let left = due.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return true;
            }
            std::thread::sleep(left.min(POLL));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_come_when_they_are_due_until_the_user_stops() {
        let (orders, stop) = (Orders::default(), Stop::default());
        let mut pace = Pace::new(&orders, &stop);
        let began = Instant::now();
        assert!([5_000_000_000, 5_100_000_000, 4_000_000_000, 5_200_000_000].into_iter().all(|t| pace.wait(t)));
        assert!(began.elapsed() >= Duration::from_millis(200));
        orders.stop();
        assert!(!pace.wait(i64::MAX));
    }
}
