//! Reads an object from a PLY file (ASCII or binary): positions, normals, colours, texture coordinates, faces.

use super::object::{Material, Object, vertex_normals};
use glam::{Vec2, Vec3};
use recordings::types::Response;

/// Vertices and faces that an object may have.
pub const MOST_ELEMENTS: usize = 20_000_000;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }
}

#[derive(Debug)]
struct Property {
    name: String,
    scalar: Scalar,
    count: Option<Scalar>,
}

#[derive(Debug)]
struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

enum Body<'a> {
    Ascii(std::str::SplitAsciiWhitespace<'a>),
    Binary { bytes: &'a [u8], big_endian: bool },
}

impl Body<'_> {
    fn read(&mut self, scalar: Scalar) -> Result<f64, String> {
        let end = || "the file ends too early".to_string();
        match self {
            Self::Ascii(words) => {
                let word = words.next().ok_or_else(end)?;
                word.parse().map_err(|_| format!("`{word}` is not a number"))
            }
            Self::Binary { bytes, big_endian } => {
                let mut take = |n: usize| {
                    let (head, tail) = bytes.split_at_checked(n).ok_or_else(end)?;
                    *bytes = tail;
                    let mut raw = [0u8; 8];
                    raw[..n].copy_from_slice(head);
                    if *big_endian {
                        raw[..n].reverse();
                    }
                    Ok::<_, String>(raw)
                };
                Ok(match scalar {
                    Scalar::I8 => f64::from(take(1)?[0] as i8),
                    Scalar::U8 => f64::from(take(1)?[0]),
                    Scalar::I16 => take(2).map(|r| f64::from(i16::from_le_bytes([r[0], r[1]])))?,
                    Scalar::U16 => take(2).map(|r| f64::from(u16::from_le_bytes([r[0], r[1]])))?,
                    Scalar::I32 => take(4).map(|r| f64::from(i32::from_le_bytes([r[0], r[1], r[2], r[3]])))?,
                    Scalar::U32 => take(4).map(|r| f64::from(u32::from_le_bytes([r[0], r[1], r[2], r[3]])))?,
                    Scalar::F32 => take(4).map(|r| f64::from(f32::from_le_bytes([r[0], r[1], r[2], r[3]])))?,
                    Scalar::F64 => take(8).map(f64::from_le_bytes)?,
                })
            }
        }
    }
}

fn header(text: &str) -> Result<(Vec<Element>, String), String> {
    let (mut elements, mut format): (Vec<Element>, _) = (Vec::new(), String::new());
    for line in text.lines() {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["format", kind, _] => format = (*kind).to_string(),
            ["element", name, count] => {
                let count = count.parse().map_err(|_| format!("`{count}` is not a number of elements"))?;
                if count > MOST_ELEMENTS {
                    return Err(format!("{count} elements are more than {MOST_ELEMENTS}"));
                }
                elements.push(Element { name: (*name).into(), count, properties: Vec::new() });
            }
            ["property", rest @ ..] => {
                let element = elements.last_mut().ok_or("a property stands before any element")?;
                let scalar = |s: &str| Scalar::parse(s).ok_or(format!("unknown type `{s}`"));
                element.properties.push(match rest {
                    ["list", count, item, name] => {
                        Property { name: (*name).into(), scalar: scalar(item)?, count: Some(scalar(count)?) }
                    }
                    [kind, name] => Property { name: (*name).into(), scalar: scalar(kind)?, count: None },
                    _ => return Err(format!("cannot read the header line `{line}`")),
                });
            }
            _ => {}
        }
    }
    Ok((elements, format))
}

/// Reads an object; world axes (+Z up), metres.
///
/// # Errors
/// What is wrong with the bytes.
pub fn read(bytes: &[u8]) -> Result<Object, String> {
    let marker = b"end_header";
    let end = bytes
        .windows(marker.len())
        .take(1 << 16)
        .position(|w| w == marker)
        .filter(|_| bytes.starts_with(b"ply"))
        .ok_or("not a PLY file (no header)")?;
    let start = end + bytes[end..].iter().position(|b| *b == b'\n').ok_or("the file ends after its header")? + 1;
    let text = std::str::from_utf8(&bytes[..end]).map_err(|_| "the header is not text")?;
    let (elements, format) = header(text)?;
    let mut body = match format.as_str() {
        "ascii" => Body::Ascii(
            std::str::from_utf8(&bytes[start..]).map_err(|_| "the body is not text")?.split_ascii_whitespace(),
        ),
        "binary_little_endian" => Body::Binary { bytes: &bytes[start..], big_endian: false },
        "binary_big_endian" => Body::Binary { bytes: &bytes[start..], big_endian: true },
        other => return Err(format!("unknown PLY format `{other}`")),
    };
    let mut object = Object { materials: vec![Material::default()], ..Object::default() };
    for element in &elements {
        match element.name.as_str() {
            "vertex" => vertices(element, &mut body, &mut object)?,
            "face" => faces(element, &mut body, &mut object)?,
            _ => {
                for _ in 0..element.count {
                    row(element, &mut body, |_, _| Ok(()))?;
                }
            }
        }
    }
    finish(object)
}

/// Calls `visit` with every value of one element; lists come value by value.
fn row(
    element: &Element,
    body: &mut Body<'_>,
    mut visit: impl FnMut(usize, f64) -> Result<(), String>,
) -> Result<(), String> {
    for (k, property) in element.properties.iter().enumerate() {
        let n = match property.count {
            None => 1,
            Some(count) => body.read(count)? as usize,
        };
        for _ in 0..n {
            visit(k, body.read(property.scalar)?)?;
        }
    }
    Ok(())
}

fn vertices(element: &Element, body: &mut Body<'_>, object: &mut Object) -> Result<(), String> {
    let column =
        |names: &[&str]| element.properties.iter().position(|p| p.count.is_none() && names.contains(&p.name.as_str()));
    let three = |n: [&[&str]; 3]| Some([column(n[0])?, column(n[1])?, column(n[2])?]);
    let position = three([&["x"], &["y"], &["z"]]).ok_or("vertices without x, y, z")?;
    let normal = three([&["nx"], &["ny"], &["nz"]]);
    let color = three([&["albedo_r", "red", "r"], &["albedo_g", "green", "g"], &["albedo_b", "blue", "b"]]);
    let uv = column(&["u", "s", "texture_u"]).zip(column(&["v", "t", "texture_v"]));
    let bytes = color.is_some_and(|c| element.properties[c[0]].scalar == Scalar::U8);
    let table = Response::Srgb.linear_table();
    let mut values = vec![0.0f64; element.properties.len()];
    for _ in 0..element.count {
        row(element, body, |k, x| {
            values[k] = x;
            Ok(())
        })?;
        let get = |c: [usize; 3]| Vec3::new(values[c[0]] as f32, values[c[1]] as f32, values[c[2]] as f32);
        object.mesh.positions.push(get(position));
        if let Some(n) = normal {
            object.mesh.normals.push(get(n).normalize_or(Vec3::Z));
        }
        if let Some(c) = color {
            // Bytes are sRGB, floats are linear.
            let decode = |x: f64| table[(x as usize).min(255)];
            object.color.push(if bytes { Vec3::from(c.map(|k| decode(values[k]))) } else { get(c) });
        }
        if let Some((u, v)) = uv {
            object.uv.push(Vec2::new(values[u] as f32, 1.0 - values[v] as f32));
        }
    }
    Ok(())
}

fn faces(element: &Element, body: &mut Body<'_>, object: &mut Object) -> Result<(), String> {
    let list = element.properties.iter().position(|p| p.name.starts_with("vertex_ind") && p.count.is_some());
    let list = list.ok_or("faces without vertex indices")?;
    for _ in 0..element.count {
        let mut polygon: Vec<u32> = Vec::new();
        row(element, body, |k, x| {
            if k == list {
                if x < 0.0 || polygon.len() >= 1024 {
                    return Err(format!("a face names vertex {x}"));
                }
                polygon.push(x as u32);
            }
            Ok(())
        })?;
        for pair in polygon.get(1..).unwrap_or_default().windows(2) {
            object.mesh.triangles.push([polygon[0], pair[0], pair[1]]);
            if object.mesh.triangles.len() > MOST_ELEMENTS {
                return Err("more triangles than can be used".into());
            }
        }
    }
    Ok(())
}

/// Checks what every object must be, and fills in normals.
///
/// # Errors
/// NaN, indices out of range, no triangles.
pub fn finish(mut object: Object) -> Result<Object, String> {
    let n = object.mesh.positions.len();
    if object.mesh.triangles.is_empty() {
        return Err("there are no triangles in it".into());
    }
    if let Some(p) = object.mesh.positions.iter().find(|p| !p.is_finite()) {
        return Err(format!("a vertex is not finite: {p}"));
    }
    if let Some(i) = object.mesh.triangles.iter().flatten().find(|i| **i as usize >= n) {
        return Err(format!("a triangle names vertex {i} of {n}"));
    }
    if object.color.iter().any(|c| !c.is_finite()) {
        return Err("a colour is not finite".into());
    }
    if object.mesh.normals.len() != n || object.mesh.normals.iter().any(|x| !x.is_finite()) {
        object.mesh.normals = vertex_normals(&object.mesh.positions, &object.mesh.triangles);
    }
    object.material.resize(object.mesh.triangles.len(), 0);
    Ok(object)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: &str = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
        property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\nproperty list uchar int vertex_indices\n\
        end_header\n0 0 0 255 0 0\n1 0 0 255 0 0\n0 1 0 255 0 0\n3 0 1 2\n";

    #[test]
    fn a_triangle_is_read_and_every_truncation_is_an_error() {
        let object = read(TRIANGLE.as_bytes()).unwrap();
        assert_eq!(object.mesh.triangles, [[0, 1, 2]]);
        assert_eq!((object.mesh.normals[0], object.color[0]), (Vec3::Z, Vec3::X));
        for n in 0..TRIANGLE.len() - 1 {
            assert!(read(&TRIANGLE.as_bytes()[..n]).is_err(), "{n}");
        }
    }

    #[test]
    fn what_cannot_be_used_is_named() {
        let say = |from: &str, to: &str| read(TRIANGLE.replace(from, to).as_bytes()).unwrap_err();
        assert!(say("1 0 0 255", "nan 0 0 255").contains("not finite"));
        assert!(say("3 0 1 2", "3 0 1 7").contains("names vertex 7 of 3"));
        assert!(say("3 0 1 2", "2 0 1").contains("no triangles"));
        assert!(say("element vertex 3", "element vertex 99999999999").contains("more than"));
        assert!(say("format ascii", "format klingon").contains("klingon"));
    }
}
