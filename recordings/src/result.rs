//! Results (`.lres`): what the estimator found.

use crate::error::Result;
use crate::types::{CameraModel, Mesh, Pose, Response, TimestampNs};
use glam::Vec3;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Distant light as real orthonormal spherical harmonics (no Condon–Shortley phase, index `l*(l+1)+m`, world axes):
/// radiance towards the surface from direction ω is `Σ_k coefficients[k] Y_k(ω)`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Light {
    /// `bands²` rows of RGB coefficients.
    pub coefficients: Vec<[f64; 3]>,
    /// Posterior standard deviation of each coefficient, same shape.
    pub standard_deviation: Vec<[f64; 3]>,
    /// The non-negative radiance the coefficients were projected from, if kept: unit directions …
    pub directions: Vec<[f32; 3]>,
    /// … and their RGB radiance (each direction stands for 4π/n steradians).
    pub radiance: Vec<[f32; 3]>,
}

impl Light {
    /// l_max + 1; 0 where there is no light.
    #[must_use]
    pub fn bands(&self) -> u32 {
        (self.coefficients.len() as f64).sqrt().round() as u32
    }
}

/// What a segment is made of (Eqs. 11 and 13).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Segment {
    /// Vertices in the segment.
    pub vertices: u32,
    /// Mean diffuse albedo, linear RGB.
    pub albedo: [f64; 3],
    /// Diffuse weight of Eq. (13).
    pub w_d: f64,
    /// Specular weight of Eq. (13).
    pub w_s: f64,
    /// Standard error of `w_s`; infinite where it could not be told.
    pub w_s_error: f64,
}

/// A keyframe as the estimator leaves it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ResultKeyframe {
    /// Name as in the scan.
    pub name: String,
    /// Time of the colour frame.
    pub timestamp_ns: TimestampNs,
    /// Exposure gain g_j = 1/e_j per channel: picture = gain · radiance. Geometric mean 1 over keyframes and channels.
    pub gain: [f64; 3],
    /// Refined camera-to-world pose.
    pub world_from_camera: Pose,
    /// Camera.
    pub camera: CameraModel,
    /// Pose error left, in pixels (RMS of the last Lucas–Kanade step); NaN-free, 0 where not refined.
    pub residual_px: f64,
}

/// A choice that cost or saved time, with its evidence.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Decision {
    /// What was decided ("bands", "transfer", "exposure" …).
    pub name: String,
    /// What was chosen.
    pub choice: String,
    /// The evidence, with figures.
    pub evidence: String,
    /// What the next level up would have brought.
    pub next_level: String,
}

/// How well a frame that no estimation step used is predicted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WitnessError {
    /// Name of the witness frame.
    pub name: String,
    /// PSNR in dB of the lit colours re-rendered into its view (8-bit sRGB, after exposure).
    pub lit_psnr_db: f64,
    /// The same for albedo × light (+ specular).
    pub model_psnr_db: f64,
    /// Share of the frame's pixels that the mesh covers.
    pub coverage: f64,
}

/// The estimator's answer. Vertex arrays are as long as `mesh.positions`.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Name of the scan.
    pub name: String,
    /// Response of the camera the colours were linearised with.
    pub response: Response,
    /// The regularised mesh, normals filled.
    pub mesh: Mesh,
    /// Segment index of every vertex, into `segments`.
    pub segment: Vec<u32>,
    /// Lit colour f, linear RGB, view-independent part.
    pub lit_color: Vec<Vec3>,
    /// Diffuse albedo, linear RGB.
    pub albedo: Vec<Vec3>,
    /// Confidence in the albedo, 0 (never seen, or unlit) to 1.
    pub confidence: Vec<f32>,
    /// The light.
    pub light: Light,
    /// Segments.
    pub segments: Vec<Segment>,
    /// Keyframes, order as in the scan.
    pub keyframes: Vec<ResultKeyframe>,
    /// Transfer level used: "diffuse", "shade" or "gi".
    pub transfer: String,
    /// What was decided, and why.
    pub decisions: Vec<Decision>,
    /// What was cut for the budget; empty if nothing.
    pub cuts: Vec<String>,
    /// Things the user should know ("light_not_distant: …", "one keyframe: …").
    pub warnings: Vec<String>,
    /// The rule that fixed the free albedo × light factor.
    pub albedo_scale_rule: String,
    /// Prediction error on the witness frames.
    pub witnesses: Vec<WitnessError>,
}

impl Estimate {
    /// Reads a result file.
    ///
    /// # Errors
    /// Unreadable, damaged, no result, or of a newer version.
    pub fn read(_path: &Path) -> Result<Self> {
        unimplemented!()
    }
    /// Writes a result file, quantised (by fsync and rename).
    ///
    /// # Errors
    /// The disk is full or gone.
    pub fn write(&self, _path: &Path) -> Result<()> {
        unimplemented!()
    }
}
