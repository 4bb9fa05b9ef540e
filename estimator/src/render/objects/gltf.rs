//! Reads an object from glTF 2.0 (`.glb`, or `.gltf` with files beside it or data in it): triangles of every node of the
//! scene, base colour, metalness, roughness, specular, textures. glTF's +Y up becomes ours: (x, y, z) = (x, −z, y).

use crate::render::objects::{Material, Object, Texture, finish};
use glam::{Mat4, Quat, Vec2, Vec3};
use recordings::types::{ColorEncoding, ColorFrame, Response};
use serde_json::Value;
use std::path::Path;
use std::sync::Arc;

const GLB_MAGIC: u32 = 0x4654_6c67;
const CHUNK_JSON: u32 = 0x4e4f_534a;
const CHUNK_BIN: u32 = 0x004e_4942;
/// Nodes below nodes; deeper means a loop.
const DEEPEST: usize = 64;
/// Vertices and triangles that an object may have.
const MOST_ELEMENTS: usize = 20_000_000;

struct File<'a> {
    json: Value,
    bin: Option<&'a [u8]>,
    folder: &'a Path,
    buffers: Vec<Vec<u8>>,
}

/// Reads `.glb` or `.gltf` bytes; files it refers to stand in `folder`.
///
/// # Errors
/// What is wrong with the bytes, or which file is missing.
pub fn read(bytes: &[u8], folder: &Path) -> Result<Object, String> {
    let mut file = open(bytes, folder)?;
    for buffer in list(&file.json, "buffers").to_vec() {
        let data = match buffer["uri"].as_str() {
            Some(uri) => file.resource(uri)?,
            None => file.bin.ok_or("a buffer without data")?.to_vec(),
        };
        if (data.len() as u64) < buffer["byteLength"].as_u64().unwrap_or(u64::MAX) {
            return Err("a buffer is shorter than it says: the file is truncated".into());
        }
        file.buffers.push(data);
    }
    let mut object = Object { materials: file.materials()?, ..Object::default() };
    object.materials.push(Material { roughness: 1.0, metallic: 1.0, specular: 1.0, ..Material::default() });
    let scene = file.json["scene"].as_u64().unwrap_or(0) as usize;
    let roots: Vec<usize> = match list(&file.json, "scenes").get(scene) {
        Some(scene) => indices(&scene["nodes"]),
        None => (0..list(&file.json, "nodes").len()).collect(),
    };
    for root in roots {
        file.node(root, Mat4::IDENTITY, 0, &mut object)?;
    }
    let turn = |p: &mut Vec3| *p = Vec3::new(p.x, -p.z, p.y);
    object.mesh.positions.iter_mut().for_each(turn);
    object.mesh.normals.iter_mut().for_each(turn);
    finish(object)
}

fn open<'a>(bytes: &'a [u8], folder: &'a Path) -> Result<File<'a>, String> {
    let parse = |text: &[u8]| serde_json::from_slice(text).map_err(|e| format!("not glTF: {e}"));
    let word = |at: usize| {
        bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).ok_or("the file is truncated")
    };
    if bytes.is_empty() {
        return Err("the file is empty".into());
    }
    if word(0) != Ok(GLB_MAGIC) {
        return Ok(File { json: parse(bytes)?, bin: None, folder, buffers: Vec::new() });
    }
    if word(4)? != 2 {
        return Err(format!("glTF version {} is not 2", word(4)?));
    }
    if word(8)? as usize > bytes.len() {
        return Err("the file is truncated".into());
    }
    let (mut json, mut bin, mut at) = (None, None, 12);
    while at + 8 <= bytes.len() {
        let length = word(at)? as usize;
        let data = bytes.get(at + 8..at + 8 + length).ok_or("the file is truncated")?;
        match word(at + 4)? {
            CHUNK_JSON if json.is_none() => json = Some(parse(data)?),
            CHUNK_BIN if bin.is_none() => bin = Some(data),
            _ => {}
        }
        at += 8 + length;
    }
    Ok(File { json: json.ok_or("no JSON chunk in it")?, bin, folder, buffers: Vec::new() })
}

fn list<'a>(json: &'a Value, name: &str) -> &'a [Value] {
    json[name].as_array().map_or(&[], Vec::as_slice)
}

fn indices(value: &Value) -> Vec<usize> {
    value.as_array().map_or(Vec::new(), |a| a.iter().filter_map(Value::as_u64).map(|x| x as usize).collect())
}

fn floats<const N: usize>(value: &Value) -> Option<[f32; N]> {
    let a = value.as_array()?;
    let mut out = [0.0; N];
    for (o, x) in out.iter_mut().zip(a) {
        *o = x.as_f64()? as f32;
    }
    (a.len() >= N).then_some(out)
}

impl File<'_> {
    fn resource(&self, uri: &str) -> Result<Vec<u8>, String> {
        if let Some(data) = uri.strip_prefix("data:") {
            let (_, text) = data.split_once(";base64,").ok_or("a data URI that is not base64")?;
            return base64(text).ok_or_else(|| "a data URI that is not base64".into());
        }
        let name = uri.replace("%20", " ");
        let inside = Path::new(&name).components().all(|c| matches!(c, std::path::Component::Normal(_)));
        if !inside {
            return Err(format!("it refers to `{uri}`, outside its own folder"));
        }
        std::fs::read(self.folder.join(&name)).map_err(|e| format!("it refers to `{uri}`, which cannot be read: {e}"))
    }

    fn view(&self, index: &Value) -> Result<(&[u8], usize), String> {
        let view =
            index.as_u64().and_then(|i| list(&self.json, "bufferViews").get(i as usize)).ok_or("a missing view")?;
        let buffer = self.buffers.get(view["buffer"].as_u64().unwrap_or(0) as usize).ok_or("a missing buffer")?;
        let start = view["byteOffset"].as_u64().unwrap_or(0) as usize;
        let length = view["byteLength"].as_u64().ok_or("a view without length")? as usize;
        let end = start.checked_add(length).ok_or("a view out of range")?;
        let data = buffer.get(start..end).ok_or("a view goes beyond its buffer")?;
        Ok((data, view["byteStride"].as_u64().unwrap_or(0) as usize))
    }

    /// Values of an accessor, `width` a row; integers are normalised if they say so.
    fn accessor(&self, index: &Value, width: usize) -> Result<Vec<f64>, String> {
        let a =
            index.as_u64().and_then(|i| list(&self.json, "accessors").get(i as usize)).ok_or("a missing accessor")?;
        let have = match a["type"].as_str() {
            Some("SCALAR") => 1,
            Some("VEC2") => 2,
            Some("VEC3") => 3,
            Some("VEC4") => 4,
            _ => return Err("an accessor of a kind that is not read".into()),
        };
        if have < width || !a["sparse"].is_null() {
            return Err("an accessor of a kind that is not read".into());
        }
        let count = a["count"].as_u64().unwrap_or(0) as usize;
        if count > MOST_ELEMENTS {
            return Err("more vertices than can be used".into());
        }
        let (size, divisor) = match a["componentType"].as_u64() {
            Some(5120) => (1, 127.0),
            Some(5121) => (1, 255.0),
            Some(5122) => (2, 32_767.0),
            Some(5123) => (2, 65_535.0),
            Some(5125) => (4, 1.0),
            Some(5126) => (4, 1.0),
            _ => return Err("an unknown component type".into()),
        };
        let divisor = if a["normalized"].as_bool() == Some(true) { divisor } else { 1.0 };
        let (data, stride) = self.view(&a["bufferView"])?;
        let stride = if stride == 0 { size * have } else { stride };
        let start = a["byteOffset"].as_u64().unwrap_or(0) as usize;
        let mut out = Vec::with_capacity((count * width).min(data.len()));
        for i in 0..count {
            for k in 0..width {
                let at = start.saturating_add(i.saturating_mul(stride)).saturating_add(k * size);
                let b = data.get(at..at.saturating_add(size)).ok_or("an accessor goes beyond its view")?;
                let x = match a["componentType"].as_u64() {
                    Some(5120) => f64::from(b[0] as i8),
                    Some(5121) => f64::from(b[0]),
                    Some(5122) => f64::from(i16::from_le_bytes([b[0], b[1]])),
                    Some(5123) => f64::from(u16::from_le_bytes([b[0], b[1]])),
                    Some(5125) => f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
                    _ => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
                };
                out.push(x / divisor);
            }
        }
        Ok(out)
    }

    fn texture(&self, info: &Value, linear: bool) -> Result<Option<Arc<Texture>>, String> {
        let Some(index) = info["index"].as_u64() else {
            return Ok(None);
        };
        let texture = list(&self.json, "textures").get(index as usize).ok_or("a missing texture")?;
        let image = texture["source"]
            .as_u64()
            .and_then(|i| list(&self.json, "images").get(i as usize))
            .ok_or("a missing picture")?;
        let bytes = match image["uri"].as_str() {
            Some(uri) => self.resource(uri)?,
            None => self.view(&image["bufferView"])?.0.to_vec(),
        };
        let picture = decode(bytes).map_err(|e| format!("a texture cannot be read: {e}"))?;
        let response = if linear { Response::Linear } else { Response::Srgb };
        Ok(Some(Arc::new(Texture::new(&picture, &response.linear_table()))))
    }

    fn materials(&self) -> Result<Vec<Material>, String> {
        list(&self.json, "materials")
            .iter()
            .map(|m| {
                let pbr = &m["pbrMetallicRoughness"];
                let factor = floats::<3>(&pbr["baseColorFactor"]).unwrap_or([1.0; 3]);
                let number = |v: &Value| v.as_f64().map_or(1.0, |x| x as f32);
                Ok(Material {
                    base_color: Vec3::from(factor),
                    metallic: number(&pbr["metallicFactor"]),
                    roughness: number(&pbr["roughnessFactor"]),
                    specular: number(&m["extensions"]["KHR_materials_specular"]["specularFactor"]),
                    mirror: 0.0,
                    texture: self.texture(&pbr["baseColorTexture"], false)?,
                    metallic_roughness: self.texture(&pbr["metallicRoughnessTexture"], true)?,
                })
            })
            .collect()
    }

    fn node(&self, index: usize, parent: Mat4, depth: usize, object: &mut Object) -> Result<(), String> {
        let node = list(&self.json, "nodes").get(index).ok_or("a missing node")?;
        if depth > DEEPEST {
            return Err("its nodes are nested too deeply, or in a loop".into());
        }
        let local = match floats::<16>(&node["matrix"]) {
            Some(m) => Mat4::from_cols_array(&m),
            None => Mat4::from_scale_rotation_translation(
                floats::<3>(&node["scale"]).map_or(Vec3::ONE, Vec3::from),
                floats::<4>(&node["rotation"]).map_or(Quat::IDENTITY, |q| Quat::from_array(q).normalize()),
                floats::<3>(&node["translation"]).map_or(Vec3::ZERO, Vec3::from),
            ),
        };
        let world = parent * local;
        if let Some(mesh) = node["mesh"].as_u64() {
            let mesh = list(&self.json, "meshes").get(mesh as usize).ok_or("a missing mesh")?;
            for primitive in list(mesh, "primitives") {
                self.primitive(primitive, world, object)?;
            }
        }
        for child in indices(&node["children"]) {
            self.node(child, world, depth + 1, object)?;
        }
        Ok(())
    }

    fn primitive(&self, primitive: &Value, world: Mat4, object: &mut Object) -> Result<(), String> {
        if primitive["mode"].as_u64().unwrap_or(4) != 4 {
            return Ok(());
        }
        let attributes = &primitive["attributes"];
        let vectors = |name: &str| -> Result<Vec<Vec3>, String> {
            let a = &attributes[name];
            if a.is_null() {
                return Ok(Vec::new());
            }
            let flat = self.accessor(a, 3)?;
            Ok(flat.chunks_exact(3).map(|p| Vec3::new(p[0] as f32, p[1] as f32, p[2] as f32)).collect())
        };
        let positions = vectors("POSITION")?;
        let n = positions.len();
        let normals = vectors("NORMAL")?;
        let color = vectors("COLOR_0")?;
        let uv: Vec<Vec2> = if attributes["TEXCOORD_0"].is_null() {
            Vec::new()
        } else {
            let flat = self.accessor(&attributes["TEXCOORD_0"], 2)?;
            flat.chunks_exact(2).map(|p| Vec2::new(p[0] as f32, p[1] as f32)).collect()
        };
        let list: Vec<u32> = if primitive["indices"].is_null() {
            (0..n as u32).collect()
        } else {
            self.accessor(&primitive["indices"], 1)?.iter().map(|i| *i as u32).collect()
        };
        let last = object.materials.len() - 1;
        let material = primitive["material"].as_u64().map_or(last, |m| (m as usize).min(last)) as u16;
        let turn = world.inverse().transpose();
        let mut part = Object::default();
        part.mesh.triangles = list.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
        if part.mesh.triangles.iter().flatten().any(|i| *i as usize >= n) {
            return Err("a triangle names a vertex that is not there".into());
        }
        part.mesh.positions = positions.iter().map(|p| world.transform_point3(*p)).collect();
        part.mesh.normals = if normals.len() == n {
            normals.iter().map(|x| turn.transform_vector3(*x).normalize_or(Vec3::Y)).collect()
        } else {
            crate::render::objects::vertex_normals(&part.mesh.positions, &part.mesh.triangles)
        };
        part.color = if color.len() == n { color } else { Vec::new() };
        part.uv = if uv.len() == n { uv } else { Vec::new() };
        let triangles = part.mesh.triangles.len();
        object.append(&part);
        object.material.extend(std::iter::repeat_n(material, triangles));
        Ok(())
    }
}

/// Decodes a PNG or JPEG whose size is not known beforehand.
pub(crate) fn decode(bytes: Vec<u8>) -> Result<recordings::types::RgbImage, String> {
    let (width, height, encoding) = picture_size(&bytes).ok_or("neither PNG nor JPEG")?;
    ColorFrame { timestamp_ns: 0, width, height, encoding, bytes, missing_packets: 0 }.decode()
}

/// Width and height from the header of a PNG or JPEG.
pub(crate) fn picture_size(b: &[u8]) -> Option<(u32, u32, ColorEncoding)> {
    let be = |at: usize, n: usize| Some(b.get(at..at + n)?.iter().fold(0u32, |x, v| x << 8 | u32::from(*v)));
    if b.starts_with(b"\x89PNG\r\n\x1a\n") {
        return Some((be(16, 4)?, be(20, 4)?, ColorEncoding::Png));
    }
    if !b.starts_with(&[0xff, 0xd8]) {
        return None;
    }
    let mut at = 2;
    loop {
        let marker = *b.get(at + 1)?;
        if b[at] != 0xff {
            return None;
        }
        if (0xc0..=0xcf).contains(&marker) && ![0xc4, 0xc8, 0xcc].contains(&marker) {
            return Some((be(at + 7, 2)?, be(at + 5, 2)?, ColorEncoding::Jpeg));
        }
        at += if marker == 0xff { 1 } else { 2 + be(at + 2, 2)? as usize };
    }
}

fn base64(text: &str) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(text.len() / 4 * 3);
    let (mut bits, mut have) = (0u32, 0);
    for c in text.bytes().filter(|c| *c != b'=') {
        let value = match c {
            b'A'..=b'Z' => c - b'A',
            b'a'..=b'z' => c - b'a' + 26,
            b'0'..=b'9' => c - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => return None,
        };
        bits = bits << 6 | u32::from(value);
        have += 6;
        if have >= 8 {
            have -= 8;
            out.push((bits >> have) as u8);
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A red metal triangle in a `.gltf` with its data inside, one unit up.
    fn triangle() -> String {
        let mut data = Vec::new();
        for x in [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
            data.extend(x.to_le_bytes());
        }
        let alphabet = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
        let text: String = data
            .chunks_exact(3)
            .flat_map(|c| {
                let x = u32::from(c[0]) << 16 | u32::from(c[1]) << 8 | u32::from(c[2]);
                [18, 12, 6, 0].map(|s| alphabet[(x >> s & 63) as usize] as char)
            })
            .collect();
        format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0,"translation":[0,1,0]}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"material":0}}]}}],
            "materials":[{{"pbrMetallicRoughness":{{"baseColorFactor":[1,0,0,1],"roughnessFactor":0}}}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}}],
            "bufferViews":[{{"buffer":0,"byteLength":36}}],
            "buffers":[{{"byteLength":36,"uri":"data:application/octet-stream;base64,{text}"}}]}}"#
        )
    }

    #[test]
    fn up_is_turned_and_materials_are_read() {
        let object = read(triangle().as_bytes(), Path::new(".")).unwrap();
        assert_eq!(object.mesh.positions, [Vec3::Z, Vec3::new(1.0, 0.0, 1.0), Vec3::new(0.0, 0.0, 2.0)]);
        assert!((object.mesh.normals[0] - Vec3::NEG_Y).length() < 1e-6, "{}", object.mesh.normals[0]);
        let m = &object.materials[0];
        assert_eq!((m.base_color, m.metallic, m.roughness), (Vec3::X, 1.0, 0.0));
    }

    #[test]
    fn what_cannot_be_read_is_named() {
        let say =
            |from: &str, to: &str| read(triangle().replace(from, to).as_bytes(), Path::new("/nowhere")).unwrap_err();
        assert!(say("\"byteLength\":36,\"uri\"", "\"byteLength\":99,\"uri\"").contains("truncated"));
        assert!(say("data:application/octet-stream;base64,", "gone.bin?").contains("gone.bin"));
        assert!(say("data:application/octet-stream;base64,", "../../").contains("outside"));
        assert!(say("\"count\":3", "\"count\":4").contains("beyond"));
        assert!(say("\"count\":3", "\"count\":99999999999").contains("more vertices"));
        assert!(say("\"POSITION\":0", "\"COLOR_0\":0").contains("no triangles"));
        assert!(read(b"", Path::new(".")).unwrap_err().contains("empty"));
        let text = triangle();
        for n in 0..text.len() {
            assert!(read(&text.as_bytes()[..n], Path::new(".")).is_err());
        }
    }

    proptest::proptest! {
        #[test]
        fn no_bytes_panic(bytes in proptest::collection::vec(0u8.., 0..200)) {
            let _ = read(&bytes, Path::new("."));
            let _ = super::super::ply::read(&bytes);
            let _ = decode(bytes);
        }
    }
}
