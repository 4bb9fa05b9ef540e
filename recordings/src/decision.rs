//! What the estimator decided, cut and warns of, as figures. `decision_text` makes sentences of them.
//!
//! These types are stored as postcard, which describes nothing of itself. A variant that was ever written is never edited or
//! moved: a new version stands at the end of its enum.

use crate::local_light::LightModel;
use crate::types::Response;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// Level of the radiance transfer of Eq. (8).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TransferLevel {
    /// Cosine, no visibility.
    Diffuse,
    /// Cosine × visibility.
    Shade,
    /// Cosine × visibility, and interreflections.
    Gi,
}

impl TransferLevel {
    /// The name in files, settings and tables.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Diffuse => "diffuse",
            Self::Shade => "shade",
            Self::Gi => "gi",
        }
    }
}

impl fmt::Display for TransferLevel {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for TransferLevel {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let known = [Self::Diffuse, Self::Shade, Self::Gi].into_iter().find(|level| level.name() == name);
        known.ok_or_else(|| format!("unknown transfer level {name:?}"))
    }
}

/// Exposure model of Eq. (5).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ExposureModel {
    /// All keyframes share one exposure.
    None,
    /// One gain per keyframe.
    Scalar,
    /// One gain per keyframe and channel.
    Rgb,
}

/// A choice that cost or saved time: what was chosen, the evidence, and what the next level up would have brought.
/// Errors are relative unless a unit is named.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Decision {
    /// Sentences of a result that was written before decisions were typed.
    Text(DecisionText),
    /// Camera response: two exposures of one surface differ by one factor if the response is right.
    Response {
        /// The response in the settings, which is used.
        stated: Response,
        /// Values that were compared.
        values: u32,
        /// Minimum ratio of the exposures compared.
        min_exposure_ratio: f64,
        /// Minimum number of points that two keyframes have to share.
        min_shared: u32,
        /// The comparison; `None` without enough values.
        test: Option<ResponseTest>,
    },
    /// Exposure model, by the disagreement (0 to 1) of surface patches that were held out.
    Exposure {
        /// Model used.
        chosen: ExposureModel,
        /// Disagreement without gains.
        none: f64,
        /// Disagreement with one gain per keyframe.
        scalar: f64,
        /// Disagreement with one gain per keyframe and channel.
        rgb: f64,
        /// Patches compared.
        patches: u32,
    },
    /// Pose refinement.
    Pose {
        /// Poses were refined.
        refined: bool,
        /// RMS step of each round, pixels.
        steps_px: Vec<f64>,
        /// Residual of edge pixels before the first round.
        first_residual: f64,
        /// Residual of edge pixels after the last round.
        last_residual: f64,
    },
    /// Bands of the light, by the error on held-out vertices.
    Bands {
        /// SH bands used.
        chosen: u32,
        /// Number of bands and mean relative error on held-out vertices, ascending by bands.
        held_out: Vec<(u32, f64)>,
        /// Condition number of the system with the chosen bands.
        condition: f64,
        /// The next level up, if one was tried.
        next: Option<BandsGain>,
    },
    /// More rays, chosen when gloss was removed from the lit colours.
    RaysWithoutGloss {
        /// Rays per vertex used.
        chosen: u32,
        /// Rays per vertex before.
        before: u32,
        /// Mean relative error on held-out vertices, without gloss.
        held_out: f64,
        /// Relative standard error of the transfer with the rays before.
        error_before: f64,
        /// Relative standard error of the transfer with the rays used.
        error: f64,
        /// Vertices.
        vertices: u32,
    },
    /// Specular weights (Eq. 13), by the mean relative error of the predicted keyframes.
    Specular {
        /// Lit colours were cleaned of gloss, and factorised again.
        cleaned: bool,
        /// Segments fitted.
        segments: u32,
        /// Segments with a significant specular weight.
        glossy: u32,
        /// RMS change of the log gains when exposures came from matte segments alone; `None` where they did not.
        exposure_change: Option<f64>,
        /// Error without gloss; `None` if no segment is glossy.
        without_gloss: Option<f64>,
        /// Error with gloss, after each factorisation.
        with_gloss: Vec<f64>,
    },
    /// More bands, tried when gloss was removed from the lit colours.
    BandsWithoutGloss {
        /// SH bands used.
        chosen: u32,
        /// Bands chosen before gloss was known.
        first: u32,
        /// Bands before this step.
        before: u32,
        /// Bands tried in this step.
        tried: u32,
        /// Mean relative error of the predicted keyframes with the bands before.
        error_before: f64,
        /// The same with the bands tried, after each factorisation.
        errors: Vec<f64>,
    },
    /// Whether the light is distant, by how far position explains residuals at equal normals.
    DistantLight {
        /// The evidence does not contradict distant light.
        holds: bool,
        /// How far position explains the residuals.
        position: PositionEvidence,
        /// Vertices looked at.
        vertices: u32,
    },
    /// How validation frames were predicted, means over the frames.
    Witnesses {
        /// Validation frames.
        frames: u32,
        /// Their poses were refined.
        refined: bool,
        /// PSNR of the lit colours, dB.
        lit_psnr_db: f64,
        /// PSNR of albedo × light (+ specular), dB.
        model_psnr_db: f64,
        /// RMS distance between the tracked and the refined pose, pixels.
        moved_px: f64,
        /// PSNR of the lit colours from the tracked pose, dB.
        tracked_lit_psnr_db: f64,
        /// PSNR of the model from the tracked pose, dB.
        tracked_model_psnr_db: f64,
        /// PSNR of the frame's own colours, brought onto the mesh and back, dB: a bound set by the mesh.
        own_psnr_db: f64,
    },
    /// Level of the transfer.
    Transfer {
        /// Level used.
        chosen: TransferLevel,
        /// Vertices.
        vertices: u32,
        /// Rays per vertex.
        rays: u32,
        /// Share of the rays that hit the scene.
        blocked: f64,
        /// Relative standard error of the coefficients.
        relative_error: f64,
        /// The bounces, if interreflection is modelled.
        bounced: Option<BouncedLight>,
        /// What the next level up would bring.
        next: TransferNext,
    },
    /// Model of the light, by the error on held-out blocks of surface.
    LightModel {
        /// Model used.
        chosen: LightModel,
        /// Models tried, in this order; several of a kind where lamps or pieces were added one by one.
        ladder: Vec<LightRung>,
        /// Vertices compared.
        samples: u32,
    },
    /// The factor per channel that albedo × light leaves free.
    AlbedoScale {
        /// What fixed it.
        chosen: ScaleBasis,
        /// Median irradiance of the seen surface by channel; geometric mean 1.
        irradiance_color: [f64; 3],
        /// Mean albedo of the seen surface by channel; geometric mean 1.
        albedo_color: [f64; 3],
        /// Share of the seen surface that counts as near white.
        near_white: f64,
        /// Share of the seen vertices whose albedo has less luminance than `brightest`.
        quantile: f64,
        /// Luminance of the albedo at that share.
        brightest: f64,
        /// Seen vertices.
        vertices: u32,
    },
    /// Albedo at the resolution of the photographs.
    Texture {
        /// Width of a pixel on the surface that is seen from near, metres.
        footprint_m: f64,
        /// The atlas; `None` where nothing is seen, or its charts fit no page.
        atlas: Option<AtlasFigures>,
        /// How validation frames are predicted with the texture and without it; `None` without frames.
        prediction: Option<TexturePrediction>,
    },
    /// Veiling glare: light that the lens scatters over the picture.
    Veil {
        /// Share of the picture's light that is taken away.
        share: f64,
        /// The share that the darkest observations would be all made of.
        most: f64,
        /// Shares tried, and mean relative error on held-out vertices.
        held_out: Vec<(f64, f64)>,
    },
    /// Segments of like albedo, which are one material.
    Materials {
        /// Segments by their lit colours.
        segments: u32,
        /// Materials.
        materials: u32,
        /// Mean relative error on held-out vertices, one albedo a segment.
        held_out_segments: f64,
        /// The same with one albedo a material.
        held_out: f64,
    },
    /// Whether a near model that explains more than distant light takes its place.
    NearLight {
        /// It does.
        accepted: bool,
        /// Mean relative error of distant light on the means of held-out patches.
        distant: f64,
        /// The same of the near model.
        near: f64,
        /// Share of the former that the latter may be.
        most: f64,
    },
    /// How strongly the channels of the light are drawn to what they have in common.
    LightChroma {
        /// Weight of that prior; 0 = each channel for itself.
        weight: f64,
        /// Weights tried, strongest first, and RMS relative change of the irradiance of held-out vertices.
        held_out: Vec<(f64, f64)>,
    },
    /// What keyframes saw beyond the scan, and the recovered light beside it.
    Background(BackgroundLikeness),
    /// Segments that creases divide, with which light explains more.
    Division {
        /// Segments by their lit colours.
        segments: u32,
        /// Their parts.
        parts: u32,
        /// Mean relative error on held-out blocks of surface, one albedo a segment: of distant light, or of the best near model.
        held_out_segments: f64,
        /// The same with one albedo a part.
        held_out: f64,
    },
    /// Keyframes that show more glare than surface: they tell of no colour.
    Haze {
        /// Keyframe, and the share of its light that is glare: median over the surface that it shows.
        glare: Vec<(u32, f64)>,
    },
    /// How much less light the lens brings to the corners of the pictures than to their middle.
    Vignetting {
        /// v: exp(−v) is left in the corners.
        strength: f64,
        /// Share of the patches' weight that exposures from the other half do not explain, with even pictures.
        without: f64,
        /// The same with the vignetting that the other half tells.
        with: f64,
        /// Patches compared.
        patches: u32,
    },
    /// How far the camera compresses what is bright.
    Shoulder {
        /// Strength a of the [`shoulder`](crate::shoulder).
        strength: f64,
        /// Share of the patches' weight that exposures from the other half do not explain, without one.
        without: f64,
        /// The same with that which the other half tells.
        with: f64,
        /// Patches compared.
        patches: u32,
    },
}

/// How the distant light correlates with what half of the keyframes saw beyond the scan. No step uses that; of what the other half
/// saw, directions that surfaces do not tell are filled.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BackgroundLikeness {
    /// Weight of the other half in the light; 0 = none, and where nothing was seen.
    pub weight: f64,
    /// Weights tried, strongest first, and RMS relative change of the irradiance of held-out vertices.
    pub held_out: Vec<(f64, f64)>,
    /// Keyframes of the half that is compared which saw something beyond the scan.
    pub keyframes: u32,
    /// Directions that they saw.
    pub directions: u32,
    /// Correlation of the luminances; `None` where too few directions were seen, or one side is even.
    pub correlation: Option<f64>,
}

/// What fixed the scale of the albedo.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ScaleBasis {
    /// What is likely of cameras, light and surfaces.
    Likely,
    /// The secondary light as it was observed.
    SecondaryLight,
    /// A surface whose albedo the user stated.
    Reference {
        /// Its albedo, linear RGB.
        albedo: [f64; 3],
    },
}

/// Lit colours rendered into validation frames, means over the frames.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TexturePrediction {
    /// PSNR with the colours of the vertices, dB.
    pub vertices_psnr_db: f64,
    /// PSNR with the texture, dB.
    pub psnr_db: f64,
    /// Energy of the rendering's upper octave over that of the frame, with the colours of the vertices.
    pub vertices_sharpness: f64,
    /// The same with the texture.
    pub sharpness: f64,
}

/// Size of a texture atlas.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AtlasFigures {
    /// Texels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Width of a texel on the surface, metres.
    pub texel_m: f64,
    /// Charts.
    pub charts: u32,
    /// Texels on the surface.
    pub texels: u32,
    /// Share of them that a keyframe shows.
    pub seen: f64,
}

/// A model of the light that was tried.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LightRung {
    /// Model.
    pub model: LightModel,
    /// Mean relative error on held-out blocks of surface: on all of them, each fold held out once, for distant light, none, a sun and the best near
    /// model; on one fold for near models on the way to that.
    pub held_out: f64,
}

/// Change of the exposure factor from dark to bright values, relative, under two responses.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ResponseTest {
    /// The response compared with. A gamma stands for all powers: they pass the test alike.
    pub alternative: Response,
    /// Change with the stated response.
    pub stated_change: f64,
    /// Change with the alternative.
    pub alternative_change: f64,
}

/// Gain of a level of bands over the one below.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BandsGain {
    /// SH bands of the higher level.
    pub bands: u32,
    /// Mean decrease of the held-out error.
    pub gain: f64,
    /// Standard error of the gain.
    pub standard_error: f64,
}

/// Interreflected light.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BouncedLight {
    /// Bounces.
    pub bounces: u32,
    /// Share of all bounces in the light.
    pub share: f64,
    /// Share of the last bounce in the light.
    pub last_share: f64,
}

/// What the next level of the transfer would bring.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TransferNext {
    /// Visibility: less than the error of the colours.
    Visibility,
    /// One bounce between mid-grey surfaces.
    GreyBounce {
        /// Its share of the light.
        share: f64,
    },
    /// Twice the rays.
    TwiceRays {
        /// Expected relative standard error.
        relative_error: f64,
    },
}

/// How far position explains residuals at equal normals.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PositionEvidence {
    /// Share of the residual variance on held-out vertices.
    pub explained: f64,
    /// Relative change of the light with position (standard deviation).
    pub change: f64,
}

/// Something that was left out to keep the time budget.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Cut {
    /// A sentence of a result that was written before cuts were typed.
    Text(String),
    /// Planned ahead, for a machine of a measured speed.
    Planned {
        /// What was reduced.
        what: Reduction,
        /// Speed of this machine relative to the reference machine.
        speed: f64,
    },
    /// Fewer rays per vertex than the evidence asked for.
    FewerRays {
        /// Rays per vertex.
        rays: u32,
        /// Rays asked for.
        instead_of: u32,
    },
    /// Rays that were not traced in time, and fewer in their place.
    LateRays {
        /// Rays per vertex.
        rays: u32,
        /// Rays that were late.
        instead_of: u32,
    },
    /// Gloss was not looked for.
    Specular,
    /// Validation frames that were not predicted.
    Witnesses {
        /// Frames predicted.
        predicted: u32,
        /// Validation frames of the scan.
        of: u32,
    },
    /// A stage that was abandoned half-way: transfer, with this many rays per vertex.
    AbandonedTransfer {
        /// Rays per vertex.
        rays: u32,
    },
    /// Lamps and emitting surfaces were not looked for.
    LocalLight,
    /// No texture was made.
    Texture,
    /// Glare was not looked for, nor segments joined by their albedo.
    Materials,
    /// The budget ended, and the first answer is the result.
    FirstAnswer {
        /// Vertices that it was made from.
        vertices: u32,
        /// Keyframes that it was made from.
        keyframes: u32,
    },
    /// The budget ended before the stages that follow this one.
    EndOfBudget {
        /// The last stage of the result.
        after: Milestone,
    },
    /// Reduced for the memory that the run may use.
    Memory {
        /// What was reduced.
        what: Reduction,
        /// Megabytes that the run may use.
        limit_mb: u32,
    },
}

/// A stage after which a result stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Milestone {
    /// Light and albedo.
    Albedo,
    /// Gloss.
    Gloss,
}

impl Cut {
    /// True for a stage that was abandoned half-way: not planned, so the run failed to keep its plan.
    #[must_use]
    pub fn is_abandoned(&self) -> bool {
        matches!(self, Self::AbandonedTransfer { .. })
    }
}

/// A level that was reduced.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reduction {
    /// Bounces.
    Bounces {
        /// Bounces kept.
        to: u32,
        /// Bounces asked for; `None` = until converged.
        from: Option<u32>,
    },
    /// Rays per vertex.
    Rays {
        /// Rays kept.
        to: u32,
        /// Rays asked for.
        from: u32,
    },
    /// Rounds of pose refinement.
    PoseRounds {
        /// Rounds kept.
        to: u32,
        /// Rounds asked for.
        from: u32,
    },
    /// Gloss is not looked for.
    Specular,
    /// Maximum number of SH bands.
    Bands {
        /// Bands kept.
        to: u32,
        /// Bands asked for.
        from: u32,
    },
    /// Keyframes.
    Keyframes {
        /// Every `stride`-th keyframe is used.
        stride: u32,
        /// Keyframes of the scan.
        of: u32,
    },
    /// Vertices.
    Vertices {
        /// About this many are kept.
        to: u32,
        /// Vertices asked for.
        from: u32,
    },
    /// No texture.
    Texture,
}

impl Reduction {
    /// True if the scan itself was reduced: that is final once the mesh is made.
    #[must_use]
    pub fn is_of_scan(&self) -> bool {
        matches!(self, Self::Keyframes { .. } | Self::Vertices { .. })
    }
}

/// A fact that limits how far the result can be trusted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Warning {
    /// A sentence of a result that was written before warnings were typed.
    Text(String),
    /// Another camera response fits the pictures better than the stated one.
    ResponseMismatch {
        /// Response in the settings.
        stated: Response,
        /// The one that fits; a gamma stands for all powers.
        better: Response,
    },
    /// Residuals depend on position at equal normals: the light is near.
    LightNotDistant(PositionEvidence),
    /// One keyframe: no exposure, pose or gloss.
    OneKeyframe,
    /// The surfaces do not determine most of the light.
    UnseenLight {
        /// Undetermined directions of the linear band, of 3.
        directions: u32,
    },
}

/// A decision as sentences: `inspect --json`, `manifest.json`, preview and viewer.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct DecisionText {
    /// What was decided ("bands", "transfer", "exposure" …).
    pub name: String,
    /// What was chosen.
    pub choice: String,
    /// The evidence, with figures.
    pub evidence: String,
    /// What the choice cost, in counts of work; empty in results of older programs.
    pub cost: String,
    /// What the next level up would have brought.
    pub next_level: String,
}
