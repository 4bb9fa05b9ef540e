//! Scenes whose light and materials are known.

use crate::npy::Array;
use glam::Vec3;
use recordings::types::Mesh;
use std::path::{Path, PathBuf};

/// A truth scene.
#[derive(Debug)]
pub struct Truth {
    /// Its folder.
    pub folder: PathBuf,
    /// Name of the folder.
    pub name: String,
    /// The mesh as given.
    pub mesh: Mesh,
    /// Diffuse albedo per vertex.
    pub albedo: Vec<[f64; 3]>,
    /// Diffuse lit colour per vertex, in radiance units.
    pub lit_color: Vec<[f64; 3]>,
    /// Material per vertex.
    pub material: Vec<u32>,
    /// Keyframes that see each vertex.
    pub seen: Vec<u32>,
    /// 81 coefficients of the light.
    pub light: Vec<[f64; 3]>,
    /// Materials that are glossy.
    pub glossy: Vec<bool>,
}

/// Reference transfer at some vertices, nine bands.
#[derive(Debug)]
pub struct TruthTransfer {
    /// The vertices.
    pub vertices: Vec<usize>,
    /// Cosine alone: `[vertex][81]`.
    pub diffuse: Vec<f64>,
    /// Cosine and visibility: `[vertex][81]`.
    pub shade: Vec<f64>,
    /// With interreflection at the true albedo: `[vertex][81][3]`.
    pub gi: Vec<f64>,
}

impl Truth {
    /// Reads `truth/<name>` of the shared folder.
    ///
    /// # Panics
    /// A file is missing or damaged.
    #[must_use]
    pub fn read(shared: &Path, name: &str) -> Self {
        let folder = shared.join("truth").join(name);
        let truth = folder.join("truth");
        let whole = |file: &str| Array::read(&truth.join(file)).data.iter().map(|x| *x as u32).collect();
        let materials = json(&truth.join("materials.json"));
        Self {
            name: name.into(),
            mesh: read_ply(&folder.join("mesh.ply")),
            albedo: Array::read(&truth.join("albedo.npy")).rgb(),
            lit_color: Array::read(&truth.join("lit_color.npy")).rgb(),
            material: whole("material_id.npy"),
            seen: whole("seen_count.npy"),
            light: rows(&json(&truth.join("lighting_sh.json"))["lighting"]),
            glossy: materials["materials"]
                .as_array()
                .expect("materials")
                .iter()
                .map(|m| m["glossy"].as_bool().expect("glossy"))
                .collect(),
            folder,
        }
    }

    /// Reads the reference transfer.
    ///
    /// # Panics
    /// A file is missing or damaged.
    #[must_use]
    pub fn transfer(&self) -> TruthTransfer {
        let folder = self.folder.join("truth/transfer");
        let read = |file: &str| Array::read(&folder.join(file)).data;
        TruthTransfer {
            vertices: read("vertex_index.npy").iter().map(|x| *x as usize).collect(),
            diffuse: read("T_cos.npy"),
            shade: read("T_vis.npy"),
            gi: read("T_gi.npy"),
        }
    }
}

/// Reads a JSON file.
///
/// # Panics
/// The file is missing or damaged.
#[must_use]
pub fn json(path: &Path) -> serde_json::Value {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn rows(value: &serde_json::Value) -> Vec<[f64; 3]> {
    let rows = value.as_array().expect("rows");
    rows.iter().map(|r| [0, 1, 2].map(|c| r[c].as_f64().expect("a number"))).collect()
}

/// Reads the meshes of the truth scenes: binary little endian, x y z nx ny nz, triangles.
///
/// # Panics
/// The file is missing or of another kind.
#[must_use]
pub fn read_ply(path: &Path) -> Mesh {
    let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let end = b"end_header\n";
    let body = bytes.windows(end.len()).position(|w| w == end).expect("a header") + end.len();
    let header = std::str::from_utf8(&bytes[..body]).expect("a text header");
    let count = |element: &str| -> usize {
        let line = header.lines().find_map(|l| l.strip_prefix(&format!("element {element} "))).expect("element");
        line.trim().parse().expect("a count")
    };
    let (vertices, faces) = (count("vertex"), count("face"));
    let number = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"));
    let vector = |at: usize| Vec3::new(number(at), number(at + 4), number(at + 8));
    let mut mesh = Mesh::default();
    for i in 0..vertices {
        mesh.positions.push(vector(body + 24 * i));
        mesh.normals.push(vector(body + 24 * i + 12));
    }
    let index = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("four bytes"));
    for i in 0..faces {
        let at = body + 24 * vertices + 13 * i;
        assert_eq!(bytes[at], 3, "triangles only");
        mesh.triangles.push([index(at + 1), index(at + 5), index(at + 9)]);
    }
    mesh
}
