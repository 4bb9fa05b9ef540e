//! Cameras and pictures for other reconstruction tools: COLMAP's text model, and `transforms.json` (NeRF).

use glam::DQuat;
use recordings::result::{Estimate, ResultKeyframe};
use recordings::scan::Scan;
use recordings::types::ColorEncoding;
use recordings::types::Response;
use serde_json::json;
use std::fmt::Write as _;
use std::io::{Error, Result};
use std::path::Path;

/// Writes `cameras.txt`, `images.txt`, `points3D.txt` and `images/` into the folder `dir`.
///
/// # Errors
/// The disk is full or gone, or a picture cannot be decoded.
pub fn write_colmap(result: &Estimate, scan: &Scan, dir: &Path) -> Result<()> {
    let (mut cameras, mut images) = (String::new(), String::new());
    for (k, keyframe) in result.keyframes.iter().enumerate() {
        let (i, d) = (&keyframe.camera.intrinsics, &keyframe.camera.distortion);
        // COLMAP's pixel centres stand at halves. OPENCV knows no k3; FULL_OPENCV does.
        let _ = writeln!(
            cameras,
            "{} FULL_OPENCV {} {} {} {} {} {} {} {} {} {} {} 0 0 0",
            k + 1,
            i.width,
            i.height,
            i.fx,
            i.fy,
            i.cx + 0.5,
            i.cy + 0.5,
            d.k1,
            d.k2,
            d.p1,
            d.p2,
            d.k3
        );
        let camera_from_world = keyframe.world_from_camera.inverse();
        let (q, t): (DQuat, _) = (camera_from_world.rotation, camera_from_world.translation);
        let name = picture_name(k);
        let _ =
            writeln!(images, "{} {} {} {} {} {} {} {} {} {name}\n", k + 1, q.w, q.x, q.y, q.z, t.x, t.y, t.z, k + 1);
    }
    let mut points = String::new();
    let step = (result.mesh.positions.len() / 20_000).max(1);
    for (v, (p, f)) in result.mesh.positions.iter().zip(&result.lit_color).enumerate().step_by(step) {
        let [r, g, b] = [f.x, f.y, f.z].map(|c| Response::Srgb.encode(c));
        let _ = writeln!(points, "{} {} {} {} {r} {g} {b} 0", v + 1, p.x, p.y, p.z);
    }
    std::fs::write(dir.join("cameras.txt"), cameras)?;
    std::fs::write(dir.join("images.txt"), images)?;
    std::fs::write(dir.join("points3D.txt"), points)?;
    write_pictures(result, scan, dir)
}

/// Writes `transforms.json` and `images/` into the folder `dir`.
///
/// # Errors
/// The disk is full or gone, or a picture cannot be decoded.
pub fn write_nerf(result: &Estimate, scan: &Scan, dir: &Path) -> Result<()> {
    let frame = |(k, keyframe): (usize, &ResultKeyframe)| {
        let (i, d) = (&keyframe.camera.intrinsics, &keyframe.camera.distortion);
        // OpenGL's camera looks along −z with y up.
        let rows = keyframe.world_from_camera.to_rows().map(|r| [r[0], -r[1], -r[2], r[3]]);
        json!({
            "file_path": format!("images/{}", picture_name(k)), "transform_matrix": rows,
            "w": i.width, "h": i.height, "fl_x": i.fx, "fl_y": i.fy, "cx": i.cx, "cy": i.cy,
            "k1": d.k1, "k2": d.k2, "k3": d.k3, "p1": d.p1, "p2": d.p2, "gain": keyframe.gain,
        })
    };
    let frames: Vec<_> = result.keyframes.iter().enumerate().map(frame).collect();
    let text = serde_json::to_string_pretty(&json!({ "camera_model": "OPENCV", "frames": frames }))?;
    std::fs::write(dir.join("transforms.json"), text)?;
    write_pictures(result, scan, dir)
}

fn picture_name(k: usize) -> String {
    format!("{k:03}.png")
}

fn write_pictures(result: &Estimate, scan: &Scan, dir: &Path) -> Result<()> {
    let folder = dir.join("images");
    std::fs::create_dir_all(&folder)?;
    for (k, keyframe) in result.keyframes.iter().enumerate() {
        let Some(frame) = scan.keyframes.iter().find(|f| f.name == keyframe.name) else {
            return Err(Error::other(format!("the scan has no keyframe {}: is it this result's scan?", keyframe.name)));
        };
        let path = folder.join(picture_name(k));
        if frame.color.encoding == ColorEncoding::Png {
            std::fs::write(path, &frame.color.bytes)?;
        } else {
            let image = frame.color.decode().map_err(Error::other)?;
            crate::export::picture::write_png(&path, image.width, image.height, &image.data)?;
        }
    }
    Ok(())
}
