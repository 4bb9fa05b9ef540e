//! Lamps and emitting surfaces of a result in glTF's terms (KHR_lights_punctual, KHR_materials_emissive_strength).

use glam::Vec3;
use recordings::local_light::{Emitter, Lamp};
use serde_json::{Value, json};
use std::f64::consts::PI;

/// A colour whose largest channel is 1, and the factor that was taken out.
fn normalised(rgb: [f64; 3]) -> ([f64; 3], f64) {
    let most = rgb.iter().copied().fold(0.0, f64::max);
    if most > 0.0 { (rgb.map(|c| c / most), most) } else { ([0.0; 3], 0.0) }
}

/// A point light: a sphere of radiance L and radius r has the intensity L π r² per steradian.
pub fn point_light(lamp: &Lamp) -> Value {
    let (color, most) = normalised(lamp.radiance);
    json!({
        "type": "point", "name": "lamp", "color": color, "intensity": most * PI * f64::from(lamp.radius_m).powi(2),
        "extras": { "radius_m": lamp.radius_m, "radiance": lamp.radiance },
    })
}

/// The node of the lamp of this number.
pub fn lamp_node(index: usize, lamp: &Lamp, turned: impl Fn(Vec3) -> [f32; 3]) -> Value {
    json!({
        "name": format!("lamp {index}"), "translation": turned(Vec3::from_array(lamp.center)),
        "extensions": { "KHR_lights_punctual": { "light": index } },
    })
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
