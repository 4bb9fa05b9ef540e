//! Pairs colour and depth frames that are mutually nearest in time.

use recordings::types::TimestampNs;
use std::collections::VecDeque;

/// Frames of one kind that may wait for the other kind; beyond this, the oldest stays unpaired.
const LOOKAHEAD: usize = 32;

/// A frame waiting for its partner.
#[derive(Debug)]
struct Waiting<T> {
    /// Time on the colour clock.
    time: TimestampNs,
    frame: T,
}

/// A decision about the oldest frames.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Decided<C, D> {
    /// Two frames of the same instant.
    Pair(C, D),
    /// A colour frame without partner.
    Color(C),
    /// A depth frame without partner.
    Depth(D),
}

/// Pairs two streams, each in order of time, as they arrive. It holds a few frames and decides as if it knew all of them. A
/// frame that is not newer than the one before it (of its kind) stays unpaired.
#[derive(Debug)]
pub struct Pairer<C, D> {
    max_gap_ns: i64,
    color: VecDeque<Waiting<C>>,
    depth: VecDeque<Waiting<D>>,
    /// Newest frame of each kind already decided; it may be nearer than any that waits.
    last_color: Option<TimestampNs>,
    last_depth: Option<TimestampNs>,
    /// Newest frame of each kind pushed.
    newest_color: Option<TimestampNs>,
    newest_depth: Option<TimestampNs>,
    /// Frames out of order, decided on arrival.
    refused: VecDeque<Decided<C, D>>,
    ended: bool,
}

impl<C, D> Pairer<C, D> {
    /// Pairs frames at most `max_gap_ns` apart.
    #[must_use]
    pub fn new(max_gap_ns: i64) -> Self {
        Self {
            max_gap_ns,
            color: VecDeque::new(),
            depth: VecDeque::new(),
            last_color: None,
            last_depth: None,
            newest_color: None,
            newest_depth: None,
            refused: VecDeque::new(),
            ended: false,
        }
    }

    /// Takes a colour frame.
    pub fn push_color(&mut self, time: TimestampNs, frame: C) {
        if self.newest_color.is_some_and(|t| time <= t) {
            self.refused.push_back(Decided::Color(frame));
        } else {
            self.newest_color = Some(time);
            self.color.push_back(Waiting { time, frame });
        }
    }

    /// Takes a depth frame; `time` is on the colour clock.
    pub fn push_depth(&mut self, time: TimestampNs, frame: D) {
        if self.newest_depth.is_some_and(|t| time <= t) {
            self.refused.push_back(Decided::Depth(frame));
        } else {
            self.newest_depth = Some(time);
            self.depth.push_back(Waiting { time, frame });
        }
    }

    /// Ends both streams. True the first time, when more can be decided.
    pub fn end(&mut self) -> bool {
        !std::mem::replace(&mut self.ended, true)
    }

    /// The next decision; `None` until more frames are known (or, after [`Pairer::end`], when all are decided).
    pub fn decide(&mut self) -> Option<Decided<C, D>> {
        if let Some(refused) = self.refused.pop_front() {
            return Some(refused);
        }
        let color_first = match (self.color.front(), self.depth.front()) {
            (None, None) => return None,
            (Some(c), Some(d)) => c.time <= d.time,
            (c, _) => c.is_some(),
        };
        let verdict = if color_first {
            verdict(&self.color, &self.depth, self.last_depth, self.max_gap_ns, self.ended)
        } else {
            verdict(&self.depth, &self.color, self.last_color, self.max_gap_ns, self.ended)
        };
        match (verdict, color_first) {
            (Verdict::Wait, _) => None,
            (Verdict::Pair, _) => Some(Decided::Pair(self.take_color()?, self.take_depth()?)),
            (Verdict::Alone, true) => self.take_color().map(Decided::Color),
            (Verdict::Alone, false) => self.take_depth().map(Decided::Depth),
        }
    }

    fn take_color(&mut self) -> Option<C> {
        let w = self.color.pop_front()?;
        self.last_color = Some(w.time);
        Some(w.frame)
    }

    fn take_depth(&mut self) -> Option<D> {
        let w = self.depth.pop_front()?;
        self.last_depth = Some(w.time);
        Some(w.frame)
    }
}

enum Verdict {
    Wait,
    Pair,
    Alone,
}

/// Decides the oldest of all waiting frames, `own[0]`. Everything in `other` is at least as new, so its nearest partner
/// is `other[0]` or the last one decided; and the only rival for `other[0]` is `own[1]`. At equal gaps the older wins.
fn verdict<A, B>(
    own: &VecDeque<Waiting<A>>,
    other: &VecDeque<Waiting<B>>,
    last_other: Option<TimestampNs>,
    max_gap_ns: i64,
    ended: bool,
) -> Verdict {
    let Some(x) = own.front() else { return Verdict::Wait };
    let full = own.len() > LOOKAHEAD;
    let Some(partner) = other.front() else {
        return if ended || full { Verdict::Alone } else { Verdict::Wait };
    };
    // Saturating: time stamps of a damaged recording may have any value.
    let gap = partner.time.saturating_sub(x.time);
    if gap > max_gap_ns || last_other.is_some_and(|t| x.time.saturating_sub(t).saturating_abs() <= gap) {
        return Verdict::Alone;
    }
    match own.get(1) {
        Some(rival) if rival.time.saturating_sub(partner.time).saturating_abs() < gap => Verdict::Alone,
        Some(_) => Verdict::Pair,
        // A rival would have to be nearer than `x`, so none can come once a frame beyond that is known, or at the end.
        None if gap == 0 || ended || other.len() > LOOKAHEAD => Verdict::Pair,
        None => Verdict::Wait,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Mutual nearest neighbours by exhaustive search; at equal distance, the older counts as nearer.
    fn brute_force(color: &[i64], depth: &[i64], max_gap: i64) -> Vec<(i64, i64)> {
        let nearest = |x: i64, among: &[i64]| among.iter().copied().min_by_key(|&y| ((y - x).abs(), y));
        let pairs = color.iter().filter_map(|&c| nearest(c, depth).map(|d| (c, d)));
        pairs.filter(|&(c, d)| nearest(d, color) == Some(c) && (c - d).abs() <= max_gap).collect()
    }

    /// Streams both lists in order of their own arrival times, `lag` later for depth.
    fn streamed(color: &[i64], depth: &[i64], max_gap: i64, lag: i64) -> (Vec<(i64, i64)>, usize) {
        let mut events: Vec<(i64, bool, i64)> = color.iter().map(|&t| (t, true, t)).collect();
        events.extend(depth.iter().map(|&t| (t + lag, false, t)));
        events.sort_unstable();
        let mut pairer = Pairer::new(max_gap);
        let (mut pairs, mut alone) = (Vec::new(), 0);
        let mut drain = |p: &mut Pairer<i64, i64>| {
            while let Some(d) = p.decide() {
                match d {
                    Decided::Pair(c, d) => pairs.push((c, d)),
                    Decided::Color(_) | Decided::Depth(_) => alone += 1,
                }
            }
        };
        for (_, is_color, t) in events {
            if is_color {
                pairer.push_color(t, t)
            } else {
                pairer.push_depth(t, t)
            }
            drain(&mut pairer);
        }
        pairer.end();
        drain(&mut pairer);
        (pairs, alone)
    }

    fn times() -> impl Strategy<Value = Vec<i64>> {
        proptest::collection::vec(10i64..40, 0..60).prop_map(|steps| {
            steps
                .iter()
                .scan(0, |t, s| {
                    *t += s;
                    Some(*t)
                })
                .collect()
        })
    }

    proptest! {
        #[test]
        fn streaming_equals_brute_force(c in times(), d in times(), gap in 0i64..60, lag in -60i64..60) {
            let expected = brute_force(&c, &d, gap);
            let (pairs, alone) = streamed(&c, &d, gap, lag);
            prop_assert_eq!(alone, c.len() + d.len() - 2 * expected.len());
            prop_assert_eq!(pairs, expected);
        }
    }

    #[test]
    fn waiting_is_bounded_when_one_stream_stops() {
        let mut pairer: Pairer<usize, usize> = Pairer::new(20);
        for i in 0..1000 {
            pairer.push_depth(i as i64 * 33, i);
            while pairer.decide().is_some() {}
            assert!(pairer.depth.len() <= LOOKAHEAD);
        }
    }

    #[test]
    fn frames_out_of_order_go_unpaired() {
        let mut pairer = Pairer::new(20);
        pairer.push_color(100, 'a');
        pairer.push_color(100, 'b');
        pairer.push_color(i64::MIN, 'c');
        pairer.push_depth(i64::MAX, 'd');
        pairer.end();
        let all: Vec<_> = std::iter::from_fn(|| pairer.decide()).collect();
        assert_eq!(all, [Decided::Color('b'), Decided::Color('c'), Decided::Color('a'), Decided::Depth('d')]);
    }
}
