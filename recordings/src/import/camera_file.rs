//! The camera file of a TUM RGB-D folder: one line of numbers, further cameras and corrections in comments.

use crate::error::{Error, Result};
use crate::import::lists::read_text;
use crate::shoulder::MAX_STRENGTH;
use crate::types::{CameraModel, Distortion, Intrinsics, Pose, Response, Sensor};
use glam::{DQuat, DVec3};
use std::path::Path;

const CAMERA_HELP: &str = "write one line `fx fy cx cy depth_scale width height` (depth_scale in units per metre) and, if colour is \
     distorted, a comment `# radial-tangential k1 k2 p1 p2 k3 = …`";

/// Names of the numbers that comments of the camera file carry: `# … name name = value value …`.
const DISTORTION: &str = "k1 k2 p1 p2 k3";
const DISTORTION_SHORT: &str = "k1 k2 p1 p2";
const OFFSET: &str = "depth_to_color_offset_ns";
const GAMMA: &str = "response gamma";
const SHOULDER: &str = "response shoulder";
const DEPTH_CAMERA: &str = "depth camera fx fy cx cy width height k1 k2 p1 p2 k3";
const COLOR_FROM_DEPTH: &str = "color_from_depth tx ty tz qx qy qz qw";

/// What the lines of a camera file hold.
struct CameraFile {
    /// `fx fy cx cy depth_scale width height`.
    numbers: Option<Vec<f64>>,
    distortion: Distortion,
    depth_to_color_offset_ns: i64,
    response: Response,
    /// Intrinsics and distortion of a depth camera of its own.
    depth_camera: Option<Vec<f64>>,
    /// Translation and quaternion.
    color_from_depth: Option<Vec<f64>>,
}

impl CameraFile {
    fn parse(text: &str) -> std::result::Result<Self, String> {
        let mut file = Self {
            numbers: None,
            distortion: Distortion::NONE,
            depth_to_color_offset_ns: 0,
            response: Response::Srgb,
            depth_camera: None,
            color_from_depth: None,
        };
        for (index, line) in text.lines().enumerate() {
            let line = line.trim();
            let bad = |what: &str| format!("line {}: {what}", index + 1);
            if let Some(comment) = line.strip_prefix('#') {
                file.comment(comment).map_err(|()| bad("not finite numbers"))?;
            } else if !line.is_empty() {
                let values: Option<Vec<f64>> =
                    line.split_whitespace().map(|w| w.parse::<f64>().ok().filter(|x| x.is_finite())).collect();
                let values = values.filter(|v| v.len() == 7).ok_or_else(|| bad("not seven finite numbers"))?;
                if file.numbers.replace(values).is_some() {
                    return Err(bad("a second camera"));
                }
            }
        }
        Ok(file)
    }

    /// Takes the numbers of a comment of a known kind.
    fn comment(&mut self, comment: &str) -> std::result::Result<(), ()> {
        let named = |names: &str| named_numbers(comment, names).transpose();
        if let Some(v) = named(DEPTH_CAMERA)? {
            self.depth_camera = Some(v);
        } else if let Some(v) = named(DISTORTION)? {
            self.distortion = distortion_of(&v);
        } else if let Some(v) = named(DISTORTION_SHORT)? {
            self.distortion = distortion_of(&[v[0], v[1], v[2], v[3], 0.0]);
        } else if let Some(v) = named(OFFSET)? {
            self.depth_to_color_offset_ns = v[0] as i64;
        } else if let Some(v) = named(GAMMA)? {
            self.response = if v[0] == 1.0 { Response::Linear } else { Response::Gamma(v[0]) };
        } else if let Some(v) = named(SHOULDER)? {
            self.response = Response::Shoulder(v[0]);
        } else if let Some(v) = named(COLOR_FROM_DEPTH)? {
            self.color_from_depth = Some(v);
        }
        Ok(())
    }

    fn sensor(self) -> std::result::Result<Sensor, String> {
        let v = self.numbers.ok_or("no line with numbers")?;
        if v[4] <= 0.0 {
            return Err(format!("depth_scale {} is not positive", v[4]));
        }
        if let Response::Gamma(gamma) = self.response
            && gamma <= 0.0
        {
            return Err(format!("response gamma {gamma} is not positive"));
        }
        if let Response::Shoulder(strength) = self.response
            && !(0.0..=MAX_STRENGTH).contains(&strength)
        {
            return Err(format!("response shoulder {strength} is not between 0 and {MAX_STRENGTH}"));
        }
        let color = CameraModel { intrinsics: intrinsics(&v[..4], v[5], v[6])?, distortion: self.distortion };
        // Depth is registered to the ideal, undistorted colour camera unless its own camera is given.
        let depth = match &self.depth_camera {
            None => color.undistorted(),
            Some(d) => CameraModel { intrinsics: intrinsics(&d[..4], d[4], d[5])?, distortion: distortion_of(&d[6..]) },
        };
        if let Some(problem) = color.problem().or(depth.problem()) {
            return Err(problem.into());
        }
        let color_from_depth = self.color_from_depth.map_or(Ok(Pose::IDENTITY), |p| {
            let rotation = DQuat::from_xyzw(p[3], p[4], p[5], p[6]);
            let is_unit = (rotation.length() - 1.0).abs() <= 1e-3;
            is_unit.then(|| Pose { rotation, translation: DVec3::new(p[0], p[1], p[2]) }).ok_or("not a unit quaternion")
        });
        Ok(Sensor {
            name: "TUM RGB-D folder".into(),
            serial: String::new(),
            color,
            depth,
            color_from_depth: color_from_depth.map_err(|e| format!("color_from_depth: {e}"))?,
            depth_registered: self.depth_camera.is_none(),
            depth_unit_m: 1.0 / v[4],
            response: self.response,
            depth_to_color_offset_ns: self.depth_to_color_offset_ns,
        })
    }
}

/// Intrinsics from `fx fy cx cy` and an image size in pixels.
fn intrinsics(v: &[f64], width: f64, height: f64) -> std::result::Result<Intrinsics, String> {
    let size = |x: f64| {
        let whole = x.fract() == 0.0 && (1.0..=65535.0).contains(&x);
        whole.then_some(x as u32).ok_or_else(|| format!("{x} is no image size"))
    };
    Ok(Intrinsics { width: size(width)?, height: size(height)?, fx: v[0], fy: v[1], cx: v[2], cy: v[3] })
}

/// Reads `camera.txt`: `fx fy cx cy depth_scale width height`, further numbers in comments.
pub(crate) fn read_camera(path: &Path) -> Result<Sensor> {
    let invalid = |problem: String| Error::invalid(path, problem, CAMERA_HELP);
    let text = match read_text(path) {
        Err(Error::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
            return Err(invalid("there is no camera file".into()));
        }
        other => other?,
    };
    CameraFile::parse(&text).and_then(CameraFile::sensor).map_err(invalid)
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
        OFFSET | GAMMA | SHOULDER => 1,
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
        Response::Shoulder(strength) => text += &format!("# {SHOULDER} = {strength}\n"),
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::text_file;
    use proptest::prelude::*;

    #[test]
    fn camera_file_with_distortion() {
        let (_dir, path) = text_file(
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
        let (_dir, path) = text_file("517.3 516.5 318.6 255.3 5000 640 480");
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
        for response in [Response::Linear, Response::Shoulder(0.9)] {
            sensor.response = response;
            std::fs::write(&path, format_camera(&sensor)).unwrap();
            assert_eq!(read_camera(&path).unwrap(), sensor);
        }
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
            "525 525 320 240 5000 640 480\n# response shoulder = -1",
            "525 525 320 240 5000 640 480\n# k1 k2 p1 p2 k3 = 1 2 3",
            "525 525 320 240 5000 640 480\n# k1 k2 p1 p2 k3 = 1 2 3 4 inf",
        ] {
            let (_dir, path) = text_file(text);
            let message = read_camera(&path).unwrap_err().to_string();
            assert!(message.contains("fx fy cx cy depth_scale width height"), "{text}: {message}");
        }
        assert!(read_camera(Path::new("/nowhere/camera.txt")).unwrap_err().to_string().contains("no camera file"));
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "[0-9eE.+#= \\-k1p2\n/a]{0,60}") {
            let (_dir, path) = text_file(&text);
            let _ = read_camera(&path);
        }
    }
}
