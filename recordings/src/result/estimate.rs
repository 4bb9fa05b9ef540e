//! What a result holds.

use crate::decision::{Cut, Decision, TransferLevel, Warning};
use crate::local_light::LocalLight;
use crate::result::texture::Texture;
use crate::scan::contents::check_mesh;
use crate::types::{CameraModel, Mesh, Pose, Response, TimestampNs};
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// Rows of coefficients at nine bands.
const MAX_COEFFICIENTS: usize = 81;

/// Distant light as real orthonormal spherical harmonics (no Condon–Shortley phase, index `l*(l+1)+m`, world axes):
/// radiance towards the surface from direction ω is `Σ_k coefficients[k] Y_k(ω)`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Light {
    /// Coefficients, linear RGB: `[k][channel]`, bands² rows.
    pub coefficients: Vec<[f64; 3]>,
    /// Posterior standard deviation of the coefficients, same shape.
    pub standard_deviation: Vec<[f64; 3]>,
    /// Unit directions of `radiance`, world frame: `[direction]`.
    pub directions: Vec<[f32; 3]>,
    /// The non-negative radiance that was projected to the coefficients, linear RGB, 4π/n steradians each: `[direction]`.
    pub radiance: Vec<[f32; 3]>,
}

impl Light {
    /// Number of SH bands, l_max + 1; 0 without light.
    #[must_use]
    pub fn bands(&self) -> u32 {
        (self.coefficients.len() as f64).sqrt().round() as u32
    }
}

/// Material of a segment (Eqs. 11 and 13).
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
    /// Standard error of `w_s`; infinite where the data do not determine it.
    pub w_s_error: f64,
}

/// A keyframe with its estimated exposure and pose.
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

/// Prediction error of a validation frame: one that no estimation step used.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WitnessError {
    /// Name of the frame.
    pub name: String,
    /// PSNR in dB of the lit colours re-rendered into its view (8-bit sRGB, after exposure).
    pub lit_psnr_db: f64,
    /// The same for albedo × light (+ specular).
    pub model_psnr_db: f64,
    /// Share of the frame's pixels that the mesh covers.
    pub coverage: f64,
}

/// Result of the estimator. Arrays `[vertex]` are as long as `mesh.positions`.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Name of the scan.
    pub name: String,
    /// Response of the camera the colours were linearised with.
    pub response: Response,
    /// The regularised mesh, normals filled.
    pub mesh: Mesh,
    /// Index into `segments`: `[vertex]`.
    pub segment: Vec<u32>,
    /// Lit colour f, linear RGB, view-independent part: `[vertex]`.
    pub lit_color: Vec<Vec3>,
    /// Diffuse albedo, linear RGB: `[vertex]`.
    pub albedo: Vec<Vec3>,
    /// Confidence in the albedo, 0 (never seen, or unlit) to 1: `[vertex]`.
    pub confidence: Vec<f32>,
    /// The light.
    pub light: Light,
    /// Segments.
    pub segments: Vec<Segment>,
    /// Keyframes, order as in the scan.
    pub keyframes: Vec<ResultKeyframe>,
    /// Transfer level used.
    pub transfer: TransferLevel,
    /// What was decided, and why.
    pub decisions: Vec<Decision>,
    /// What was cut for the budget; empty if nothing.
    pub cuts: Vec<Cut>,
    /// What limits the trust in this result.
    pub warnings: Vec<Warning>,
    /// The rule that fixed the free albedo × light factor.
    pub albedo_scale_rule: String,
    /// Prediction errors of the validation frames.
    pub witnesses: Vec<WitnessError>,
    /// Lamps and emission, and the model of light that was chosen.
    pub local_light: LocalLight,
    /// Albedo at the resolution of the photographs; `None` where it was not made.
    pub texture: Option<Texture>,
}

impl Estimate {
    /// Checks indices, array lengths and numbers.
    ///
    /// # Errors
    /// The first violation.
    pub(crate) fn check(&self) -> std::result::Result<(), String> {
        check_mesh(&self.mesh)?;
        let n = self.mesh.positions.len();
        if [self.segment.len(), self.lit_color.len(), self.albedo.len(), self.confidence.len()] != [n; 4] {
            return Err(format!("vertex arrays are not as long as the {n} positions"));
        }
        if self.segment.iter().any(|s| *s as usize >= self.segments.len()) {
            return Err("a vertex in a segment that does not exist".into());
        }
        let colors = self.lit_color.iter().chain(&self.albedo).all(|c| c.is_finite());
        if !colors || !self.confidence.iter().all(|c| c.is_finite()) {
            return Err("a colour or confidence that is not finite".into());
        }
        self.light.check()?;
        self.local_light.check(n)?;
        if let Some(texture) = &self.texture {
            texture.check(self.mesh.triangles.len())?;
        }
        for (index, s) in self.segments.iter().enumerate() {
            let numbers = [s.albedo[0], s.albedo[1], s.albedo[2], s.w_d, s.w_s];
            if !numbers.iter().all(|x| x.is_finite()) || s.w_s_error.is_nan() {
                return Err(format!("segment {index} holds NaN or infinity"));
            }
        }
        for k in &self.keyframes {
            let sound = k.world_from_camera.is_finite() && k.residual_px.is_finite() && k.camera.problem().is_none();
            if !sound || !k.gain.iter().all(|g| g.is_finite() && *g > 0.0) {
                return Err(format!("keyframe {} holds numbers that make no sense", k.name));
            }
        }
        let nan = |w: &WitnessError| w.lit_psnr_db.is_nan() || w.model_psnr_db.is_nan() || w.coverage.is_nan();
        if self.witnesses.iter().any(nan) {
            return Err("a witness error is NaN".into());
        }
        Ok(())
    }
}

impl Light {
    fn check(&self) -> std::result::Result<(), String> {
        let rows = self.coefficients.len();
        let bands = self.bands() as usize;
        if rows > MAX_COEFFICIENTS || bands * bands != rows {
            return Err(format!("{rows} light coefficients are no whole number of bands up to nine"));
        }
        if self.standard_deviation.len() != rows || self.directions.len() != self.radiance.len() {
            return Err("parts of the light differ in length".into());
        }
        let finite = self.coefficients.iter().flatten().all(|x| x.is_finite())
            && self.directions.iter().chain(&self.radiance).flatten().all(|x| x.is_finite());
        if !finite || self.standard_deviation.iter().flatten().any(|x| x.is_nan()) {
            return Err("the light holds NaN or infinity".into());
        }
        Ok(())
    }
}
