//! Lamps and emitting surfaces of a result in glTF's terms (KHR_lights_punctual, KHR_materials_emissive_strength).

use crate::render::bounding_sphere::BoundingSphere;
use glam::{Quat, Vec3};
use recordings::local_light::{Emitter, Lamp};
use serde_json::{Value, json};
use std::f64::consts::PI;

/// A lamp this many radii of the scene away is a direction: readers have near and far planes, and falloff in single precision.
const FAR: f32 = 200.0;

/// A colour whose largest channel is 1, and the factor that was taken out.
fn normalised(rgb: [f64; 3]) -> ([f64; 3], f64) {
    let most = rgb.iter().copied().fold(0.0, f64::max);
    if most > 0.0 { (rgb.map(|c| c / most), most) } else { ([0.0; 3], 0.0) }
}

/// From the middle of the scene to a lamp, if that is so far away that it is a direction.
fn to_sun(lamp: &Lamp, scene: &BoundingSphere) -> Option<Vec3> {
    let toward = Vec3::from_array(lamp.center) - scene.center;
    (toward.length() > FAR * scene.radius).then_some(toward)
}

/// A point light: a sphere of radiance L and radius r has the intensity L π r² per steradian; at the distance d, far
/// from the scene, it is a directional light of irradiance L π r² / d².
pub fn light(lamp: &Lamp, scene: &BoundingSphere) -> Value {
    let (color, most) = normalised(lamp.radiance);
    let intensity = most * PI * f64::from(lamp.radius_m).powi(2);
    let (kind, name, intensity) = match to_sun(lamp, scene) {
        Some(toward) => ("directional", "sun", intensity / f64::from(toward.length_squared())),
        None => ("point", "lamp", intensity),
    };
    json!({
        "type": kind, "name": name, "color": color, "intensity": intensity,
        "extras": { "radius_m": lamp.radius_m, "radiance": lamp.radiance },
    })
}

/// The node of the lamp of this number, `turned` to glTF's axes. A directional light shines along its node's -z axis.
pub fn lamp_node(index: usize, lamp: &Lamp, scene: &BoundingSphere, turned: impl Fn(Vec3) -> [f32; 3]) -> Value {
    let mut node = json!({
        "name": format!("lamp {index}"), "extensions": { "KHR_lights_punctual": { "light": index } },
    });
    match to_sun(lamp, scene) {
        Some(toward) => {
            let from = Vec3::from_array(turned(-toward.normalize()));
            node["rotation"] = json!(Quat::from_rotation_arc(Vec3::NEG_Z, from).normalize().to_array());
        }
        None => node["translation"] = json!(turned(Vec3::from_array(lamp.center))),
    }
    node
}

/// Material of an emitting piece: black but for what it emits.
pub fn material(index: usize, emitter: &Emitter) -> Value {
    let (color, most) = normalised(emitter.radiance);
    json!({
        "name": format!("emitter {index}"), "doubleSided": false,
        "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 1.0 },
        "emissiveFactor": color, "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": most } },
    })
}
