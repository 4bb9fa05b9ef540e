//! Reads PLY meshes in every format and property order, with any further per-vertex columns.

use crate::error::{Error, Result};
use crate::types::{Mesh, vertex_normals};
use glam::Vec3;
use std::path::Path;

/// Bytes of the largest mesh file that is read.
const MAX_BYTES: u64 = 1 << 32;
const MAX_HEADER_BYTES: usize = 1 << 20;

#[derive(Debug, Clone, Copy, PartialEq)]
enum Format {
    Ascii,
    Little,
    Big,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Number {
    fn named(name: &str) -> Option<Self> {
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

    fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

struct Property {
    name: String,
    /// Type of the count in front, for lists.
    count: Option<Number>,
    number: Number,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

/// The data behind the header, number by number.
enum Body<'a> {
    Ascii(std::str::SplitAsciiWhitespace<'a>),
    Binary { bytes: &'a [u8], big: bool },
}

type Parsed<T> = std::result::Result<T, String>;

impl Body<'_> {
    fn next(&mut self, number: Number) -> Parsed<f64> {
        const EARLY: &str = "the data end early";
        match self {
            Self::Ascii(words) => {
                let word = words.next().ok_or(EARLY)?;
                word.parse().map_err(|_| format!("`{}` is no number", word.chars().take(40).collect::<String>()))
            }
            Self::Binary { bytes, big } => {
                let (head, tail) = bytes.split_at_checked(number.bytes()).ok_or(EARLY)?;
                *bytes = tail;
                let mut raw = [0; 8];
                raw[..head.len()].copy_from_slice(head);
                if *big {
                    raw[..head.len()].reverse();
                }
                let [a, b, c, d, ..] = raw;
                Ok(match number {
                    Number::I8 => f64::from(a as i8),
                    Number::U8 => f64::from(a),
                    Number::I16 => f64::from(i16::from_le_bytes([a, b])),
                    Number::U16 => f64::from(u16::from_le_bytes([a, b])),
                    Number::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
                    Number::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
                    Number::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
                    Number::F64 => f64::from_le_bytes(raw),
                })
            }
        }
    }

    fn whole(&mut self, number: Number, below: usize) -> Parsed<usize> {
        let x = self.next(number)?;
        if x.fract() == 0.0 && x >= 0.0 && x < below as f64 {
            Ok(x as usize)
        } else {
            Err(format!("{x} where a whole number below {below} should stand"))
        }
    }

    /// Bytes left: no list or element can be longer.
    fn left(&self, file_bytes: usize) -> usize {
        match self {
            Self::Ascii(_) => file_bytes,
            Self::Binary { bytes, .. } => bytes.len(),
        }
    }
}

/// Reads a mesh: positions, triangles (polygons become fans), and unit normals, which are computed where the file has
/// none.
///
/// # Errors
/// Unreadable, no PLY, NaN or infinity, indices out of range, no vertices or no triangles.
pub fn read_ply(path: &Path) -> Result<Mesh> {
    let length = std::fs::metadata(path).map_err(|e| Error::io(path, e))?.len();
    if length > MAX_BYTES {
        return Err(Error::invalid(path, "the mesh file is larger than 4 GiB", "simplify the mesh"));
    }
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    parse_ply(&bytes, &[])
        .map(|(mesh, _)| mesh)
        .map_err(|problem| Error::invalid(path, problem, "export the mesh again as PLY with triangles"))
}

/// A number per vertex beyond position and normal.
#[derive(Debug, Clone, PartialEq)]
pub struct VertexColumn {
    /// Name of the property.
    pub name: String,
    /// True if the file holds it as `uchar`.
    pub is_byte: bool,
    /// One value a vertex.
    pub values: Vec<f32>,
}

/// Reads a mesh as [`read_ply`] does, from a file's bytes, and those of the `wanted` vertex properties that it has.
///
/// # Errors
/// What is wrong with the bytes.
pub fn parse_ply(bytes: &[u8], wanted: &[&str]) -> Parsed<(Mesh, Vec<VertexColumn>)> {
    let (format, elements, data) = parse_header(bytes)?;
    let mut body = match format {
        Format::Ascii => {
            Body::Ascii(std::str::from_utf8(data).map_err(|_| "ASCII PLY that is no text")?.split_ascii_whitespace())
        }
        Format::Little | Format::Big => Body::Binary { bytes: data, big: format == Format::Big },
    };
    let mut mesh = Mesh::default();
    let mut columns = Vec::new();
    let mut has_vertices = false;
    for element in &elements {
        if element.count > 0 && element.properties.is_empty() {
            return Err(format!("element {} without properties", element.name));
        }
        match element.name.as_str() {
            "vertex" if !has_vertices => {
                has_vertices = true;
                columns = read_vertices(&mut body, element, data.len(), wanted, &mut mesh)?;
            }
            "face" => read_faces(&mut body, element, &mut mesh)?,
            _ => {
                for _ in 0..element.count {
                    read_row(&mut body, &element.properties, |_, _| {})?;
                }
            }
        }
    }
    if mesh.positions.is_empty() {
        return Err("the mesh has no vertices".into());
    }
    if mesh.triangles.is_empty() {
        return Err("the mesh has no triangles".into());
    }
    let computed = vertex_normals(&mesh.positions, &mesh.triangles);
    if mesh.normals.is_empty() {
        mesh.normals = computed;
    } else {
        let given = mesh.normals.iter().zip(computed).map(|(n, computed)| n.normalize_or(computed));
        mesh.normals = given.collect();
    }
    Ok((mesh, columns))
}

fn parse_header(bytes: &[u8]) -> Parsed<(Format, Vec<Element>, &[u8])> {
    let head = &bytes[..bytes.len().min(MAX_HEADER_BYTES)];
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut at = 0;
    loop {
        let length = head[at..].iter().position(|b| *b == b'\n').ok_or("no PLY header")?;
        let line = std::str::from_utf8(&head[at..at + length]).map_err(|_| "no PLY header")?.trim();
        if at == 0 && line != "ply" {
            return Err("no PLY file".into());
        }
        at += length + 1;
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let bad = || format!("header line `{}`", line.chars().take(80).collect::<String>());
        match words.as_slice() {
            ["ply"] | [] | ["comment" | "obj_info", ..] => {}
            ["format", name, "1.0"] => {
                format = Some(match *name {
                    "ascii" => Format::Ascii,
                    "binary_little_endian" => Format::Little,
                    "binary_big_endian" => Format::Big,
                    _ => return Err(bad()),
                });
            }
            ["element", name, count] => {
                let count = count.parse().map_err(|_| bad())?;
                elements.push(Element { name: (*name).into(), count, properties: Vec::new() });
            }
            ["property", kind @ .., name] => {
                let (count, number) = match kind {
                    ["list", count, number] => (Some(Number::named(count).ok_or_else(bad)?), *number),
                    [number] => (None, *number),
                    _ => return Err(bad()),
                };
                let number = Number::named(number).ok_or_else(bad)?;
                let element = elements.last_mut().ok_or_else(bad)?;
                element.properties.push(Property { name: (*name).into(), count, number });
            }
            ["end_header"] => break,
            _ => return Err(bad()),
        }
    }
    Ok((format.ok_or("a PLY header without a format")?, elements, &bytes[at..]))
}

/// Reads one row of an element; `each` gets the number of the property and its values one by one.
fn read_row(body: &mut Body, properties: &[Property], mut each: impl FnMut(usize, f64)) -> Parsed<()> {
    for (index, property) in properties.iter().enumerate() {
        let n = match property.count {
            Some(count) => body.whole(count, usize::MAX)?,
            None => 1,
        };
        for _ in 0..n {
            each(index, body.next(property.number)?);
        }
    }
    Ok(())
}

fn read_vertices(
    body: &mut Body,
    element: &Element,
    file_bytes: usize,
    wanted: &[&str],
    mesh: &mut Mesh,
) -> Parsed<Vec<VertexColumn>> {
    let find = |name: &str| element.properties.iter().position(|p| p.name == name && p.count.is_none());
    let [x, y, z] = ["x", "y", "z"].map(|name| find(name).ok_or_else(|| format!("vertices without {name}")));
    let position = [x?, y?, z?];
    let normal = match ["nx", "ny", "nz"].map(find) {
        [Some(x), Some(y), Some(z)] => Some([x, y, z]),
        _ => None,
    };
    if element.count > body.left(file_bytes) || element.count > u32::MAX as usize {
        return Err(format!("{} vertices announced, but the data end early", element.count));
    }
    let found = wanted.iter().filter_map(|name| find(name));
    let mut columns: Vec<(usize, VertexColumn)> = found
        .map(|k| {
            let p = &element.properties[k];
            (k, VertexColumn { name: p.name.clone(), is_byte: p.number == Number::U8, values: Vec::new() })
        })
        .collect();
    let mut row = vec![0.0; element.properties.len()];
    for index in 0..element.count {
        read_row(body, &element.properties, |property, value| row[property] = value)?;
        let vector = |columns: [usize; 3]| Vec3::from_array(columns.map(|c| row[c] as f32));
        mesh.positions.push(vector(position));
        mesh.normals.extend(normal.map(vector));
        columns.iter_mut().for_each(|(k, column)| column.values.push(row[*k] as f32));
        if !mesh.positions[index].is_finite() || !mesh.normals.get(index).is_none_or(|n| n.is_finite()) {
            return Err(format!("vertex {index} is NaN or infinite"));
        }
    }
    Ok(columns.into_iter().map(|(_, column)| column).collect())
}

fn read_faces(body: &mut Body, element: &Element, mesh: &mut Mesh) -> Parsed<()> {
    let corners = |p: &Property| p.count.is_some() && matches!(p.name.as_str(), "vertex_indices" | "vertex_index");
    let list = element.properties.iter().position(corners);
    let list = list.ok_or("faces without a list vertex_indices")?;
    let mut polygon: Vec<f64> = Vec::new();
    for face in 0..element.count {
        polygon.clear();
        read_row(body, &element.properties, |property, value| {
            if property == list {
                polygon.push(value);
            }
        })?;
        let vertices = mesh.positions.len();
        if let Some(bad) = polygon.iter().find(|v| !(v.fract() == 0.0 && **v >= 0.0 && **v < vertices as f64)) {
            return Err(format!("face {face} refers to vertex {bad} of {vertices}"));
        }
        for k in 2..polygon.len() {
            mesh.triangles.push([polygon[0] as u32, polygon[k - 1] as u32, polygon[k] as u32]);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parse(bytes: &[u8]) -> Parsed<Mesh> {
        parse_ply(bytes, &[]).map(|(mesh, _)| mesh)
    }

    const SQUARE: &str = "ply\nformat ascii 1.0\ncomment made by hand\nelement vertex 4\nproperty uchar red\n\
        property double z\nproperty list uchar short tags\nproperty float y\nproperty float x\nelement edge 1\n\
        property int a\nproperty int b\nelement face 1\nproperty uchar flag\nproperty list uchar int vertex_indices\n\
        end_header\n9 0 2 5 6 0 0\n9 0 0 0 1\n9 0 0 1 1\n9 0 1 7 1 0\n0 1\n1 4 0 1 2 3\n";

    #[test]
    fn ascii_in_any_property_order_with_polygons() {
        let mesh = parse(SQUARE.as_bytes()).unwrap();
        assert_eq!(mesh.positions, [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y]);
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.normals, [Vec3::Z; 4]);
        assert_eq!(parse(SQUARE.replace('\n', "\r\n").as_bytes()).unwrap(), mesh);
    }

    #[test]
    fn big_endian_meshes_are_read() {
        let mut big = b"ply\nformat binary_big_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
            property double z\nelement face 1\nproperty list ushort uint vertex_index\nend_header\n"
            .to_vec();
        for v in [[0.0f32, 0.0, 2.0], [1.0, 0.0, 2.0], [0.0, 1.0, 2.0]] {
            big.extend(v[..2].iter().flat_map(|x| x.to_be_bytes()));
            big.extend(f64::from(v[2]).to_be_bytes());
        }
        big.extend(3u16.to_be_bytes());
        big.extend([0u32, 1, 2].iter().flat_map(|i| i.to_be_bytes()));
        let back = parse(&big).unwrap();
        assert_eq!(back.positions[1], Vec3::new(1.0, 0.0, 2.0));
        assert_eq!(back.triangles, [[0, 1, 2]]);
    }

    #[test]
    fn bad_meshes_are_explained() {
        for (from, to, part) in [
            ("ply\n", "obj\n", "no PLY"),
            ("format ascii 1.0\n", "", "without a format"),
            ("9 0 0 0 1\n", "9 nan 0 0 1\n", "NaN"),
            ("9 0 0 0 1\n", "9 0 0 0 1e60\n", "infinite"),
            ("9 0 0 0 1\n", "9 0 0 x 1\n", "no number"),
            ("4 0 1 2 3\n", "4 0 1 2 4\n", "refers to vertex 4"),
            ("4 0 1 2 3\n", "4 0 1 2 -1\n", "refers to vertex -1"),
            ("4 0 1 2 3\n", "2 0 1\n", "no triangles"),
            ("1 4 0 1 2 3\n", "1 4 0 1", "end early"),
            ("property float x\n", "property float w\n", "without x"),
            ("element face 1", "element face -1", "header line"),
            ("element vertex 4", "element vertex 99999999999", "end early"),
            ("property list uchar int", "property int", "without a list"),
        ] {
            assert!(SQUARE.contains(from));
            let problem = parse(SQUARE.replace(from, to).as_bytes()).unwrap_err();
            assert!(problem.contains(part), "{from:?} → {to:?}: {problem}");
        }
        assert!(parse(b"").is_err());
        let none = "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
        assert!(parse(none.as_bytes()).unwrap_err().contains("no vertices"));
    }

    proptest! {
        #[test]
        fn damage_never_panics(at in any::<usize>(), value in any::<u8>(), cut in any::<usize>(), binary in any::<bool>()) {
            let mut bytes = SQUARE.as_bytes().to_vec();
            if binary {
                let text = SQUARE.replace("ascii", "binary_little_endian");
                let end = text.find("end_header\n").unwrap() + 11;
                bytes = text.as_bytes()[..end].to_vec();
                bytes.extend((0..160u8).map(|i| i % 3));
            }
            let at = at % bytes.len();
            bytes[at] = value;
            let _ = parse(&bytes);
            let _ = parse(&bytes[..cut % bytes.len()]);
        }
    }
}
