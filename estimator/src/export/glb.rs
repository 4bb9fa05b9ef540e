//! A result as a binary glTF 2.0 scene: mesh with albedo as vertex colours, a material per segment
//! (KHR_materials_specular), the light (EXT_lights_image_based), the keyframes' cameras. +Y up: (x, y, z) = (X, Z, −Y).

use crate::numerics::sh;
use glam::{DMat3, DQuat, DVec3, Vec3};
use recordings::result::Estimate;
use serde_json::{Value, json};
use std::f64::consts::PI;
use std::io::{Result, Write};
use std::path::Path;

/// Roughness of a segment that mirrors: Eq. (13) tells how much, not how sharply.
const GLOSSY_ROUGHNESS: f64 = 0.4;
/// Roughness of one that does not.
const MATT_ROUGHNESS: f64 = 1.0;
/// Side of the first mip level of the light's cube map.
const CUBE_SIDE: u32 = 64;

/// Ours to glTF's axes.
fn turned(p: Vec3) -> [f32; 3] {
    [p.x, p.z, -p.y]
}

/// Binary data with views on it.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
}

impl Buffer {
    fn add(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        let mut view = json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.bytes.extend(bytes);
        while !self.bytes.len().is_multiple_of(4) {
            self.bytes.push(0);
        }
        self.views.push(view);
        self.views.len() - 1
    }
}

const ARRAY: u32 = 34962;
const ELEMENTS: u32 = 34963;
const FLOAT: u32 = 5126;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;

/// Writes the scene. Nothing appears under `path` before it is complete.
///
/// # Errors
/// The disk is full or gone.
pub fn write(result: &Estimate, path: &Path) -> Result<()> {
    let bytes = scene(result)?;
    super::write_whole(path, |mut file| file.write_all(&bytes))
}

/// The whole file.
///
/// # Errors
/// A picture of the light cannot be encoded.
pub fn scene(result: &Estimate) -> Result<Vec<u8>> {
    let mut buffer = Buffer::default();
    let mut accessors = Vec::new();
    let n = result.mesh.positions.len();
    let positions: Vec<[f32; 3]> = result.mesh.positions.iter().map(|p| turned(*p)).collect();
    let normals: Vec<[f32; 3]> =
        result.mesh.normals.iter().map(|n| turned(n.try_normalize().unwrap_or(Vec3::Z))).collect();
    // Normalised shorts keep an albedo's dark end, which bytes of linear light would not.
    let color: Vec<[u16; 4]> = result
        .albedo
        .iter()
        .map(|a| {
            let c = a.clamp(Vec3::ZERO, Vec3::ONE) * 65_535.0;
            [c.x.round() as u16, c.y.round() as u16, c.z.round() as u16, u16::MAX]
        })
        .collect();
    let (low, high) = positions.iter().fold(([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]), |(l, h), p| {
        (std::array::from_fn(|k| l[k].min(p[k])), std::array::from_fn(|k| h[k].max(p[k])))
    });
    let view = buffer.add(bytemuck::cast_slice(&positions), Some(ARRAY));
    accessors.push(
        json!({ "bufferView": view, "componentType": FLOAT, "count": n, "type": "VEC3", "min": low, "max": high }),
    );
    let view = buffer.add(bytemuck::cast_slice(&normals), Some(ARRAY));
    accessors.push(json!({ "bufferView": view, "componentType": FLOAT, "count": n, "type": "VEC3" }));
    let view = buffer.add(bytemuck::cast_slice(&color), Some(ARRAY));
    accessors.push(
        json!({ "bufferView": view, "componentType": UNSIGNED_SHORT, "normalized": true, "count": n, "type": "VEC4" }),
    );

    let mut primitives = Vec::new();
    for segment in 0..result.segments.len() as u32 {
        let indices: Vec<u32> = result
            .mesh
            .triangles
            .iter()
            .filter(|t| result.segment[t[0] as usize] == segment)
            .flatten()
            .copied()
            .collect();
        if indices.is_empty() {
            continue;
        }
        let view = buffer.add(bytemuck::cast_slice(&indices), Some(ELEMENTS));
        accessors.push(json!({
            "bufferView": view, "componentType": UNSIGNED_INT, "count": indices.len(), "type": "SCALAR",
        }));
        primitives.push(json!({
            "attributes": { "POSITION": 0, "NORMAL": 1, "COLOR_0": 2 },
            "indices": accessors.len() - 1, "material": segment, "mode": 4,
        }));
    }
    let materials: Vec<Value> = result
        .segments
        .iter()
        .enumerate()
        .map(|(i, s)| {
            let glossy = s.w_s > 0.0;
            // w_s is a reflectance; the extension's factor scales the dielectric's 4 %, its colour goes beyond 1.
            let strength = s.w_s.clamp(0.0, 1.0) / 0.04;
            json!({
                "name": format!("segment {i}"),
                "doubleSided": true,
                "pbrMetallicRoughness": {
                    "metallicFactor": 0.0,
                    "roughnessFactor": if glossy { GLOSSY_ROUGHNESS } else { MATT_ROUGHNESS },
                },
                "extensions": { "KHR_materials_specular": {
                    "specularFactor": strength.min(1.0),
                    "specularColorFactor": [strength.max(1.0), strength.max(1.0), strength.max(1.0)],
                } },
                "extras": { "w_d": s.w_d, "w_s": s.w_s, "vertices": s.vertices },
            })
        })
        .collect();

    let mut nodes = vec![json!({ "name": result.name, "mesh": 0 })];
    let mut cameras = Vec::new();
    for keyframe in &result.keyframes {
        let i = &keyframe.camera.intrinsics;
        cameras.push(json!({
            "name": keyframe.name, "type": "perspective",
            "perspective": {
                "aspectRatio": f64::from(i.width) / i.fx * i.fy / f64::from(i.height),
                "yfov": 2.0 * libm::atan(f64::from(i.height) / 2.0 / i.fy),
                "znear": 0.001,
            },
        }));
        // glTF's camera looks along −z with y up.
        let axes = DMat3::from_quat(keyframe.world_from_camera.rotation);
        let turn = |v: DVec3| DVec3::new(v.x, v.z, -v.y);
        let q = DQuat::from_mat3(&DMat3::from_cols(turn(axes.x_axis), turn(-axes.y_axis), turn(-axes.z_axis)));
        let q = q.normalize();
        let t = turn(keyframe.world_from_camera.translation);
        nodes.push(json!({
            "name": keyframe.name, "camera": cameras.len() - 1,
            "rotation": [q.x, q.y, q.z, q.w], "translation": [t.x, t.y, t.z],
        }));
    }

    let (images, light) = light(result, &mut buffer)?;
    let all: Vec<usize> = (0..nodes.len()).collect();
    let mut root = json!({
        "asset": { "version": "2.0", "generator": "lumiscan" },
        "extensionsUsed": ["KHR_materials_specular", "EXT_lights_image_based"],
        "scene": 0,
        "scenes": [{ "nodes": all, "extensions": { "EXT_lights_image_based": { "light": 0 } } }],
        "nodes": nodes,
        "meshes": [{ "name": result.name, "primitives": primitives }],
        "materials": materials,
        "accessors": accessors,
        "images": images,
        "extensions": { "EXT_lights_image_based": { "lights": [light] } },
        "buffers": [{ "byteLength": buffer.bytes.len() }],
        "bufferViews": buffer.views,
    });
    if !cameras.is_empty() {
        root["cameras"] = json!(cameras);
    }
    Ok(pack(&root, &buffer.bytes))
}

/// The light: irradiance coefficients (bands 0..2 of what a diffuse surface gets) and a cube map of its radiance, RGBD
/// coded as the extension asks (alpha divides).
fn light(result: &Estimate, buffer: &mut Buffer) -> Result<(Vec<Value>, Value)> {
    let coefficient = |k: usize| result.light.coefficients.get(k).copied().unwrap_or([0.0; 3]);
    // Coefficients of a function of the direction in the turned frame: project the light looked at from there.
    let mut irradiance = vec![[0.0f64; 3]; 9];
    let directions = sh::even_directions(4096);
    let rows: Vec<[f64; 3]> = (0..9)
        .map(|k| {
            let factor = sh::cosine_factor(sh::band(k)) * PI;
            coefficient(k).map(|c| c * factor)
        })
        .collect();
    for d in &directions {
        let ours = DVec3::new(d.x, -d.z, d.y);
        let value = sh::radiance(&rows, ours);
        let mut y = [0.0; 9];
        sh::eval(*d, &mut y);
        for (sum, y) in irradiance.iter_mut().zip(y) {
            *sum = std::array::from_fn(|c| sum[c] + value[c] * y * 4.0 * PI / directions.len() as f64);
        }
    }
    let radiance = |d: DVec3| {
        let r = sh::radiance(&result.light.coefficients, DVec3::new(d.x, -d.z, d.y));
        r.map(|x| x.max(0.0))
    };
    let levels = CUBE_SIDE.ilog2() + 1;
    let (mut images, mut mips) = (Vec::new(), Vec::new());
    for level in 0..levels {
        let side = CUBE_SIDE >> level;
        let mut faces = Vec::new();
        for face in 0..6 {
            let pixels: Vec<u8> =
                (0..side * side).flat_map(|i| rgbd(radiance(cube_direction(face, i % side, i / side, side)))).collect();
            let bytes = crate::export::picture::encode_rgba(side, side, &pixels)?;
            let view = buffer.add(&bytes, None);
            images.push(json!({ "bufferView": view, "mimeType": "image/png" }));
            faces.push(images.len() - 1);
        }
        mips.push(json!(faces));
    }
    let light = json!({
        "name": "recovered", "rotation": [0.0, 0.0, 0.0, 1.0], "intensity": 1.0,
        "irradianceCoefficients": irradiance, "specularImageSize": CUBE_SIDE, "specularImages": mips,
    });
    Ok((images, light))
}

/// Direction of a cube map's texel in OpenGL's order: +X −X +Y −Y +Z −Z.
fn cube_direction(face: usize, x: u32, y: u32, side: u32) -> DVec3 {
    let (s, t) =
        ((2.0 * f64::from(x) + 1.0) / f64::from(side) - 1.0, (2.0 * f64::from(y) + 1.0) / f64::from(side) - 1.0);
    match face {
        0 => DVec3::new(1.0, -t, -s),
        1 => DVec3::new(-1.0, -t, s),
        2 => DVec3::new(s, 1.0, t),
        3 => DVec3::new(s, -1.0, -t),
        4 => DVec3::new(s, -t, 1.0),
        _ => DVec3::new(-s, -t, -1.0),
    }
    .normalize()
}

/// Colour times alpha⁻¹: bright light is kept in 8 bits.
fn rgbd(color: [f64; 3]) -> [u8; 4] {
    let most = color.iter().fold(1.0f64, |m, c| m.max(*c)).min(255.0);
    let d = (255.0 / most).floor().clamp(1.0, 255.0);
    let byte = |c: f64| (c * d).round().clamp(0.0, 255.0) as u8;
    [byte(color[0]), byte(color[1]), byte(color[2]), d as u8]
}

/// Header, JSON chunk, binary chunk.
fn pack(root: &Value, binary: &[u8]) -> Vec<u8> {
    let mut text = root.to_string().into_bytes();
    while !text.len().is_multiple_of(4) {
        text.push(b' ');
    }
    let total = 12 + 8 + text.len() + 8 + binary.len();
    let mut out = Vec::with_capacity(total);
    out.extend(b"glTF");
    out.extend(2u32.to_le_bytes());
    out.extend((total as u32).to_le_bytes());
    for (kind, data) in [(b"JSON", text.as_slice()), (b"BIN\0", binary)] {
        out.extend((data.len() as u32).to_le_bytes());
        out.extend(kind);
        out.extend(data);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::tiny;
    use crate::render::objects::gltf::document;

    #[test]
    fn our_own_reader_gets_the_mesh_back() {
        let result = tiny();
        let object = document::read(&scene(&result).unwrap(), Path::new(".")).unwrap();
        assert_eq!(object.mesh.triangles.len(), result.mesh.triangles.len());
        for t in &object.mesh.triangles {
            for &i in t {
                let p = object.mesh.positions[i as usize];
                let j = result.mesh.positions.iter().position(|q| q.distance(p) < 1e-6).expect("same vertices");
                assert!((object.color[i as usize] - result.albedo[j]).length() < 1e-4);
            }
        }
    }

    /// The Khronos validator, where it is installed (npm i -g gltf-validator; NODE_PATH names its folder).
    #[test]
    fn the_khronos_validator_accepts_it() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tiny.glb");
        write(&tiny(), &file).unwrap();
        let script = "const v=require('gltf-validator'),fs=require('fs');\
            v.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1]))).then(r=>{console.log(JSON.stringify(r.issues));\
            process.exit(r.issues.numErrors?1:0)})";
        let has = std::process::Command::new("node").args(["-e", "require('gltf-validator')"]).output();
        if !has.is_ok_and(|o| o.status.success()) {
            eprintln!("skipped: node with the npm package gltf-validator is not installed");
            return;
        }
        let out = std::process::Command::new("node").args(["-e", script]).arg(&file).output().unwrap();
        assert!(
            out.status.success(),
            "{}{}",
            String::from_utf8_lossy(&out.stdout),
            String::from_utf8_lossy(&out.stderr)
        );
    }
}
