//! The text files of a TUM RGB-D folder: lists of stamped file names, and the camera file.

use crate::error::{Error, Result};
use crate::types::{CameraModel, Distortion, Intrinsics, Pose, Response, Sensor, TimestampNs};
use glam::{DQuat, DVec3};
use std::io::Read;
use std::path::{Component, Path};

/// Bytes of the longest list file that is read (some ten million frames).
const MAX_TEXT_BYTES: u64 = 1 << 28;

/// Reads a text file of bounded size.
pub(crate) fn read_text(path: &Path) -> Result<String> {
    let file = std::fs::File::open(path).map_err(|e| Error::io(path, e))?;
    let mut text = String::new();
    file.take(MAX_TEXT_BYTES + 1).read_to_string(&mut text).map_err(|e| Error::io(path, e))?;
    if text.len() as u64 > MAX_TEXT_BYTES {
        return Err(Error::invalid(path, "file too long", "this is no list of frames"));
    }
    Ok(text)
}

/// Seconds as decimal text ("1305031102.175304", also "1.3e9") to nanoseconds, exactly (rounded half up below 1 ns).
#[must_use]
pub fn parse_seconds(text: &str) -> Option<TimestampNs> {
    let (mantissa, exponent) = match text.split_once(['e', 'E']) {
        Some((m, e)) => (m, e.parse::<i32>().ok().filter(|e| e.abs() < 32)?),
        None => (text, 0),
    };
    let (negative, digits) = match mantissa.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, mantissa.strip_prefix('+').unwrap_or(mantissa)),
    };
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    if (whole.is_empty() && fraction.is_empty()) || !whole.bytes().chain(fraction.bytes()).all(|b| b.is_ascii_digit()) {
        return None;
    }
    // The value is the digits read as a whole number, times 10^shift nanoseconds.
    let shift = 9 + exponent - i32::try_from(fraction.len()).ok()?;
    let digits: Vec<u8> = whole.bytes().chain(fraction.bytes()).map(|b| b - b'0').collect();
    let kept = usize::try_from(digits.len() as i64 + i64::from(shift.min(0))).unwrap_or(0);
    let mut ns: i64 = 0;
    for d in digits[..kept].iter().copied().chain(std::iter::repeat_n(0, shift.max(0) as usize)) {
        ns = ns.checked_mul(10)?.checked_add(i64::from(d))?;
    }
    // Half up: the first digit that is cut off decides, provided it stands right behind the kept ones.
    let leading_gap = shift.min(0).unsigned_abs() as usize > digits.len();
    if !leading_gap && digits.get(kept).is_some_and(|d| *d >= 5) {
        ns = ns.checked_add(1)?;
    }
    Some(if negative { -ns } else { ns })
}

/// Nanoseconds as decimal seconds with six decimals, or nine where six would round; [`parse_seconds`] reads it back.
#[must_use]
pub fn format_seconds(ns: TimestampNs) -> String {
    let (sign, magnitude) = (if ns < 0 { "-" } else { "" }, ns.unsigned_abs());
    let (whole, fraction) = (magnitude / 1_000_000_000, magnitude % 1_000_000_000);
    if fraction.is_multiple_of(1000) {
        format!("{sign}{whole}.{:06}", fraction / 1000)
    } else {
        format!("{sign}{whole}.{fraction:09}")
    }
}

/// Reads a list of `timestamp filename` lines, sorted by time stamp (stable).
pub(crate) fn read_list(path: &Path) -> Result<Vec<(TimestampNs, String)>> {
    let text = read_text(path)?;
    let mut entries = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let bad = |what: &str| {
            Error::invalid(
                path,
                format!("line {}: {what}: `{}`", number + 1, line.chars().take(80).collect::<String>()),
                "a line is `timestamp filename`, comments begin with #",
            )
        };
        let (stamp, name) = line.split_once([' ', '\t']).ok_or_else(|| bad("no file name"))?;
        let stamp = parse_seconds(stamp).ok_or_else(|| bad("not a time stamp in seconds"))?;
        let name = name.trim();
        if !Path::new(name).components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir)) {
            return Err(bad("the file lies outside the folder"));
        }
        entries.push((stamp, name.to_owned()));
    }
    if entries.is_empty() {
        return Err(Error::invalid(path, "the list is empty", "list at least one `timestamp filename`"));
    }
    entries.sort_by_key(|(stamp, _)| *stamp);
    Ok(entries)
}

const CAMERA_HELP: &str = "write one line `fx fy cx cy depth_scale width height` (depth_scale in units per metre) and, if colour is \
     distorted, a comment `# radial-tangential k1 k2 p1 p2 k3 = …`";

/// Names of the numbers that comments of the camera file carry: `# … name name = value value …`.
const DISTORTION: &str = "k1 k2 p1 p2 k3";
const DISTORTION_SHORT: &str = "k1 k2 p1 p2";
const OFFSET: &str = "depth_to_color_offset_ns";
const GAMMA: &str = "response gamma";
const DEPTH_CAMERA: &str = "depth camera fx fy cx cy width height k1 k2 p1 p2 k3";
const COLOR_FROM_DEPTH: &str = "color_from_depth tx ty tz qx qy qz qw";

/// Reads `camera.txt`: `fx fy cx cy depth_scale width height`, with distortion in a comment.
pub(crate) fn read_camera(path: &Path) -> Result<Sensor> {
    let invalid = |problem: String| Error::invalid(path, problem, CAMERA_HELP);
    let text = match read_text(path) {
        Err(Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
            return Err(invalid("there is no camera file".into()));
        }
        other => other?,
    };
    let mut numbers: Option<Vec<f64>> = None;
    let mut distortion = Distortion::NONE;
    let mut offset_ns = 0;
    let mut response = Response::Srgb;
    let mut depth_camera = None;
    let mut color_from_depth = None;
    for (index, line) in text.lines().enumerate() {
        let line = line.trim();
        let bad = |what: &str| invalid(format!("line {}: {what}", index + 1));
        if let Some(comment) = line.strip_prefix('#') {
            let named = |names: &str| named_numbers(comment, names).transpose().map_err(|()| bad("not finite numbers"));
            if let Some(v) = named(DEPTH_CAMERA)? {
                depth_camera = Some(v);
            } else if let Some(v) = named(DISTORTION)? {
                distortion = distortion_of(&v);
            } else if let Some(v) = named(DISTORTION_SHORT)? {
                distortion = distortion_of(&[v[0], v[1], v[2], v[3], 0.0]);
            } else if let Some(v) = named(OFFSET)? {
                offset_ns = v[0] as i64;
            } else if let Some(v) = named(GAMMA)? {
                response = if v[0] == 1.0 { Response::Linear } else { Response::Gamma(v[0]) };
            } else if let Some(v) = named(COLOR_FROM_DEPTH)? {
                color_from_depth = Some(v);
            }
        } else if !line.is_empty() {
            let values: Option<Vec<f64>> =
                line.split_whitespace().map(|w| w.parse::<f64>().ok().filter(|x| x.is_finite())).collect();
            let values = values.filter(|v| v.len() == 7).ok_or_else(|| bad("not seven finite numbers"))?;
            if numbers.replace(values).is_some() {
                return Err(bad("a second camera"));
            }
        }
    }
    let v = numbers.ok_or_else(|| invalid("no line with numbers".into()))?;
    let size = |x: f64| {
        if x.fract() == 0.0 && (1.0..=65535.0).contains(&x) {
            Ok(x as u32)
        } else {
            Err(invalid(format!("{x} is no image size")))
        }
    };
    if v[4] <= 0.0 {
        return Err(invalid(format!("depth_scale {} is not positive", v[4])));
    }
    if let Response::Gamma(gamma) = response
        && gamma <= 0.0
    {
        return Err(invalid(format!("response gamma {gamma} is not positive")));
    }
    let intrinsics = Intrinsics { width: size(v[5])?, height: size(v[6])?, fx: v[0], fy: v[1], cx: v[2], cy: v[3] };
    let color = CameraModel { intrinsics, distortion };
    // Depth is registered to the ideal, undistorted colour camera unless its own camera is given.
    let depth = match &depth_camera {
        None => color.undistorted(),
        Some(d) => CameraModel {
            intrinsics: Intrinsics { width: size(d[4])?, height: size(d[5])?, fx: d[0], fy: d[1], cx: d[2], cy: d[3] },
            distortion: distortion_of(&d[6..]),
        },
    };
    if let Some(problem) = color.problem().or(depth.problem()) {
        return Err(invalid(problem.into()));
    }
    let color_from_depth = match color_from_depth {
        None => Pose::IDENTITY,
        Some(p) => {
            let rotation = DQuat::from_xyzw(p[3], p[4], p[5], p[6]);
            if (rotation.length() - 1.0).abs() > 1e-3 {
                return Err(invalid("color_from_depth: not a unit quaternion".into()));
            }
            Pose { rotation, translation: DVec3::new(p[0], p[1], p[2]) }
        }
    };
    Ok(Sensor {
        name: "TUM RGB-D folder".into(),
        serial: String::new(),
        color,
        depth,
        color_from_depth,
        depth_registered: depth_camera.is_none(),
        depth_unit_m: 1.0 / v[4],
        response,
        depth_to_color_offset_ns: offset_ns,
    })
}

fn distortion_of(v: &[f64]) -> Distortion {
    Distortion { k1: v[0], k2: v[1], p1: v[2], p2: v[3], k3: v[4] }
}

/// The numbers of a comment `… names = n n n …`: as many as it takes from behind the sign, at least one per coefficient
/// name. `None` if the comment carries no such numbers.
fn named_numbers(comment: &str, names: &str) -> Option<std::result::Result<Vec<f64>, ()>> {
    let (head, tail) = comment.split_once('=')?;
    if !head.trim_end().ends_with(names) {
        return None;
    }
    let count = match names {
        OFFSET | GAMMA => 1,
        DEPTH_CAMERA => 11,
        COLOR_FROM_DEPTH => 7,
        _ => names.split(' ').count(),
    };
    let values: Option<Vec<f64>> = tail
        .split_whitespace()
        .take(count)
        .map(|w| w.trim_end_matches([',', ';']).parse::<f64>().ok().filter(|x| x.is_finite()))
        .collect();
    Some(values.filter(|v| v.len() == count).ok_or(()))
}

/// The text of a camera file that [`read_camera`] reads back as the same cameras.
pub(crate) fn format_camera(sensor: &Sensor) -> String {
    let (i, d) = (&sensor.color.intrinsics, &sensor.color.distortion);
    let scale = 1.0 / sensor.depth_unit_m;
    let scale = if (scale - scale.round()).abs() < 1e-9 * scale { scale.round() } else { scale };
    let mut text = format!(
        "# fx fy cx cy depth_scale(png units per metre) width height\n{} {} {} {} {scale} {} {}\n",
        i.fx, i.fy, i.cx, i.cy, i.width, i.height
    );
    let numbers = |d: &Distortion| format!("{} {} {} {} {}", d.k1, d.k2, d.p1, d.p2, d.k3);
    if !d.is_none() {
        text += &format!("# colour is distorted: radial-tangential {DISTORTION} = {}\n", numbers(d));
    }
    if !sensor.depth_registered {
        let (i, d, p) = (&sensor.depth.intrinsics, &sensor.depth.distortion, &sensor.color_from_depth);
        text += &format!(
            "# {DEPTH_CAMERA} = {} {} {} {} {} {} {}\n# {COLOR_FROM_DEPTH} = {} {} {} {} {} {} {}\n",
            i.fx,
            i.fy,
            i.cx,
            i.cy,
            i.width,
            i.height,
            numbers(d),
            p.translation.x,
            p.translation.y,
            p.translation.z,
            p.rotation.x,
            p.rotation.y,
            p.rotation.z,
            p.rotation.w,
        );
    }
    if sensor.depth_to_color_offset_ns != 0 {
        text += &format!("# {OFFSET} = {}\n", sensor.depth_to_color_offset_ns);
    }
    match sensor.response {
        Response::Srgb => {}
        Response::Linear => text += &format!("# {GAMMA} = 1\n"),
        Response::Gamma(gamma) => text += &format!("# {GAMMA} = {gamma}\n"),
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn seconds_are_read_exactly() {
        for (text, ns) in [
            ("1305031102.175304", 1_305_031_102_175_304_000),
            ("0", 0),
            ("0.000000", 0),
            (".5", 500_000_000),
            ("12.", 12_000_000_000),
            ("-1.25", -1_250_000_000),
            ("0.0333333333333", 33_333_333),
            ("0.0333333335", 33_333_334),
            ("0.0000000004", 0),
            ("0.0000000005", 1),
            ("0.00000000005", 0),
            ("1.305031102175304e+09", 1_305_031_102_175_304_000),
            ("3.5e-1", 350_000_000),
            ("9e-11", 0),
        ] {
            assert_eq!(parse_seconds(text), Some(ns), "{text}");
        }
        for text in ["", "nan", "NaN", "inf", "-", ".", "1.2.3", "0x10", "1e", "1e99", "99999999999999999999", "1,5"] {
            assert_eq!(parse_seconds(text), None, "{text}");
        }
    }

    fn write(text: &str) -> (tempfile::TempDir, std::path::PathBuf) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("file.txt");
        std::fs::write(&path, text).unwrap();
        (dir, path)
    }

    #[test]
    fn lists_may_be_commented_windows_made_and_unsorted() {
        let (_dir, path) = write("# colour\r\n\r\n2.5 rgb/b name.png\r\n1.5\trgb/a.png\r\n  \n2.5   rgb/c.png");
        let list = read_list(&path).unwrap();
        let expected = [(1_500_000_000, "rgb/a.png"), (2_500_000_000, "rgb/b name.png"), (2_500_000_000, "rgb/c.png")];
        assert_eq!(list.iter().map(|(t, n)| (*t, n.as_str())).collect::<Vec<_>>(), expected);
    }

    #[test]
    fn bad_lists_name_file_line_and_remedy() {
        for (text, part) in [
            ("", "the list is empty"),
            ("# only comments", "the list is empty"),
            ("1.0 a.png\nnan b.png", "line 2: not a time stamp"),
            ("1.0", "no file name"),
            ("1.0 ../../etc/passwd", "outside the folder"),
            ("1.0 /etc/passwd", "outside the folder"),
        ] {
            let (_dir, path) = write(text);
            let message = read_list(&path).unwrap_err().to_string();
            assert!(message.contains(part) && message.contains("file.txt"), "{message}");
        }
    }

    #[test]
    fn camera_file_with_distortion() {
        let (_dir, path) = write(
            "# fx fy cx cy depth_scale(png units per metre) width height\n517.3 516.5 318.6 255.3 5000 640 480\n\
             # colour is distorted: radial-tangential k1 k2 p1 p2 k3 = 0.2624 -0.9531 -0.0054 0.0026 1.1633 (fr1); more\n",
        );
        let sensor = read_camera(&path).unwrap();
        assert_eq!(
            sensor.color.distortion,
            Distortion { k1: 0.2624, k2: -0.9531, p1: -0.0054, p2: 0.0026, k3: 1.1633 }
        );
        assert!(sensor.depth.distortion.is_none() && sensor.depth_registered);
        assert_eq!(sensor.color.intrinsics, sensor.depth.intrinsics);
        assert_eq!((sensor.color.intrinsics.fx, sensor.color.intrinsics.cy), (517.3, 255.3));
        assert_eq!(sensor.depth_unit_m, 0.0002);
    }

    #[test]
    fn camera_files_come_back() {
        let (_dir, path) = write("517.3 516.5 318.6 255.3 5000 640 480");
        let mut sensor = read_camera(&path).unwrap();
        sensor.color.distortion = Distortion { k1: 0.1, k2: -1e-9, p1: 1.0 / 3.0, p2: 0.0, k3: 2.0 };
        sensor.depth_unit_m = 0.001;
        sensor.depth_to_color_offset_ns = -19_999_999;
        sensor.response = Response::Gamma(2.2);
        std::fs::write(&path, format_camera(&sensor)).unwrap();
        assert_eq!(read_camera(&path).unwrap(), sensor);
        sensor.depth_registered = false;
        sensor.depth.intrinsics = Intrinsics { width: 320, height: 240, fx: 290.0, fy: 291.5, cx: 160.25, cy: 120.0 };
        sensor.depth.distortion.k1 = 0.01;
        sensor.color_from_depth = Pose::new(DQuat::from_xyzw(0.01, 0.02, 0.0, 1.0), DVec3::new(0.025, 0.0, 1e-4));
        sensor.response = Response::Linear;
        std::fs::write(&path, format_camera(&sensor)).unwrap();
        assert_eq!(read_camera(&path).unwrap(), sensor);
    }

    #[test]
    fn bad_camera_files_say_what_to_write() {
        for text in [
            "",
            "1 2 3",
            "525 525 320 240 nan 640 480",
            "525 525 320 240 0 640 480",
            "525 525 320 240 5000 640.5 480",
            "525 525 320 240 5000 0 480",
            "525 525 320 240 5000 640 99999999",
            "-525 525 320 240 5000 640 480",
            "525 525 320 240 5000 640 480\n525 525 320 240 5000 640 480",
            "525 525 320 240 5000 640 480\n# k1 k2 p1 p2 k3 = 1 2 3",
            "525 525 320 240 5000 640 480\n# k1 k2 p1 p2 k3 = 1 2 3 4 inf",
        ] {
            let (_dir, path) = write(text);
            let message = read_camera(&path).unwrap_err().to_string();
            assert!(message.contains("fx fy cx cy depth_scale width height"), "{text}: {message}");
        }
        assert!(read_camera(Path::new("/nowhere/camera.txt")).unwrap_err().to_string().contains("no camera file"));
    }

    proptest! {
        #[test]
        fn stamps_come_back(ns in any::<i64>()) {
            prop_assume!(ns != i64::MIN);
            prop_assert_eq!(parse_seconds(&format_seconds(ns)), Some(ns));
        }

        #[test]
        fn any_text_is_read_or_refused(text in "[0-9eE.+#= \\-k1p2\n/a]{0,60}") {
            let _ = parse_seconds(&text);
            let (_dir, path) = write(&text);
            let _ = read_list(&path);
            let _ = read_camera(&path);
        }
    }
}
