//! The scene of a result: mesh, materials and cameras, with the light of `light.rs`.

use crate::export::file::write_whole;
use crate::export::glb::buffer::{Buffer, pack};
use crate::export::glb::light::light;
use crate::export::glb::local_light;
use crate::render::bounding_sphere::BoundingSphere;
use crate::render::lighting::environment::Environment;
use crate::texture::seams::{Unwrapped, jpeg_up_to_one};
use glam::{DMat3, DQuat, DVec3, Vec3};
use recordings::result::{Estimate, ResultKeyframe, Segment};
use serde_json::{Value, json};
use std::io::{Result, Write};
use std::path::Path;

/// Roughness of a glossy segment: Eq. (13) recovers how much it mirrors, not how sharply.
const GLOSSY_ROUGHNESS: f64 = 0.4;
/// Roughness of a matte segment.
const MATTE_ROUGHNESS: f64 = 1.0;
/// Reflectance of a dielectric at normal incidence that `specularFactor` scales.
const DIELECTRIC_REFLECTANCE: f64 = 0.04;

/// glTF's numbers of filters and of the wrapping mode.
const LINEAR: u32 = 9729;
const LINEAR_MIPMAP_LINEAR: u32 = 9987;
const CLAMP: u32 = 33071;

/// Writes the scene, its surroundings lit by `completed`. Nothing appears under `path` before it is complete.
///
/// # Errors
/// The disk is full or gone.
pub fn write(result: &Estimate, completed: &Environment, path: &Path) -> Result<()> {
    let bytes = scene(result, completed)?;
    write_whole(path, |mut file| file.write_all(&bytes))
}

/// The bytes of the `.glb` file.
///
/// # Errors
/// A picture of the light cannot be encoded.
pub fn scene(result: &Estimate, completed: &Environment) -> Result<Vec<u8>> {
    let mut buffer = Buffer::default();
    let primitives = primitives(result, &mut buffer);
    let mut nodes = vec![json!({ "name": result.name, "mesh": 0 })];
    nodes.extend(result.keyframes.iter().enumerate().map(|(index, keyframe)| camera_node(index, keyframe)));
    let (lamps, emitters) = (&result.local_light.lamps, &result.local_light.emitters);
    let around = BoundingSphere::around(result.mesh.positions.iter().copied());
    let around = around.unwrap_or(BoundingSphere { center: Vec3::ZERO, radius: 0.0 });
    nodes.extend(lamps.iter().enumerate().map(|(index, lamp)| local_light::lamp_node(index, lamp, &around, turned)));
    let (mut images, light) = light(result, completed, &mut buffer)?;
    let mut extensions = vec!["KHR_materials_specular", "EXT_lights_image_based"];
    extensions.extend((!lamps.is_empty()).then_some("KHR_lights_punctual"));
    extensions.extend((!emitters.is_empty()).then_some("KHR_materials_emissive_strength"));
    let segments = result.segments.iter().enumerate().map(|(i, s)| material(i, s, result.texture.is_some()));
    let materials = segments.chain(emitters.iter().enumerate().map(|(i, e)| local_light::material(i, e)));
    let albedo = result.texture.as_ref().map(jpeg_up_to_one).transpose()?;
    if let Some(jpeg) = &albedo {
        images.push(json!({ "bufferView": buffer.add(jpeg, None), "mimeType": "image/jpeg" }));
    }
    let last_image = images.len().saturating_sub(1);
    let mut root = json!({
        "asset": { "version": "2.0", "generator": "lumiscan" },
        "extensionsUsed": extensions,
        "scene": 0,
        "scenes": [{
            "nodes": (0..nodes.len()).collect::<Vec<_>>(), "extensions": { "EXT_lights_image_based": { "light": 0 } },
        }],
        "nodes": nodes,
        "meshes": [{ "name": result.name, "primitives": primitives }],
        "materials": materials.collect::<Vec<_>>(),
        "accessors": buffer.accessors,
        "images": images,
        "extensions": { "EXT_lights_image_based": { "lights": [light] } },
        "buffers": [{ "byteLength": buffer.bytes.len() }],
        "bufferViews": buffer.views,
    });
    if albedo.is_some() {
        root["textures"] = json!([{ "name": "albedo", "sampler": 0, "source": last_image }]);
        root["samplers"] =
            json!([{ "magFilter": LINEAR, "minFilter": LINEAR_MIPMAP_LINEAR, "wrapS": CLAMP, "wrapT": CLAMP }]);
    }
    if !result.keyframes.is_empty() {
        root["cameras"] = result.keyframes.iter().map(camera).collect();
    }
    if !lamps.is_empty() {
        root["extensions"]["KHR_lights_punctual"] =
            json!({ "lights": lamps.iter().map(|lamp| local_light::light(lamp, &around)).collect::<Vec<_>>() });
    }
    Ok(pack(&root, &buffer.bytes))
}

/// Our axes to glTF's.
fn turned(p: Vec3) -> [f32; 3] {
    [p.x, p.z, -p.y]
}

/// A primitive per segment, and one per emitting piece, over shared vertices.
fn primitives(result: &Estimate, buffer: &mut Buffer) -> Vec<Value> {
    let mesh = &result.mesh;
    let unwrapped = result.texture.as_ref().map(|t| Unwrapped::new(mesh, t));
    let vertices: Vec<u32> = match &unwrapped {
        Some(unwrapped) => unwrapped.vertex.clone(),
        None => (0..mesh.positions.len() as u32).collect(),
    };
    let positions: Vec<[f32; 3]> = vertices.iter().map(|&i| turned(mesh.positions[i as usize])).collect();
    let normal = |&i: &u32| turned(mesh.normals[i as usize].try_normalize().unwrap_or(Vec3::Z));
    let normals: Vec<[f32; 3]> = vertices.iter().map(normal).collect();
    // Normalised shorts keep an albedo's dark end, which bytes of linear light would not.
    let color = |a: &Vec3| {
        let c = a.clamp(Vec3::ZERO, Vec3::ONE) * 65_535.0;
        [c.x.round() as u16, c.y.round() as u16, c.z.round() as u16, u16::MAX]
    };
    let mut attributes =
        json!({ "POSITION": buffer.add_positions(&positions), "NORMAL": buffer.add_vectors(&normals) });
    // Colours would be multiplied with the texture.
    match &unwrapped {
        Some(unwrapped) => attributes["TEXCOORD_0"] = json!(buffer.add_coordinates(&unwrapped.coordinates)),
        None => {
            let colors: Vec<[u16; 4]> = result.albedo.iter().map(color).collect();
            attributes["COLOR_0"] = json!(buffer.add_colors(&colors));
        }
    }
    let triangles = unwrapped.as_ref().map_or(&mesh.triangles, |u| &u.triangles);
    let mut primitives = Vec::new();
    let segments = result.segments.len() as u32;
    let mut piece: Vec<Option<u32>> = vec![None; mesh.positions.len()];
    for (number, emitter) in (segments..).zip(&result.local_light.emitters) {
        emitter.vertices.iter().for_each(|&i| piece[i as usize] = Some(number));
    }
    // With a texture all matte segments look alike, and readers treat the texture once a material.
    let is_matte = |s: u32| result.segments[s as usize].w_s <= 0.0;
    let first_matte = (0..segments).find(|&s| result.texture.is_some() && is_matte(s));
    let looks_like = |s: u32| first_matte.filter(|_| is_matte(s)).unwrap_or(s);
    let material = |t: &[u32; 3]| {
        let of = piece[t[0] as usize].filter(|of| t.iter().all(|&i| piece[i as usize] == Some(*of)));
        of.unwrap_or_else(|| looks_like(result.segment[t[0] as usize]))
    };
    for segment in 0..segments + result.local_light.emitters.len() as u32 {
        let own = mesh.triangles.iter().zip(triangles).filter(|(t, _)| material(t) == segment);
        let indices: Vec<u32> = own.flat_map(|(_, corners)| *corners).collect();
        if !indices.is_empty() {
            let indices = buffer.add_indices(&indices);
            primitives.push(json!({ "attributes": attributes, "indices": indices, "material": segment, "mode": 4 }));
        }
    }
    primitives
}

fn material(index: usize, segment: &Segment, textured: bool) -> Value {
    // w_s is a reflectance; the extension's factor scales the dielectric's, its colour goes beyond 1.
    let strength = segment.w_s.clamp(0.0, 1.0) / DIELECTRIC_REFLECTANCE;
    let mut material = json!({
        "name": format!("segment {index}"),
        "doubleSided": true,
        "pbrMetallicRoughness": {
            "metallicFactor": 0.0,
            "roughnessFactor": if segment.w_s > 0.0 { GLOSSY_ROUGHNESS } else { MATTE_ROUGHNESS },
        },
        "extensions": { "KHR_materials_specular": {
            "specularFactor": strength.min(1.0),
            "specularColorFactor": vec![strength.max(1.0); 3],
        } },
        "extras": { "w_d": segment.w_d, "w_s": segment.w_s, "vertices": segment.vertices },
    });
    if textured {
        material["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": 0 });
    }
    material
}

fn camera(keyframe: &ResultKeyframe) -> Value {
    let i = &keyframe.camera.intrinsics;
    json!({
        "name": keyframe.name, "type": "perspective",
        "perspective": {
            "aspectRatio": f64::from(i.width) / i.fx * i.fy / f64::from(i.height),
            "yfov": 2.0 * libm::atan(f64::from(i.height) / 2.0 / i.fy),
            "znear": 0.001,
        },
    })
}

/// The node of a keyframe's camera. glTF's camera looks along −z with y up.
fn camera_node(index: usize, keyframe: &ResultKeyframe) -> Value {
    let axes = DMat3::from_quat(keyframe.world_from_camera.rotation);
    let turn = |v: DVec3| DVec3::new(v.x, v.z, -v.y);
    let q = DQuat::from_mat3(&DMat3::from_cols(turn(axes.x_axis), turn(-axes.y_axis), turn(-axes.z_axis))).normalize();
    let t = turn(keyframe.world_from_camera.translation);
    json!({
        "name": keyframe.name, "camera": index,
        "rotation": [q.x, q.y, q.z, q.w], "translation": [t.x, t.y, t.z],
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::{textured, tiny};
    use crate::render::objects::gltf::document;
    use recordings::local_light::{Emitter, Lamp};

    fn written(result: &Estimate) -> Vec<u8> {
        scene(result, &Environment::from_light(&result.light)).unwrap()
    }

    #[test]
    fn our_own_reader_gets_the_mesh_back() {
        let result = tiny();
        let object = document::read(&written(&result), Path::new(".")).unwrap();
        assert_eq!(object.mesh.triangles.len(), result.mesh.triangles.len());
        for t in &object.mesh.triangles {
            for &i in t {
                let p = object.mesh.positions[i as usize];
                let j = result.mesh.positions.iter().position(|q| q.distance(p) < 1e-6).expect("same vertices");
                assert!((object.color[i as usize] - result.albedo[j]).length() < 1e-4);
            }
        }
    }

    #[test]
    fn a_texture_takes_the_place_of_the_colours() {
        let object = document::read(&written(&textured()), Path::new(".")).unwrap();
        for (p, brdf) in object.mesh.positions.iter().zip(object.vertex_brdfs()).filter(|(p, _)| p.x != 0.0) {
            let (own, other) =
                if p.x < 0.0 { (brdf.diffuse.x, brdf.diffuse.y) } else { (brdf.diffuse.y, brdf.diffuse.x) };
            assert!(own > 0.5 && other < 0.02, "red on the left, green on the right: {:?} at {p}", brdf.diffuse);
        }
    }

    #[test]
    fn lamps_and_emitters_are_lights_and_materials() {
        let mut result = tiny();
        result.local_light.lamps = vec![Lamp { center: [1.0, 2.0, 3.0], radius_m: 0.1, radiance: [8.0, 4.0, 2.0] }];
        let vertices = result.mesh.triangles[0].to_vec();
        result.local_light.emitters = vec![Emitter { vertices, radiance: [2.0, 4.0, 1.0] }];
        let bytes = written(&result);
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let root: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
        let light = &root["extensions"]["KHR_lights_punctual"]["lights"][0];
        assert!((light["intensity"].as_f64().unwrap() - 8.0 * std::f64::consts::PI * 0.01).abs() < 1e-6);
        let lamp = root["nodes"].as_array().unwrap().last().unwrap();
        assert_eq!(lamp["translation"], json!([1.0, 3.0, -2.0]));
        let emitter = root["materials"].as_array().unwrap().last().unwrap();
        assert_eq!(emitter["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"], 4.0);
        let primitives = root["meshes"][0]["primitives"].as_array().unwrap();
        assert!(primitives.iter().any(|p| p["material"] == result.segments.len()));
    }

    #[test]
    fn the_sun_is_a_direction() {
        let mut result = tiny();
        let center = [0.0, 6e5, 8e5];
        result.local_light.lamps = vec![Lamp { center, radius_m: 1e4, radiance: [50.0, 40.0, 30.0] }];
        let bytes = written(&result);
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let root: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
        let light = &root["extensions"]["KHR_lights_punctual"]["lights"][0];
        assert_eq!(light["type"], "directional");
        assert!((light["intensity"].as_f64().unwrap() - 50.0 * std::f64::consts::PI * 1e-4).abs() < 1e-5, "{light}");
        let node = root["nodes"].as_array().unwrap().last().unwrap();
        let turn: Vec<f32> = node["rotation"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap() as f32).collect();
        let along = glam::Quat::from_slice(&turn) * Vec3::NEG_Z;
        assert!(along.distance(Vec3::new(0.0, -0.8, 0.6)) < 1e-3, "from the sun, in glTF's axes: {along}");
        assert!(node.get("translation").is_none());
    }

    /// The Khronos validator, where it is installed (npm i -g gltf-validator; NODE_PATH names its folder).
    #[test]
    fn the_khronos_validator_accepts_it() {
        let folder = tempfile::tempdir().unwrap();
        let files = [tiny(), textured()].map(|result| {
            let file = folder.path().join(if result.texture.is_some() { "textured.glb" } else { "tiny.glb" });
            write(&result, &Environment::from_light(&result.light), &file).unwrap();
            file
        });
        let script = "const v=require('gltf-validator'),fs=require('fs');\
            v.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1]))).then(r=>{console.log(JSON.stringify(r.issues));\
            process.exit(r.issues.numErrors?1:0)})";
        let has = std::process::Command::new("node").args(["-e", "require('gltf-validator')"]).output();
        if !has.is_ok_and(|o| o.status.success()) {
            eprintln!("skipped: node with the npm package gltf-validator is not installed");
            return;
        }
        for file in files {
            let out = std::process::Command::new("node").args(["-e", script]).arg(&file).output().unwrap();
            assert!(
                out.status.success(),
                "{}{}",
                String::from_utf8_lossy(&out.stdout),
                String::from_utf8_lossy(&out.stderr)
            );
        }
    }
}
