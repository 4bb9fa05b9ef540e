//! What a client wants to see, as arguments of `lumiscan render`. Files are named, never their places.

use crate::serve::render::desk::Desk;
use serde::Deserialize;
use serde_json::json;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Pixels of the largest picture.
const MOST_PIXELS: u32 = 4 << 20;
/// Things that are inserted, removed or changed, each.
const MOST: usize = 16;

/// A picture.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Picture {
    #[serde(default)]
    view: View,
    size: Option<[u32; 2]>,
    /// `photo`.
    over: Option<String>,
    exposure: Option<f32>,
    #[serde(default)]
    insert: Vec<Inserted>,
    material: Option<String>,
    #[serde(default)]
    remove: Vec<String>,
    light: Option<String>,
    light_yaw: Option<f32>,
    #[serde(default)]
    lamp: Vec<String>,
    #[serde(default)]
    emitter: Vec<String>,
}

/// From where.
#[derive(Debug, Clone, Deserialize)]
#[serde(untagged)]
enum View {
    /// `keyframe:N` or `witness:N`.
    Named(String),
    /// A camera in the convention of NeRF: camera to world, right, up and back; focal lengths and middle in pixels.
    Camera { transform_matrix: [[f64; 4]; 4], fl_x: f64, fl_y: f64, cx: f64, cy: f64 },
}

impl Default for View {
    fn default() -> Self {
        Self::Named("keyframe:0".into())
    }
}

/// A thing that is put there.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Inserted {
    /// Name of a file that was sent, or `scan:ID`.
    object: String,
    /// Segments of a scan; empty = all of it.
    #[serde(default)]
    segments: Vec<u32>,
    /// Where, world, metres.
    at: Option<[f32; 3]>,
    /// Turn about +Z, degrees, and size factor.
    #[serde(default)]
    yaw: f32,
    #[serde(default = "one")]
    scale: f32,
}

fn one() -> f32 {
    1.0
}

impl Picture {
    /// The arguments behind `lumiscan render`, without those that limit it. `result_of` finds the result of a published scan by its id.
    ///
    /// # Errors
    /// What cannot be done, and why.
    pub fn arguments(
        &self,
        result: &Path,
        desk: &Desk,
        result_of: impl Fn(&str) -> Option<PathBuf>,
    ) -> Result<Vec<OsString>, String> {
        let mut list: Vec<OsString> = vec![result.into(), "-o".into(), desk.picture().into()];
        let mut add = |option: &str, value: &str| list.push(format!("{option}={value}").into());
        if [self.insert.len(), self.remove.len(), self.lamp.len(), self.emitter.len()].iter().any(|n| *n > MOST) {
            return Err(format!("at most {MOST} things are inserted, removed or changed at a time"));
        }
        let text = |path: PathBuf| path.into_os_string().into_string().map_err(|_| "a path is no UTF-8".to_owned());
        let found = |name: &str| match name.strip_prefix("scan:") {
            Some(id) => result_of(id).ok_or_else(|| format!("{id}: there is no such scan, or it has no result")),
            None => desk.file(name).ok_or_else(|| format!("{name}: send the file first")),
        };
        match &self.view {
            View::Named(name) if name.starts_with("keyframe:") || name.starts_with("witness:") => add("--view", name),
            View::Named(name) => return Err(format!("view `{name}` must be keyframe:N, witness:N or a camera")),
            View::Camera { transform_matrix, fl_x, fl_y, cx, cy } => {
                let Some([w, h]) = self.size else { return Err("a camera needs a size".into()) };
                let camera = json!({ "w": w, "h": h, "fl_x": fl_x, "fl_y": fl_y, "cx": cx, "cy": cy,
                    "frames": [{ "transform_matrix": transform_matrix }] });
                std::fs::write(desk.camera(), camera.to_string()).map_err(|e| e.to_string())?;
                add("--view", &text(desk.camera())?);
            }
        }
        if let Some([w, h]) = self.size {
            if w.checked_mul(h).is_none_or(|n| n > MOST_PIXELS) {
                return Err(format!("{w}x{h} is too large: at most {MOST_PIXELS} pixels"));
            }
            add("--size", &format!("{w}x{h}"));
        }
        for (option, value) in [("--over", &self.over), ("--material", &self.material)] {
            value.iter().for_each(|v| add(option, v));
        }
        for (option, value) in [("--exposure", self.exposure), ("--light-yaw", self.light_yaw)] {
            value.iter().for_each(|v| add(option, &v.to_string()));
        }
        for thing in &self.insert {
            let mut object = text(found(&thing.object)?)?;
            if !thing.segments.is_empty() {
                let list: Vec<String> = thing.segments.iter().map(ToString::to_string).collect();
                object += &format!("#segment={}", list.join(","));
            }
            if let Some([x, y, z]) = thing.at {
                object += &format!("@{x},{y},{z},{},{}", thing.yaw, thing.scale);
            }
            add("--insert", &object);
        }
        if let Some(light) = &self.light {
            let path = text(found(light)?)?;
            add("--light", &if light.starts_with("scan:") { format!("result:{path}") } else { path });
        }
        for (option, values) in [("--remove", &self.remove), ("--lamp", &self.lamp), ("--emitter", &self.emitter)] {
            values.iter().for_each(|v| add(option, v));
        }
        Ok(list)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arguments(body: &serde_json::Value) -> Result<Vec<String>, String> {
        let desk = Desk::default();
        desk.folder().unwrap();
        desk.take("ball.glb", 0, b"x").unwrap();
        let picture: Picture = serde_json::from_value(body.clone()).map_err(|e| e.to_string())?;
        let list = picture.arguments(Path::new("/d/result.lres"), &desk, |id| {
            (id == "other").then(|| PathBuf::from("/d/other/result.lres"))
        })?;
        let folder = format!("{}/", desk.folder().unwrap().display());
        Ok(list.into_iter().map(|a| a.into_string().unwrap().replace(&folder, "")).collect())
    }

    #[test]
    fn a_picture_becomes_arguments() {
        assert_eq!(arguments(&json!({})).unwrap(), ["/d/result.lres", "-o", "picture.png", "--view=keyframe:0"]);
        let all = arguments(&json!({
            "view": "keyframe:2", "over": "photo", "remove": ["point:3,4"], "lamp": ["0=off"], "light": "scan:other", "light_yaw": -30,
            "insert": [{ "object": "ball.glb", "at": [1, 2, 3], "scale": 0.5 }, { "object": "scan:other", "segments": [4, 7] }],
        }));
        assert_eq!(
            all.unwrap()[3..],
            [
                "--view=keyframe:2",
                "--over=photo",
                "--light-yaw=-30",
                "--insert=files/ball.glb@1,2,3,0,0.5",
                "--insert=/d/other/result.lres#segment=4,7",
                "--light=result:/d/other/result.lres",
                "--remove=point:3,4",
                "--lamp=0=off",
            ]
        );
        let matrix = [[1.0, 0.0, 0.0, 0.0]; 4];
        let camera = json!({ "transform_matrix": matrix, "fl_x": 9, "fl_y": 9, "cx": 4, "cy": 3 });
        assert_eq!(
            arguments(&json!({ "view": camera, "size": [8, 6] })).unwrap()[3..],
            ["--view=camera.json", "--size=8x6"]
        );
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        for body in [
            json!({ "view": "/etc/passwd.json" }),
            json!({ "view": "orbit:9999" }),
            json!({ "insert": [{ "object": "/etc/passwd.glb" }] }),
            json!({ "insert": [{ "object": "scan:../x" }] }),
            json!({ "light": "../../x.hdr" }),
            json!({ "size": [100_000, 100_000] }),
            json!({ "remove": vec!["segment:1"; 99] }),
            json!({ "output": "/etc/x" }),
        ] {
            assert!(arguments(&body).is_err(), "{body}");
        }
    }
}
