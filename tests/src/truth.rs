//! Scenes whose light and materials are known.

use recordings::import::npy::Array;
use recordings::ply::read::read_ply;
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
        let read = |file: &str| Array::read(&truth.join(file)).expect("an array");
        let whole = |file: &str| read(file).data.iter().map(|x| *x as u32).collect();
        let materials = json(&truth.join("materials.json"));
        Self {
            name: name.into(),
            mesh: read_ply(&folder.join("mesh.ply")).expect("a mesh"),
            albedo: read("albedo.npy").rgb(),
            lit_color: read("lit_color.npy").rgb(),
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
        let read = |file: &str| Array::read(&folder.join(file)).expect("an array").data;
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
