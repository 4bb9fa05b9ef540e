//! Viewpoints of pictures: keyframes, validation frames (`witness:N`), an orbit, or cameras from a file.

use crate::rays::RayScene;
use crate::render::compose::Viewpoint;
use crate::render::error::{RenderError, Result};
use glam::{DMat3, DQuat, DVec3, Vec3};
use recordings::import::transforms::{Frame, Transforms};
use recordings::result::Estimate;
use recordings::scan::Scan;
use recordings::types::{CameraModel, ColorFrame, Distortion, Intrinsics, Mesh, Pose};
use std::path::{Path, PathBuf};

/// Which views are wanted.
#[derive(Debug, Clone, PartialEq)]
pub enum ViewChoice {
    /// One keyframe by its number.
    Keyframe(usize),
    /// One validation frame by its number.
    Validation(usize),
    /// Every keyframe.
    All,
    /// A full turn around the scan in this many frames.
    Orbit(usize),
    /// Cameras in the `transforms.json` convention.
    File(PathBuf),
}

/// Frames of an orbit unless a number is given.
const ORBIT_FRAMES: usize = 72;
/// Frames that one command renders at most.
const MAX_FRAMES: usize = 10_000;
/// Size in pixels of a camera from a file that gives none.
const DEFAULT_SIZE: (f64, f64) = (640.0, 480.0);
/// Elevation of the orbit in radian.
const ORBIT_ELEVATION: f64 = 0.6;

impl std::str::FromStr for ViewChoice {
    type Err = String;
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let number = |s: &str| s.parse::<usize>().map_err(|_| format!("`{s}` is not a number"));
        Ok(match text.split_once(':') {
            Some(("keyframe", n)) => Self::Keyframe(number(n)?),
            Some(("witness", n)) => Self::Validation(number(n)?),
            Some(("orbit", n)) => Self::Orbit(number(n)?.clamp(1, MAX_FRAMES)),
            None if text == "all" => Self::All,
            None if text == "orbit" => Self::Orbit(ORBIT_FRAMES),
            _ if text.ends_with(".json") => Self::File(text.into()),
            _ => return Err("must be keyframe:N, witness:N, all, orbit[:FRAMES] or a .json file".into()),
        })
    }
}

/// A view and, where it is one, the picture taken there.
#[derive(Debug, Clone)]
pub struct View {
    /// The camera.
    pub viewpoint: Viewpoint,
    /// The picture, undecoded.
    pub photo: Option<ColorFrame>,
}

/// The views of a choice.
///
/// # Errors
/// A keyframe or validation frame that does not exist, a file that cannot be read.
pub fn views(
    choice: &ViewChoice,
    estimate: &Estimate,
    scan: Option<&Scan>,
    size: Option<(u32, u32)>,
) -> Result<Vec<View>> {
    let photo = |name: &str| {
        let all = scan.into_iter().flat_map(|s| s.keyframes.iter().chain(&s.witnesses));
        all.filter(|k| k.name == name).map(|k| k.color.clone()).next()
    };
    let keyframe = |n: usize| -> Result<View> {
        let k = estimate.keyframes.get(n).ok_or_else(|| {
            RenderError::Request(format!(
                "there is no keyframe {n}: the result has {}, from 0",
                estimate.keyframes.len()
            ))
        })?;
        let gain = Vec3::from(k.gain.map(|g| g as f32));
        let viewpoint = Viewpoint { camera: k.camera, world_from_camera: k.world_from_camera, gain };
        Ok(View { viewpoint, photo: photo(&k.name) })
    };
    let mut views = match choice {
        ViewChoice::Keyframe(n) => vec![keyframe(*n)?],
        ViewChoice::All => (0..estimate.keyframes.len()).map(keyframe).collect::<Result<_>>()?,
        ViewChoice::Validation(n) => {
            let scan = scan
                .ok_or_else(|| RenderError::Request("views of validation frames need the scan: --scan FILE".into()))?;
            let w = scan.witnesses.get(*n).ok_or_else(|| {
                RenderError::Request(format!(
                    "there is no validation frame {n} (witness:{n}): the scan has {}",
                    scan.witnesses.len()
                ))
            })?;
            let viewpoint = Viewpoint { camera: w.camera, world_from_camera: w.world_from_camera, gain: Vec3::ONE };
            vec![View { viewpoint, photo: Some(w.color.clone()) }]
        }
        ViewChoice::Orbit(frames) => orbit(estimate, *frames),
        ViewChoice::File(path) => from_file(path)?,
    };
    if views.is_empty() {
        return Err(RenderError::Request("there is no view to render".into()));
    }
    if let Some((width, height)) = size {
        for view in &mut views {
            let i = &mut view.viewpoint.camera.intrinsics;
            let (sx, sy) = (f64::from(width) / f64::from(i.width), f64::from(height) / f64::from(i.height));
            if (sx, sy) != (1.0, 1.0) {
                view.photo = None;
            }
            *i = Intrinsics {
                width,
                height,
                fx: i.fx * sx,
                fy: i.fy * sy,
                cx: (i.cx + 0.5) * sx - 0.5,
                cy: (i.cy + 0.5) * sy - 0.5,
            };
        }
    }
    Ok(views)
}

/// True if some ray of the view meets the scan.
#[must_use]
pub fn sees(view: &Viewpoint, scene: &RayScene) -> bool {
    let (w, h) = view.size();
    let eye = view.world_from_camera.translation.as_vec3();
    (0..400).any(|i| {
        let (x, y) = ((i % 20) as f32 / 19.0 * (w - 1) as f32, (i / 20) as f32 / 19.0 * (h - 1) as f32);
        scene.occluded(eye, view.ray(x, y))
    })
}

/// A camera at `eye` that looks at `target`, +Z up.
fn look_at(eye: DVec3, target: DVec3) -> Pose {
    let forward = (target - eye).normalize();
    let right = forward.cross(DVec3::Z).try_normalize().unwrap_or(DVec3::X);
    let down = forward.cross(right);
    Pose::new(DQuat::from_mat3(&DMat3::from_cols(right, down, forward)), eye)
}

/// Middle of the mesh and the distance that most of its vertices lie within.
fn extent(mesh: &Mesh) -> (DVec3, f64) {
    let n = mesh.positions.len().max(1);
    let middle = mesh.positions.iter().map(|p| p.as_dvec3()).sum::<DVec3>() / n as f64;
    let mut far: Vec<f64> = mesh.positions.iter().map(|p| p.as_dvec3().distance(middle)).collect();
    far.sort_by(f64::total_cmp);
    (middle, far.get(n * 9 / 10).copied().unwrap_or(1.0).max(1e-6))
}

fn orbit(estimate: &Estimate, frames: usize) -> Vec<View> {
    let (middle, radius) = extent(&estimate.mesh);
    let default = CameraModel {
        intrinsics: Intrinsics { width: 640, height: 480, fx: 525.0, fy: 525.0, cx: 319.5, cy: 239.5 },
        distortion: Distortion::default(),
    };
    let camera = estimate.keyframes.first().map_or(default, |k| k.camera.undistorted());
    let i = camera.intrinsics;
    let distance = radius * 1.1 / (f64::from(i.width.min(i.height)) / 2.0 / i.fx.max(i.fy)).min(1.0);
    let (sin, cos) = libm::sincos(ORBIT_ELEVATION);
    (0..frames)
        .map(|f| {
            let (s, c) = libm::sincos(std::f64::consts::TAU * f as f64 / frames as f64);
            let eye = middle + DVec3::new(c * cos, s * cos, sin) * distance;
            let viewpoint = Viewpoint { camera, world_from_camera: look_at(eye, middle), gain: Vec3::ONE };
            View { viewpoint, photo: None }
        })
        .collect()
}

/// Cameras of a `transforms.json`, without their distortion.
fn from_file(path: &Path) -> Result<Vec<View>> {
    let transforms = Transforms::read(path)?;
    if transforms.frames.len() > MAX_FRAMES {
        return Err(RenderError::file(path, format!("more than {MAX_FRAMES} frames")));
    }
    let view = |frame: &Frame| -> std::result::Result<View, String> {
        let (width, height) = transforms.size(frame).unwrap_or(DEFAULT_SIZE);
        if !(1.0..=8192.0).contains(&width) || !(1.0..=8192.0).contains(&height) {
            return Err(format!("{width}x{height} is out of range: 1 to 8192 pixels a side"));
        }
        let camera = transforms.camera(frame, width as u32, height as u32)?.undistorted();
        let viewpoint = Viewpoint { camera, world_from_camera: frame.pose()?, gain: Vec3::ONE };
        Ok(View { viewpoint, photo: None })
    };
    let views = transforms.frames.iter().map(view).collect::<std::result::Result<_, _>>();
    views.map_err(|problem| RenderError::file(path, problem))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn choices_are_read() {
        assert_eq!("keyframe:4".parse(), Ok(ViewChoice::Keyframe(4)));
        assert_eq!("orbit".parse(), Ok(ViewChoice::Orbit(ORBIT_FRAMES)));
        assert_eq!("orbit:8".parse(), Ok(ViewChoice::Orbit(8)));
        assert_eq!("a/b.json".parse(), Ok(ViewChoice::File("a/b.json".into())));
        assert!("keyframe:x".parse::<ViewChoice>().is_err() && "sideways".parse::<ViewChoice>().is_err());
    }

    #[test]
    fn an_orbit_camera_has_its_target_in_the_middle_and_up_above() {
        let pose = look_at(DVec3::new(2.0, 1.0, 1.0), DVec3::ZERO).inverse();
        let p = pose.transform(DVec3::ZERO);
        assert!(p.x.abs() < 1e-12 && p.y.abs() < 1e-12 && p.z > 0.0, "{p}");
        assert!(pose.transform(DVec3::Z * 0.1).y < 0.0);
    }
}
