//! The binary part of a glTF file: bytes, views of them, typed accessors; and the container around it.

use serde_json::{Value, json};

const FLOAT: u32 = 5126;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const ARRAY: u32 = 34962;
const ELEMENTS: u32 = 34963;

/// Binary data with views and accessors on it.
#[derive(Default)]
pub struct Buffer {
    /// The data, every view aligned to four bytes.
    pub bytes: Vec<u8>,
    /// `bufferViews`.
    pub views: Vec<Value>,
    /// `accessors`.
    pub accessors: Vec<Value>,
}

impl Buffer {
    /// Appends bytes; the number of their view.
    pub fn add(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
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

    /// Appends positions, with their bounds; the number of their accessor.
    pub fn add_positions(&mut self, positions: &[[f32; 3]]) -> usize {
        let (low, high) = positions.iter().fold(([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]), |(l, h), p| {
            (std::array::from_fn(|k| l[k].min(p[k])), std::array::from_fn(|k| h[k].max(p[k])))
        });
        let accessor = self.add_vectors(positions);
        self.accessors[accessor]["min"] = json!(low);
        self.accessors[accessor]["max"] = json!(high);
        accessor
    }

    /// Appends three-component vectors; the number of their accessor.
    pub fn add_vectors(&mut self, vectors: &[[f32; 3]]) -> usize {
        let view = self.add(bytemuck::cast_slice(vectors), Some(ARRAY));
        self.accessor(json!({ "bufferView": view, "componentType": FLOAT, "count": vectors.len(), "type": "VEC3" }))
    }

    /// Appends texture coordinates; the number of their accessor.
    pub fn add_coordinates(&mut self, coordinates: &[[f32; 2]]) -> usize {
        let view = self.add(bytemuck::cast_slice(coordinates), Some(ARRAY));
        self.accessor(json!({ "bufferView": view, "componentType": FLOAT, "count": coordinates.len(), "type": "VEC2" }))
    }

    /// Appends RGBA colours, 65535 = 1; the number of their accessor.
    pub fn add_colors(&mut self, colors: &[[u16; 4]]) -> usize {
        let view = self.add(bytemuck::cast_slice(colors), Some(ARRAY));
        self.accessor(json!({
            "bufferView": view, "componentType": UNSIGNED_SHORT, "normalized": true, "count": colors.len(), "type": "VEC4",
        }))
    }

    /// Appends corners of triangles; the number of their accessor.
    pub fn add_indices(&mut self, indices: &[u32]) -> usize {
        let view = self.add(bytemuck::cast_slice(indices), Some(ELEMENTS));
        self.accessor(json!({
            "bufferView": view, "componentType": UNSIGNED_INT, "count": indices.len(), "type": "SCALAR",
        }))
    }

    fn accessor(&mut self, accessor: Value) -> usize {
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }
}

/// Header, JSON chunk, binary chunk.
pub fn pack(root: &Value, binary: &[u8]) -> Vec<u8> {
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
