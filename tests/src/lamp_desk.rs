//! The shared scene `truth_near/lamp`, a desk under a lamp that is not in the mesh, as the path tracer needs it.

use crate::synth::emitters::Sphere;
use crate::synth::environment::Environment;
use crate::synth::material::Material;
use crate::synth::scene::{Part, Scene};
use crate::truth::json;
use glam::Vec3;
use recordings::import::npy::Array;
use recordings::ply::read::read_ply;
use recordings::types::{Intrinsics, Mesh, Pose, RgbImage};
use std::path::{Path, PathBuf};

/// An object that stands on the desk.
#[derive(Debug, Clone)]
pub struct Inserted {
    /// Its surface, world frame.
    pub mesh: Mesh,
    /// Diffuse albedo.
    pub albedo: Vec3,
}

/// A keyframe of the scene with what is true about it.
#[derive(Debug, Clone)]
pub struct TrueView {
    /// True pose.
    pub world_from_camera: Pose,
    /// 8-bit picture = encode(gain · radiance), per channel.
    pub gain: Vec3,
    /// The picture as taken, noise and all.
    pub photo: RgbImage,
}

/// The scene's folder.
#[derive(Debug, Clone)]
pub struct LampDesk {
    folder: PathBuf,
}

fn vector(value: &serde_json::Value) -> Vec3 {
    let numbers: [f32; 3] = serde_json::from_value(value.clone()).expect("three numbers");
    Vec3::from(numbers)
}

impl LampDesk {
    /// In the shared folder.
    #[must_use]
    pub fn new(shared: &Path) -> Self {
        Self { folder: shared.join("truth_near/lamp") }
    }

    /// The lamp.
    ///
    /// # Panics
    /// A file is missing or damaged. So do the other methods.
    #[must_use]
    pub fn lamp(&self) -> Sphere {
        let file = json(&self.folder.join("truth/emitters.json"));
        let lamp = &file["spheres"][0];
        let radius = lamp["radius_m"].as_f64().expect("a radius") as f32;
        Sphere { center: vector(&lamp["center"]), radius_m: radius, radiance: vector(&lamp["radiance"]) }
    }

    /// The desk, with something on it, in its distant light and that of these lamps.
    #[must_use]
    pub fn scene(&self, inserted: Option<&Inserted>, lamps: Vec<Sphere>) -> Scene {
        let read = |file: &str| Array::read(&self.folder.join("truth").join(file)).expect("an array").rgb();
        let colors = |rows: Vec<[f64; 3]>| rows.into_iter().map(|r| Vec3::from(r.map(|x| x as f32)));
        let part = |name, mesh| Part { name, material: Material::MATTE, texture: Box::new(|_| Vec3::ONE), mesh };
        let mut parts = vec![part("desk", read_ply(&self.folder.join("mesh.ply")).expect("a mesh"))];
        let mut color: Vec<Vec3> = colors(read("albedo.npy")).collect();
        if let Some(Inserted { mesh, albedo }) = inserted {
            color.resize(color.len() + mesh.positions.len(), *albedo);
            parts.push(part("inserted", mesh.clone()));
        }
        let light = Environment::from_map(colors(read("env.npy")).collect());
        let mut scene = Scene::new(parts, light).with_emitters(lamps, &[]);
        scene.vertex_color = Some(color);
        scene
    }

    /// The camera of all keyframes.
    #[must_use]
    pub fn camera(&self) -> Intrinsics {
        let file = json(&self.folder.join("keyframes.json"));
        let number = |key: &str| file["intrinsics"][key].as_f64().expect("a number");
        let [fx, fy, cx, cy] = ["fx", "fy", "cx", "cy"].map(number);
        let [width, height] = ["width", "height"].map(|k| number(k) as u32);
        Intrinsics { width, height, fx, fy, cx, cy }
    }

    /// A keyframe.
    #[must_use]
    pub fn view(&self, number: usize) -> TrueView {
        let poses = json(&self.folder.join("truth/poses.json"));
        let exposures = json(&self.folder.join("truth/exposures.json"));
        let frame = &poses["frames"][number];
        let rows: [[f64; 4]; 4] = serde_json::from_value(frame["camera_to_world"].clone()).expect("a pose");
        let picture = std::fs::read(self.folder.join(format!("keyframes/{number:03}.png"))).expect("a picture");
        let gain = exposures["gain"][number].as_f64().expect("a gain") as f32;
        TrueView {
            world_from_camera: Pose::from_rows(&rows).expect("a pose"),
            gain: vector(&exposures["white_balance"][number]) * gain,
            photo: RgbImage::decode(&picture).expect("a picture"),
        }
    }
}
