//! Camera paths in the TUM format: a line a frame, `timestamp tx ty tz qx qy qz qw` (seconds, metres, camera-to-world,
//! OpenCV axes).

use crate::error::{Error, Result};
use crate::import::lists::{format_seconds, parse_seconds, read_text};
use crate::types::{Pose, TimestampNs};
use glam::{DQuat, DVec3};
use std::fmt::Write;
use std::path::Path;

/// Reads a trajectory; comments begin with #.
///
/// # Errors
/// The file cannot be read, or a line is not a time stamp and seven finite numbers.
pub fn read_trajectory(path: &Path) -> Result<Vec<(TimestampNs, Pose)>> {
    let text = read_text(path)?;
    let lines = text.lines().enumerate().map(|(number, line)| (number, line.trim()));
    let poses = lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#')).map(|(number, line)| {
        parse_line(line).ok_or_else(|| {
            let shown: String = line.chars().take(80).collect();
            let remedy = "a line is `timestamp tx ty tz qx qy qz qw`, comments begin with #";
            Error::invalid(path, format!("line {}: not a pose: `{shown}`", number + 1), remedy)
        })
    });
    poses.collect()
}

fn parse_line(line: &str) -> Option<(TimestampNs, Pose)> {
    let mut fields = line.split_whitespace();
    let time = parse_seconds(fields.next()?)?;
    let numbers: Vec<f64> = fields.map(str::parse).collect::<std::result::Result<_, _>>().ok()?;
    let [tx, ty, tz, qx, qy, qz, qw] = numbers.try_into().ok()?;
    let pose = Pose::new(DQuat::from_xyzw(qx, qy, qz, qw), DVec3::new(tx, ty, tz));
    (pose.rotation.is_finite() && pose.translation.is_finite()).then_some((time, pose))
}

/// The text of a trajectory that [`read_trajectory`] reads back, to 0.1 µm.
#[must_use]
pub fn format_trajectory(trajectory: &[(TimestampNs, Pose)]) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trajectories_come_back_and_bad_lines_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("trajectory.txt");
        let pose = Pose::new(DQuat::from_xyzw(0.1, -0.2, 0.3, 0.9), DVec3::new(1.0, -2.0, 0.5));
        let written = [(1_305_031_102_175_304_000, pose), (1_305_031_102_208_637_333, Pose::IDENTITY)];
        std::fs::write(&path, format_trajectory(&written)).unwrap();
        let back = read_trajectory(&path).unwrap();
        assert_eq!(back.len(), 2);
        for ((a, p), (b, q)) in written.iter().zip(&back) {
            assert_eq!(a, b);
            assert!(p.translation.distance(q.translation) < 1e-7 && p.rotation.angle_between(q.rotation) < 1e-7);
        }
        for bad in ["1.0 0 0 0 0 0 0", "x 0 0 0 0 0 0 1", "1 0 0 0 0 0 0 nan", "1 0 0 0 0 0 0 0"] {
            std::fs::write(&path, format!("# path\n{bad}\n")).unwrap();
            assert!(read_trajectory(&path).unwrap_err().to_string().contains("line 2"), "{bad}");
        }
    }
}
