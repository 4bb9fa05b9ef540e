//! Plain files that any script can read: `lighting_sh.json`, `vertices.ply`, `exposures.json`, `poses.json`,
//! `materials.json`. Conventions: metres, +Z up, camera-to-world poses with OpenCV axes, linear colour, real orthonormal
//! spherical harmonics without Condon–Shortley phase, index `l*(l+1)+m`.

use crate::export::ply;
use recordings::format_seconds;
use recordings::result::{Estimate, ResultKeyframe};
use serde_json::{Value, json};
use std::io::Result;
use std::path::Path;

/// Gains of the three channels that differ by less (relative) are one gain.
const SAME_GAIN: f64 = 1e-6;

/// Writes all five files into `dir`, which exists. Keyframes keep their names and their order.
///
/// # Errors
/// The disk is full or gone.
pub fn write(result: &Estimate, dir: &Path) -> Result<()> {
    ply::write(result, &dir.join("vertices.ply"))?;
    let documents = [
        ("lighting_sh.json", lighting(result)),
        ("exposures.json", exposures(&result.keyframes)),
        ("poses.json", poses(&result.keyframes)),
        ("materials.json", materials(result)),
    ];
    for (name, document) in documents {
        std::fs::write(dir.join(name), serde_json::to_string_pretty(&document)? + "\n")?;
    }
    Ok(())
}

/// Radiance coefficients of the distant light, `bands²` rows of RGB, and lamps beside the scene as spheres.
fn lighting(result: &Estimate) -> Value {
    json!({
        "light_model": result.local_light.model.name(),
        "spheres": result.local_light.lamps,
        "coefficients": result.light.coefficients,
        "standard_deviation": result.light.standard_deviation,
        "bands": result.light.bands(),
    })
}

/// picture = gain · radiance: one number a keyframe, or three where the channels differ (white balance).
fn exposures(keyframes: &[ResultKeyframe]) -> Value {
    let one = |g: &[f64; 3]| g.iter().all(|c| (c - g[0]).abs() <= SAME_GAIN * g[0].abs());
    let gain: Vec<Value> = if keyframes.iter().all(|k| one(&k.gain)) {
        keyframes.iter().map(|k| json!(k.gain[0])).collect()
    } else {
        keyframes.iter().map(|k| json!(k.gain)).collect()
    };
    json!({
        "gain": gain,
        "timestamp": keyframes.iter().map(seconds).collect::<Vec<_>>(),
        "file": keyframes.iter().map(|k| &k.name).collect::<Vec<_>>(),
    })
}

fn poses(keyframes: &[ResultKeyframe]) -> Value {
    let frames: Vec<Value> = keyframes
        .iter()
        .map(|k| {
            json!({
                "file": k.name,
                "timestamp": seconds(k),
                "camera_to_world": k.world_from_camera.to_rows(),
                "residual_px": k.residual_px,
            })
        })
        .collect();
    let intrinsics = keyframes.first().map(|k| json!(k.camera.intrinsics));
    json!({ "intrinsics": intrinsics, "frames": frames })
}

/// Eq. (13): weights of the diffuse and of the mirrored light, per segment.
fn materials(result: &Estimate) -> Value {
    let segments: Vec<Value> = result
        .segments
        .iter()
        .enumerate()
        .map(|(id, s)| {
            json!({ "id": id, "w_d": s.w_d, "w_s": s.w_s, "w_s_error": s.w_s_error, "albedo": s.albedo, "vertices": s.vertices })
        })
        .collect();
    json!({ "segments": segments })
}

/// The number nearest to the exact decimal: dividing nanoseconds would round twice.
fn seconds(keyframe: &ResultKeyframe) -> Option<f64> {
    format_seconds(keyframe.timestamp_ns).parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::tiny;

    #[test]
    fn all_five_files_hold_the_result() {
        let dir = tempfile::tempdir().unwrap();
        let mut result = tiny();
        write(&result, dir.path()).unwrap();
        let read = |name: &str| -> Value {
            serde_json::from_str(&std::fs::read_to_string(dir.path().join(name)).unwrap()).unwrap()
        };
        assert_eq!(read("lighting_sh.json")["coefficients"], json!([[1.0, 2.0, 3.0]]));
        assert_eq!(read("exposures.json")["gain"], json!([2.0, 0.5]));
        assert_eq!(read("exposures.json")["timestamp"], json!([1305031102.175304, 1305031102.275304]));
        let poses = read("poses.json");
        assert_eq!(poses["frames"][1]["file"], "keyframes/b.png");
        assert_eq!(poses["frames"][1]["camera_to_world"][0], json!([1.0, 0.0, 0.0, 0.25]));
        assert_eq!(read("materials.json")["segments"][1]["w_s"], 0.25);
        assert!(dir.path().join("vertices.ply").exists());

        result.keyframes[1].gain = [0.5, 0.6, 0.4];
        write(&result, dir.path()).unwrap();
        assert_eq!(read("exposures.json")["gain"], json!([[2.0, 2.0, 2.0], [0.5, 0.6, 0.4]]));
    }
}
