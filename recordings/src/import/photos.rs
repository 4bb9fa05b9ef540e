//! Mesh and posed photos (`mesh.ply`, `transforms.json` in the NeRF convention) straight to a scan.

use crate::codec::image::PictureHeader;
use crate::error::{Error, Result};
use crate::import::transforms::{REMEDY, Transforms};
use crate::import::tum::read_picture;
use crate::ply::read::read_ply;
use crate::scan::{CaptureStats, Scan, ScanSource};
use crate::types::{ColorFrame, Keyframe, Pose, Response, Sensor};
use std::path::{Path, PathBuf};

/// Endings tried for a `file_path` that names no file.
const ENDINGS: [&str; 6] = ["png", "jpg", "jpeg", "PNG", "JPG", "JPEG"];

/// Reads `dir/transforms.json`, its pictures, and the mesh (`mesh`, by default `dir/mesh.ply`). Every frame becomes a
/// keyframe, in the order and under the name of the file; there are no witnesses.
///
/// # Errors
/// Missing files, a mesh without triangles or with NaN, poses that are no rigid transforms, truncated pictures.
pub fn import_photos(dir: &Path, mesh: Option<&Path>) -> Result<Scan> {
    if !dir.is_dir() {
        return Err(Error::invalid(dir, "no such folder", "give a folder with transforms.json and mesh.ply"));
    }
    let path = dir.join("transforms.json");
    let invalid = |problem: String| Error::invalid(&path, problem, REMEDY);
    if !path.is_file() {
        return Err(Error::invalid(
            dir,
            "there is no transforms.json",
            "give a folder with transforms.json and mesh.ply",
        ));
    }
    let transforms = Transforms::read(&path)?;
    let mesh = match mesh {
        Some(mesh) => mesh.to_path_buf(),
        None => dir.join("mesh.ply"),
    };
    let mesh = read_ply(&mesh)?;
    let mut keyframes = Vec::new();
    for (index, frame) in transforms.frames.iter().enumerate() {
        let name = &frame.file_path;
        let in_frame = |problem: String| invalid(format!("frame {index} (`{name}`): {problem}"));
        let picture = find_picture(dir, name).ok_or_else(|| in_frame("there is no such picture".into()))?;
        let bytes = read_picture(&picture)?;
        let header = PictureHeader::read(&bytes)
            .map_err(|problem| Error::invalid(&picture, problem, "replace the picture, or remove its frame"))?;
        let (width, height) = (header.width, header.height);
        let camera = transforms.camera(frame, width, height).map_err(in_frame)?;
        let world_from_camera = frame.pose().map_err(in_frame)?;
        let time_s = frame.time_s.unwrap_or(index as f64);
        if !time_s.is_finite() || time_s.abs() > 1e9 * 9.0 {
            return Err(in_frame(format!("time_s {time_s}")));
        }
        let timestamp_ns = (time_s * 1e9).round() as i64;
        let encoding = header.encoding;
        let color = ColorFrame { timestamp_ns, width, height, encoding, bytes, missing_packets: 0 };
        keyframes.push(Keyframe { name: name.clone(), world_from_camera, camera, color });
    }
    let Some(first) = keyframes.first() else {
        return Err(invalid("there are no frames".into()));
    };
    let sensor = Sensor {
        name: "posed photos".into(),
        serial: String::new(),
        color: first.camera,
        depth: first.camera.undistorted(),
        color_from_depth: Pose::IDENTITY,
        depth_registered: true,
        depth_unit_m: 0.001,
        response: Response::Srgb,
        depth_to_color_offset_ns: 0,
    };
    let name = dir.canonicalize().ok().and_then(|d| Some(d.file_name()?.to_string_lossy().into_owned()));
    Ok(Scan {
        name: name.unwrap_or_else(|| "photos".into()),
        source: ScanSource::Photos,
        sensor,
        mesh,
        keyframes,
        witnesses: Vec::new(),
        config: String::new(),
        stats: CaptureStats::default(),
    })
}

fn find_picture(dir: &Path, name: &str) -> Option<PathBuf> {
    if name.is_empty() || Path::new(name).is_absolute() {
        return None;
    }
    let with_ending = |ending: &str| dir.join(format!("{name}.{ending}"));
    let mut candidates = std::iter::once(dir.join(name)).chain(ENDINGS.map(with_ending));
    candidates.find(|path| path.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ply::write::write_ply;
    use crate::testing::{GRADIENT_JPEG, bumpy_mesh, refuses_damage};
    use glam::DVec3;

    const FRAMES: &str = r#"{"fl_x": 30, "w": 32, "h": 24, "k1": 0.1, "p2": 0.01, "frames": [
        {"file_path": "images/b", "transform_matrix": [[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]], "time_s": 2.5},
        {"file_path": "./images/a.jpg", "transform_matrix": [[1,0,0,0],[0,0,-1,0],[0,1,0,0]], "fl_x": 40, "cx": 3, "k1": 0}]}"#;

    fn write_mesh(path: &Path, side: u32) {
        let mut file = std::fs::File::create(path).unwrap();
        write_ply(&mut file, "", &bumpy_mesh(side), &[]).unwrap();
    }

    fn folder(transforms: &str) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        std::fs::create_dir(dir.path().join("images")).unwrap();
        for name in ["images/a.jpg", "images/b.jpeg"] {
            std::fs::write(dir.path().join(name), GRADIENT_JPEG).unwrap();
        }
        write_mesh(&dir.path().join("mesh.ply"), 5);
        std::fs::write(dir.path().join("transforms.json"), transforms).unwrap();
        dir
    }

    #[test]
    fn frames_keep_names_order_and_their_own_intrinsics() {
        let dir = folder(FRAMES);
        let scan = import_photos(dir.path(), None).unwrap();
        let names: Vec<&str> = scan.keyframes.iter().map(|k| k.name.as_str()).collect();
        assert_eq!(names, ["images/b", "./images/a.jpg"]);
        let [b, a] = [&scan.keyframes[0], &scan.keyframes[1]];
        assert_eq!((b.color.timestamp_ns, a.color.timestamp_ns), (2_500_000_000, 1_000_000_000));
        let i = b.camera.intrinsics;
        assert_eq!((i.width, i.height, i.fx, i.fy, i.cx, i.cy), (32, 24, 30.0, 30.0, 15.5, 11.5));
        assert_eq!((b.camera.distortion.k1, b.camera.distortion.p2), (0.1, 0.01));
        assert_eq!((a.camera.intrinsics.fx, a.camera.intrinsics.cx, a.camera.distortion.k1), (40.0, 3.0, 0.0));
        // An OpenGL camera without rotation looks along the world's −Z, its image's down is −Y.
        assert!((b.world_from_camera.transform(DVec3::Z) - DVec3::new(1.0, 2.0, 2.0)).length() < 1e-12);
        assert!((b.world_from_camera.transform(DVec3::Y) - DVec3::new(1.0, 1.0, 3.0)).length() < 1e-12);
        assert_eq!(b.color.bytes, GRADIENT_JPEG);
        assert!(scan.witnesses.is_empty() && scan.source == ScanSource::Photos);
        let other = dir.path().join("images/other.ply");
        write_mesh(&other, 3);
        assert_eq!(import_photos(dir.path(), Some(&other)).unwrap().mesh.positions.len(), 9);
    }

    #[test]
    fn field_of_view_stands_in_for_focal_length() {
        let dir = folder(&FRAMES.replace("\"fl_x\": 30", "\"camera_angle_x\": 1.5707963267948966"));
        let scan = import_photos(dir.path(), None).unwrap();
        assert!((scan.keyframes[0].camera.intrinsics.fx - 16.0).abs() < 1e-9);
    }

    #[test]
    fn bad_folders_are_explained() {
        for (from, to, part) in [
            ("\"fl_x\": 30, ", "", "neither fl_x nor"),
            ("\"fl_x\": 30", "\"fl_x\": -30", "focal length"),
            ("\"w\": 32", "\"w\": 64", "32 pixels wide, the intrinsics are for 64"),
            ("[1,0,0,1]", "[2,0,0,1]", "no rigid"),
            ("[1,0,0,1]", "[null,0,0,1]", "transforms.json"),
            ("[1,0,0,1],", "", "no rigid"),
            ("[0,0,0,1]", "[0,0,1,1]", "no rigid"),
            ("images/b", "images/c", "no such picture"),
            ("images/b", "/etc/hostname", "no such picture"),
            ("\"time_s\": 2.5", "\"time_s\": 1e300", "time_s"),
            ("\"w\": 32", "\"camera_model\": \"OPENCV_FISHEYE\"", "undistort"),
            ("{\"fl_x\"", "[\"fl_x\"", "transforms.json"),
        ] {
            assert!(FRAMES.contains(from), "{from}");
            let dir = folder(&FRAMES.replacen(from, to, 1));
            let message = import_photos(dir.path(), None).unwrap_err().to_string();
            assert!(message.contains(part), "{from} → {to}: {message}");
        }
        let dir = folder("{\"fl_x\": 30, \"frames\": []}");
        assert!(import_photos(dir.path(), None).unwrap_err().to_string().contains("no frames"));
        for file in ["mesh.ply", "transforms.json", "images/a.jpg"] {
            let dir = folder(FRAMES);
            std::fs::write(dir.path().join("damaged"), "").unwrap();
            let path = dir.path().join(file);
            let whole = std::fs::read(&path).unwrap();
            for length in [0, whole.len() / 2, whole.len() - 1] {
                std::fs::write(&path, &whole[..length]).unwrap();
                let outcome = import_photos(dir.path(), None);
                assert!(outcome.is_err() || file == "transforms.json" && length + 1 == whole.len(), "{file} {length}");
            }
            std::fs::remove_file(&path).unwrap();
            assert!(
                import_photos(dir.path(), None).unwrap_err().to_string().contains(file.rsplit('/').next().unwrap())
            );
        }
        assert!(import_photos(Path::new("/nowhere"), None).unwrap_err().to_string().contains("no such folder"));
    }

    #[test]
    fn an_imported_scan_can_be_stored() {
        let dir = folder(FRAMES);
        let scan = import_photos(dir.path(), None).unwrap();
        let path = dir.path().join("a.lscan");
        scan.write(&path).unwrap();
        assert_eq!(Scan::read(&path).unwrap(), scan);
        refuses_damage(&path, Scan::read);
    }
}
