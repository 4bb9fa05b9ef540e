//! When a run within a budget has to end. The process may be halted from outside, evenly or in stretches: whatever a halt could make late
//! is done before it can come.

/// Longest stretch that a process is expected to be halted for, in seconds. A longer one is no habit of the machine.
const LONGEST_HALT_S: f64 = 5.0;
/// The newest answer is in its place for at least this share of the budget, since a first halt cannot be foreseen.
const IN_PLACE_SHARE: f64 = 0.15;
/// Share of the budget in which the process ends.
const ENDING_SHARE: f64 = 0.01;

/// What is due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Due {
    /// Nothing.
    Nothing,
    /// The newest answer belongs in its place; better ones may replace it.
    InPlace,
    /// The run ends with the newest answer.
    End,
}

/// Looks at the clock again and again.
#[derive(Debug)]
pub struct Watchdog {
    budget: f64,
    last: f64,
    longest_gap: f64,
}

impl Watchdog {
    /// For a budget in seconds.
    #[must_use]
    pub fn new(budget: f64) -> Self {
        Self { budget, last: 0.0, longest_gap: 0.0 }
    }

    /// What is due `now`, in seconds since the run began. The longest time between two looks tells how the process is halted: what is not
    /// done now may have to wait as long again.
    pub fn look(&mut self, now: f64) -> Due {
        let gap = (now - self.last).clamp(0.0, LONGEST_HALT_S);
        self.longest_gap = self.longest_gap.max(gap);
        self.last = now;
        let end = self.budget - self.longest_gap - ENDING_SHARE * self.budget;
        let in_place = self.budget - (IN_PLACE_SHARE * self.budget).min(LONGEST_HALT_S);
        match now {
            _ if now >= end => Due::End,
            _ if now >= in_place => Due::InPlace,
            _ => Due::Nothing,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Looks every 20 ms of `budget` seconds, except while halted; when which thing was due first.
    fn first_due(budget: f64, is_halted: impl Fn(f64) -> bool) -> (f64, f64) {
        let mut watchdog = Watchdog::new(budget);
        let (mut in_place, mut end) = (f64::INFINITY, f64::INFINITY);
        for tick in 1..3000 {
            let now = f64::from(tick) * 0.02;
            if is_halted(now) {
                continue;
            }
            match watchdog.look(now) {
                Due::Nothing => continue,
                Due::InPlace => {}
                Due::End => end = end.min(now),
            }
            in_place = in_place.min(now);
        }
        (in_place, end)
    }

    #[test]
    fn without_halts_the_budget_is_used() {
        let (in_place, end) = first_due(30.0, |_| false);
        assert!((25.5..25.6).contains(&in_place) && (29.6..29.75).contains(&end), "{in_place} {end}");
        let (in_place, end) = first_due(5.0, |_| false);
        assert!((4.2..4.3).contains(&in_place) && (4.9..5.0).contains(&end), "{in_place} {end}");
    }

    #[test]
    fn stretches_of_halting_never_reach_over_the_end() {
        for period in [1.0, 2.2, 5.5] {
            for running in [0.5, 0.25, 0.1] {
                for phase in 0..20 {
                    let start = period * f64::from(phase) / 20.0;
                    let (in_place, end) = first_due(30.0, |t| (t + start) % period > running * period);
                    assert!(in_place <= 30.0 && end <= 30.0, "{running} of {period} s from {start}: {in_place} {end}");
                    assert!(end >= 30.0 - 2.0 * period - 0.4, "{running} of {period} s from {start}: ends at {end}");
                }
            }
        }
    }

    #[test]
    fn a_first_halt_at_the_end_finds_the_answer_in_place() {
        for from in [24.9, 26.0, 29.5] {
            let (in_place, _) = first_due(30.0, |t| (from..from + 4.5).contains(&t));
            assert!(in_place <= 30.0, "halted from {from}: {in_place}");
        }
    }

    #[test]
    fn one_long_halt_is_no_habit() {
        let (_, end) = first_due(40.0, |t| (3.0..18.0).contains(&t));
        assert!((34.0..35.0).contains(&end), "{end}");
    }
}
