//! `trajectory.txt` in the TUM format: one line per tracked frame, with the time stamp of its colour frame.

use recordings::format_seconds;
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
            format_seconds(*time),
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
