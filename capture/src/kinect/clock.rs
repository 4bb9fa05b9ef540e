//! Unwraps the time stamps of the Kinect's 60 MHz clock: 32 bits overflow every 71.6 s.

use firmware_config::kinect_models::CLOCK_HZ;
use recordings::types::TimestampNs;

const WRAP: i64 = 1 << 32;

/// Unwraps the time stamps of both streams, which share one clock. The host's time of arrival bridges silences longer than
/// an overflow.
#[derive(Debug, Clone, Default)]
pub struct DeviceClock {
    /// Unwrapped ticks and host time of the newest stamp.
    newest: Option<(i64, i64)>,
}

impl DeviceClock {
    /// Time of a stamp in nanoseconds since the clock's last zero before the first stamp; `host_ns` is its time of arrival.
    pub fn unwrap(&mut self, ticks: u32, host_ns: i64) -> TimestampNs {
        let unwrapped = match self.newest {
            None => i64::from(ticks),
            Some((last, last_host)) => {
                let silence_ns = host_ns.saturating_sub(last_host).max(0);
                let expected = last.saturating_add(ns_to_ticks(silence_ns));
                // The value congruent to `ticks` that is nearest to the expectation of the host's clock.
                let offset = (i64::from(ticks) - expected).rem_euclid(WRAP);
                expected.saturating_add(if offset >= WRAP / 2 { offset - WRAP } else { offset })
            }
        };
        if self.newest.is_none_or(|(last, _)| unwrapped > last) {
            self.newest = Some((unwrapped, host_ns));
        }
        ticks_to_ns(unwrapped)
    }
}

fn ticks_to_ns(ticks: i64) -> i64 {
    saturated(i128::from(ticks) * 1_000_000_000 / i128::from(CLOCK_HZ))
}

fn ns_to_ticks(ns: i64) -> i64 {
    saturated(i128::from(ns) * i128::from(CLOCK_HZ) / 1_000_000_000)
}

fn saturated(x: i128) -> i64 {
    i64::try_from(x).unwrap_or(if x < 0 { i64::MIN } else { i64::MAX })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_wrap_goes_on() {
        let mut clock = DeviceClock::default();
        let start = u32::MAX - 3_000_000;
        let first = clock.unwrap(start, 0);
        for frame in 1..100i64 {
            let t = clock.unwrap(start.wrapping_add(frame as u32 * 2_000_000), frame * 33_333_333);
            assert!((t - first - frame * 100_000_000 / 3).abs() <= 1, "frame {frame}: {t}");
        }
    }

    #[test]
    fn depth_just_behind_colour_does_not_wrap() {
        let mut clock = DeviceClock::default();
        let a = clock.unwrap(5, 1_000);
        let b = clock.unwrap(u32::MAX - 4, 2_000);
        assert_eq!((a - b) / 10, 16, "ten ticks are 167 ns");
    }

    proptest! {
        #[test]
        fn any_silence_is_bridged(start: u32, steps in proptest::collection::vec((0u64..40_000_000_000, -100_000i64..100_000), 1..40)) {
            let (mut clock, mut ticks, mut host) = (DeviceClock::default(), u64::from(start), 1_000_000i64);
            clock.unwrap(start, host);
            let zero = u64::from(start);
            for (step, jitter_ns) in steps {
                ticks += step;
                host += (step as i128 * 50 / 3) as i64;
                let t = clock.unwrap(ticks as u32, (host + jitter_ns).max(0));
                prop_assert_eq!(t, (ticks as i128 * 50 / 3) as i64, "{} after start", ticks - zero);
            }
        }

        #[test]
        fn any_input_is_accepted(stamps in proptest::collection::vec((any::<u32>(), any::<i64>()), 0..50)) {
            let mut clock = DeviceClock::default();
            for (ticks, host) in stamps {
                clock.unwrap(ticks, host);
            }
        }
    }
}
