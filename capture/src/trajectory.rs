//! `trajectory.txt` in the TUM format: one line per tracked frame, with the colour frame's own time stamp.

use recordings::types::{Pose, TimestampNs};
use std::fmt::Write;

/// `timestamp tx ty tz qx qy qz qw` (seconds, metres, camera-to-world).
#[must_use]
pub fn to_tum(trajectory: &[(TimestampNs, Pose)]) -> String {
    let mut text = String::from("# timestamp tx ty tz qx qy qz qw\n");
    for (time, pose) in trajectory {
        let (t, q) = (pose.translation, pose.rotation);
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{} {:.7} {:.7} {:.7} {:.8} {:.8} {:.8} {:.8}",
            seconds(*time),
            t.x,
            t.y,
            t.z,
            q.x,
            q.y,
            q.z,
            q.w
        );
    }
    text
}

/// Exact decimal seconds: microseconds where that is exact, as TUM writes them, otherwise nanoseconds.
fn seconds(time: TimestampNs) -> String {
    let (sign, t) = (if time < 0 { "-" } else { "" }, time.unsigned_abs());
    let (whole, ns) = (t / 1_000_000_000, t % 1_000_000_000);
    if ns % 1000 == 0 { format!("{sign}{whole}.{:06}", ns / 1000) } else { format!("{sign}{whole}.{ns:09}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_exact() {
        assert_eq!(seconds(1_305_031_102_175_304_000), "1305031102.175304");
        assert_eq!(seconds(1_305_031_102_175_304_001), "1305031102.175304001");
        assert_eq!(seconds(0), "0.000000");
        assert_eq!(seconds(-1_500_000_000), "-1.500000");
    }
}
