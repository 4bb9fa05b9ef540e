//! From a glTF document to an object: triangles of every node of the scene, base colour, metalness, roughness, specular,
//! textures. glTF's +Y up becomes ours: (x, y, z) = (x, −z, y).

use super::accessor::rows;
use super::resources::{Resources, Textures};
use crate::render::objects::material::Material;
use crate::render::objects::object::{Object, finish};
use ::gltf::json::validation::{Error, Validate};
use ::gltf::json::{Path as JsonPath, Root};
use ::gltf::mesh::{Mode, Semantic};
use ::gltf::scene::Transform;
use ::gltf::{Document, Gltf, Node, Primitive};
use glam::{Mat4, Quat, Vec2, Vec3};
use recordings::types::{Mesh, Response, vertex_normals};
use std::path::Path;

/// Vertices, and corners of triangles, that an object may have.
const MAX_ELEMENTS: usize = 20_000_000;
/// Required extensions without which the geometry cannot be read.
const COMPRESSIONS: [&str; 2] = ["KHR_draco_mesh_compression", "EXT_meshopt_compression"];

/// Reads `.glb` or `.gltf` bytes; files it refers to stand in `folder`.
///
/// # Errors
/// What is wrong with the bytes, or which file is missing.
pub fn read(bytes: &[u8], folder: &Path) -> Result<Object, String> {
    let Gltf { document, blob } = parse(bytes)?;
    let mut resources = Resources::new(folder);
    let buffers = resources.buffers(&document, blob)?;
    let mut textures = Textures::new(&document, &buffers, resources);
    let mut object = Object::default();
    for material in document.materials() {
        object.materials.push(read_material(&material, &mut textures)?);
    }
    object.materials.push(Material { roughness: 1.0, metallic: 1.0, specular: 1.0, ..Material::default() });
    add_nodes(&document, &buffers, &mut object)?;
    let turn = |p: &mut Vec3| *p = Vec3::new(p.x, -p.z, p.y);
    object.mesh.positions.iter_mut().for_each(turn);
    object.mesh.normals.iter_mut().for_each(turn);
    finish(object)
}

fn parse(bytes: &[u8]) -> Result<Gltf, String> {
    if bytes.is_empty() {
        return Err("the file is empty".into());
    }
    // The crate subtracts the header's 12 bytes from this length.
    let length = bytes.get(8..12).map(|b| b.iter().rev().fold(0u32, |x, b| x << 8 | u32::from(*b)));
    if bytes.starts_with(b"glTF") && length.is_none_or(|length| length < 12) {
        return Err("the file is truncated".into());
    }
    let gltf = Gltf::from_slice_without_validation(bytes).map_err(|e| format!("not glTF 2.0, or truncated: {e}"))?;
    validate(gltf.document.as_json())?;
    Ok(gltf)
}

/// The crate's own validation, without what is not used here or checked later: bounds of positions, attributes of
/// unknown name, strides, and required extensions that change no geometry.
fn validate(root: &Root) -> Result<(), String> {
    if let Some(name) = root.extensions_required.iter().find(|e| COMPRESSIONS.contains(&e.as_str())) {
        return Err(format!("its geometry is compressed ({name}); export it without compression"));
    }
    // The crate looks these up before it validates them.
    let positions = ::gltf::json::validation::Checked::Valid(Semantic::Positions);
    let mut primitives = root.meshes.iter().flat_map(|m| &m.primitives);
    if primitives.any(|p| p.attributes.get(&positions).is_some_and(|a| root.get(*a).is_none())) {
        return Err("a primitive refers to a missing accessor".into());
    }
    let mut first = None;
    root.validate(root, JsonPath::new, &mut |path, error| {
        if first.is_none() && error != Error::Unsupported {
            let path = path().to_string();
            let harmless =
                path.ends_with("byteStride") || (path.contains(".attributes") && error != Error::IndexOutOfBounds);
            first = (!harmless).then(|| format!("{path}: {error}"));
        }
    });
    first.map_or(Ok(()), |problem| Err(format!("the file is damaged, or made for another version of glTF: {problem}")))
}

fn read_material(material: &::gltf::Material<'_>, textures: &mut Textures<'_>) -> Result<Material, String> {
    let pbr = material.pbr_metallic_roughness();
    let [r, g, b, _] = pbr.base_color_factor();
    Ok(Material {
        base_color: Vec3::new(r, g, b),
        metallic: pbr.metallic_factor(),
        roughness: pbr.roughness_factor(),
        specular: material.specular().map_or(1.0, |s| s.specular_factor()),
        mirror: 0.0,
        texture: textures.get(pbr.base_color_texture(), Response::Srgb)?,
        metallic_roughness: textures.get(pbr.metallic_roughness_texture(), Response::Linear)?,
    })
}

/// Adds the meshes of all nodes below the scene's roots, parents before children.
fn add_nodes(document: &Document, buffers: &[Vec<u8>], object: &mut Object) -> Result<(), String> {
    let scene = document.default_scene().or_else(|| document.scenes().next());
    let roots: Vec<Node> = scene.map_or_else(|| document.nodes().collect(), |scene| scene.nodes().collect());
    let mut open: Vec<(Node, Mat4)> = roots.into_iter().rev().map(|node| (node, Mat4::IDENTITY)).collect();
    let mut visited = vec![false; document.nodes().len()];
    while let Some((node, parent)) = open.pop() {
        if std::mem::replace(&mut visited[node.index()], true) {
            return Err("a node has two parents, or its nodes form a loop".into());
        }
        let world = parent * local_transform(&node);
        for primitive in node.mesh().iter().flat_map(::gltf::Mesh::primitives) {
            if primitive.mode() == Mode::Triangles {
                add_primitive(&primitive, world, buffers, object)?;
            }
        }
        let children: Vec<Node> = node.children().collect();
        open.extend(children.into_iter().rev().map(|child| (child, world)));
    }
    Ok(())
}

fn local_transform(node: &Node<'_>) -> Mat4 {
    match node.transform() {
        Transform::Matrix { matrix } => Mat4::from_cols_array_2d(&matrix),
        Transform::Decomposed { translation, rotation, scale } => Mat4::from_scale_rotation_translation(
            scale.into(),
            Quat::from_array(rotation).normalize(),
            translation.into(),
        ),
    }
}

fn add_primitive(
    primitive: &Primitive<'_>,
    world: Mat4,
    buffers: &[Vec<u8>],
    object: &mut Object,
) -> Result<(), String> {
    let Some(positions) = primitive.get(&Semantic::Positions) else { return Ok(()) };
    let n = positions.count();
    let corners = primitive.indices().map_or(n, |indices| indices.count());
    let total =
        object.mesh.positions.len().saturating_add(n).max(object.mesh.triangles.len() * 3 + corners.min(1 << 40));
    if total > MAX_ELEMENTS {
        return Err(format!("it has more vertices than can be used ({MAX_ELEMENTS}); simplify it"));
    }
    let vectors = |semantic: Semantic| -> Result<Vec<Vec3>, String> {
        let accessor = primitive.get(&semantic).filter(|a| a.count() == n);
        let rows = accessor.map_or(Ok(Vec::new()), |a| rows::<3>(&a, buffers))?;
        Ok(rows.into_iter().map(|p| Vec3::from_array(p.map(|x| x as f32))).collect())
    };
    let coordinates = primitive.get(&Semantic::TexCoords(0)).filter(|a| a.count() == n);
    let uv = coordinates.map_or(Ok(Vec::new()), |a| rows::<2>(&a, buffers))?;
    let indices: Vec<u32> = match primitive.indices() {
        Some(indices) => rows::<1>(&indices, buffers)?.iter().map(|[i]| *i as u32).collect(),
        None => (0..n as u32).collect(),
    };
    if indices.iter().any(|i| *i as usize >= n) {
        return Err("a triangle refers to a vertex that does not exist".into());
    }
    let mut mesh = Mesh {
        positions: vectors(Semantic::Positions)?.iter().map(|p| world.transform_point3(*p)).collect(),
        normals: vectors(Semantic::Normals)?,
        triangles: indices.as_chunks().0.to_vec(),
    };
    if mesh.normals.is_empty() {
        mesh.normals = vertex_normals(&mesh.positions, &mesh.triangles);
    } else {
        let normals_from_local = world.inverse().transpose();
        mesh.normals.iter_mut().for_each(|n| *n = normals_from_local.transform_vector3(*n).normalize_or(Vec3::Y));
    }
    let default = object.materials.len() - 1;
    let material = primitive.material().index().unwrap_or(default) as u32;
    object.material.resize(object.material.len() + mesh.triangles.len(), material);
    let color = vectors(Semantic::Colors(0))?;
    let uv = uv.iter().map(|[u, v]| Vec2::new(*u as f32, *v as f32)).collect();
    object.append(&Object { mesh, color, uv, ..Object::default() });
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use base64::Engine;
    use base64::engine::general_purpose::STANDARD;

    /// A red metal triangle in a `.gltf` with its data inside, one unit up.
    fn triangle() -> String {
        let mut data = Vec::new();
        for x in [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
            data.extend(x.to_le_bytes());
        }
        let text = STANDARD.encode(data);
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

    /// Rows of accessor 0 of a document over one buffer.
    fn rows_of<const N: usize>(accessor: &str, views: &str, data: &[u8]) -> Result<Vec<[f64; N]>, String> {
        let text = format!(
            r#"{{"asset":{{"version":"2.0"}},"accessors":[{accessor}],"bufferViews":[{views}],
            "buffers":[{{"byteLength":{}}}]}}"#,
            data.len()
        );
        let document = parse(text.as_bytes())?.document;
        let accessor = document.accessors().next().ok_or("no accessor")?;
        rows::<N>(&accessor, &[data.to_vec()])
    }

    #[test]
    fn every_component_type_is_read() {
        let one = |kind: u32, normalized: bool, data: &[u8]| {
            let accessor = format!(
                r#"{{"bufferView":0,"componentType":{kind},"count":2,"type":"VEC2","normalized":{normalized}}}"#
            );
            let views = format!(r#"{{"buffer":0,"byteLength":{},"byteStride":{}}}"#, data.len(), data.len() / 2);
            rows_of::<2>(&accessor, &views, data).unwrap()[1]
        };
        assert_eq!(one(5120, true, &[0, 0, 0, 0, 127, 128, 0, 0]), [1.0, -1.0]);
        assert_eq!(one(5121, false, &[0, 0, 0, 0, 7, 255, 0, 0]), [7.0, 255.0]);
        assert_eq!(one(5122, false, &[0, 0, 0, 0, 254, 255, 1, 0]), [-2.0, 1.0]);
        assert_eq!(one(5123, true, &[0, 0, 0, 0, 255, 255, 0, 0]), [1.0, 0.0]);
        let words = |x: [u32; 4]| x.map(u32::to_le_bytes).concat();
        assert_eq!(one(5125, false, &words([0, 0, 1, u32::MAX])), [1.0, 4_294_967_295.0]);
        assert_eq!(one(5126, false, &words([0, 0, 1.5f32.to_bits(), 0])), [1.5, 0.0]);
    }

    #[test]
    fn sparse_accessors_replace_rows_and_bad_ones_are_refused() {
        let data = [1u8, 2, 3, 4, 2, 0, 9, 0];
        let views = r#"{"buffer":0,"byteLength":4},{"buffer":0,"byteOffset":4,"byteLength":1},{"buffer":0,"byteOffset":6,"byteLength":1}"#;
        let accessor = |base: &str, count: usize, sparse: usize| {
            format!(
                r#"{{{base}"componentType":5121,"count":{count},"type":"SCALAR","sparse":{{"count":{sparse},
                "indices":{{"bufferView":1,"componentType":5121}},"values":{{"bufferView":2}}}}}}"#
            )
        };
        let read = |accessor: &str| rows_of::<1>(accessor, views, &data);
        assert_eq!(read(&accessor("\"bufferView\":0,", 4, 1)).unwrap(), [[1.0], [2.0], [9.0], [4.0]]);
        assert_eq!(read(&accessor("", 4, 1)).unwrap(), [[0.0], [0.0], [9.0], [0.0]]);
        for (base, count, sparse) in [("", 4, 0), ("", 4, 2), ("", 0, 1), ("", 1, 2), ("\"bufferView\":0,", 5, 1)] {
            assert!(read(&accessor(base, count, sparse)).is_err(), "{base} {count} {sparse}");
        }
    }

    #[test]
    fn hostile_documents_are_refused() {
        let say = |from: &str, to: &str| {
            let text = triangle();
            assert!(text.contains(from), "{from}");
            read(text.replace(from, to).as_bytes(), Path::new(".")).unwrap_err()
        };
        assert!(say("\"POSITION\":0", "\"POSITION\":9").contains("missing accessor"));
        assert!(say("\"material\":0", "\"material\":9").contains("out of bounds"));
        assert!(say("\"mesh\":0,", "\"mesh\":0,\"children\":[0],").contains("loop"));
        assert!(say("\"nodes\":[0]", "\"nodes\":[0,0]").contains("two parents"));
        assert!(say("\"bufferView\":0,", "").contains("bufferView"));
        assert!(say("\"byteLength\":36}],", "\"byteLength\":36,\"byteStride\":4}],").contains("beyond"));
        assert!(say("\"buffer\":0,", "\"buffer\":0,\"byteOffset\":18446744073709551615,").contains("beyond"));
        assert!(say("\"count\":3", "\"count\":3,\"byteOffset\":18446744073709551615").contains("beyond"));
        assert!(say("\"type\":\"VEC3\"", "\"type\":\"MAT4\"").contains("Mat4"));
        assert!(say("\"VEC3\"", "\"VEC2\"").contains("Vec2"));
        let draco = "{\"extensionsRequired\":[\"KHR_draco_mesh_compression\"],\"asset\"";
        assert!(say("{\"asset\"", draco).contains("without compression"));
        assert!(say("\"translation\":[0,1,0]", "\"translation\":[0,1e39,0]").contains("finite"));
        let image = ",\"images\":[{\"bufferView\":0}],\"textures\":[{\"source\":0}],\"materials\"";
        let text = triangle().replace(",\n            \"materials\"", image);
        let text = text.replace("\"baseColorFactor\"", "\"baseColorTexture\":{\"index\":0},\"baseColorFactor\"");
        assert!(read(text.as_bytes(), Path::new(".")).unwrap_err().contains("neither PNG nor JPEG"));
        for length in [0u32, 11, 12, 13, u32::MAX] {
            let glb = [&b"glTF"[..], &2u32.to_le_bytes(), &length.to_le_bytes(), &[0; 8]].concat();
            assert!(read(&glb, Path::new(".")).is_err(), "{length}");
        }
    }

    proptest::proptest! {
        #[test]
        fn no_bytes_panic(bytes in proptest::collection::vec(0u8.., 0..200)) {
            let _ = read(&bytes, Path::new("."));
            let _ = crate::render::objects::ply::read(&bytes);
        }

        #[test]
        fn no_changed_digit_panics(changes in proptest::collection::vec((0usize..2000, 0u8..10), 1..4)) {
            let mut text = triangle().replace("\"material\":0", "\"material\":0,\"indices\":0").into_bytes();
            let digits: Vec<usize> = (0..text.len()).filter(|i| text[*i].is_ascii_digit()).collect();
            for (at, digit) in changes {
                text[digits[at % digits.len()]] = b'0' + digit;
            }
            let _ = read(&text, Path::new("."));
        }
    }
}
