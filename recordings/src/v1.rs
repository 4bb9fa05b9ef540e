//! What stands in our files, version 1. These structs are never edited: a new version stands beside them.

use crate::decision::DecisionText;
use crate::result::estimate::{Light, ResultKeyframe, Segment, WitnessError};
use crate::scan::contents::{CaptureStats, ScanSource};
use crate::shoulder::MAX_STRENGTH;
use crate::types::{CameraModel, ColorEncoding, ColorFrame, Distortion, Intrinsics, Pose, Response, Sensor};
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Intrinsics fx fy cx cy and distortion k1 k2 p1 p2 k3.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct CameraV1 {
    width: u32,
    height: u32,
    intrinsics: [f64; 4],
    distortion: [f64; 5],
}

impl From<&CameraModel> for CameraV1 {
    fn from(camera: &CameraModel) -> Self {
        let (i, d) = (&camera.intrinsics, &camera.distortion);
        Self {
            width: i.width,
            height: i.height,
            intrinsics: [i.fx, i.fy, i.cx, i.cy],
            distortion: [d.k1, d.k2, d.p1, d.p2, d.k3],
        }
    }
}

impl TryFrom<CameraV1> for CameraModel {
    type Error = String;
    fn try_from(c: CameraV1) -> Result<Self, String> {
        let ([fx, fy, cx, cy], [k1, k2, p1, p2, k3]) = (c.intrinsics, c.distortion);
        let camera = Self {
            intrinsics: Intrinsics { width: c.width, height: c.height, fx, fy, cx, cy },
            distortion: Distortion { k1, k2, p1, p2, k3 },
        };
        match camera.problem() {
            Some(problem) => Err(format!("camera: {problem}")),
            None => Ok(camera),
        }
    }
}

/// Quaternion x y z w and translation.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct PoseV1([f64; 7]);

impl From<&Pose> for PoseV1 {
    fn from(p: &Pose) -> Self {
        let ([x, y, z, w], [tx, ty, tz]) = (p.rotation.to_array(), p.translation.to_array());
        Self([x, y, z, w, tx, ty, tz])
    }
}

impl TryFrom<PoseV1> for Pose {
    type Error = String;
    fn try_from(PoseV1([x, y, z, w, tx, ty, tz]): PoseV1) -> Result<Self, String> {
        // As it was written, not normalised again: reading must not change a bit.
        let pose = Self { rotation: DQuat::from_xyzw(x, y, z, w), translation: DVec3::new(tx, ty, tz) };
        if pose.is_finite() && (pose.rotation.length() - 1.0).abs() < 1e-3 {
            Ok(pose)
        } else {
            Err("a pose that is no rigid transform".into())
        }
    }
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) enum ResponseV1 {
    Srgb,
    Linear,
    Gamma(f64),
    Shoulder(f64),
}

impl From<Response> for ResponseV1 {
    fn from(r: Response) -> Self {
        match r {
            Response::Srgb => Self::Srgb,
            Response::Linear => Self::Linear,
            Response::Gamma(gamma) => Self::Gamma(gamma),
            Response::Shoulder(strength) => Self::Shoulder(strength),
        }
    }
}

impl TryFrom<ResponseV1> for Response {
    type Error = String;
    fn try_from(r: ResponseV1) -> Result<Self, String> {
        match r {
            ResponseV1::Srgb => Ok(Self::Srgb),
            ResponseV1::Linear => Ok(Self::Linear),
            ResponseV1::Gamma(gamma) if gamma.is_finite() && gamma > 0.0 => Ok(Self::Gamma(gamma)),
            ResponseV1::Gamma(gamma) => Err(format!("response gamma {gamma}")),
            ResponseV1::Shoulder(strength) if (0.0..=MAX_STRENGTH).contains(&strength) => Ok(Self::Shoulder(strength)),
            ResponseV1::Shoulder(strength) => Err(format!("response shoulder {strength}")),
        }
    }
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct SensorV1 {
    name: String,
    serial: String,
    color: CameraV1,
    depth: CameraV1,
    color_from_depth: PoseV1,
    depth_registered: bool,
    depth_unit_m: f64,
    response: ResponseV1,
    depth_to_color_offset_ns: i64,
}

impl From<&Sensor> for SensorV1 {
    fn from(s: &Sensor) -> Self {
        Self {
            name: s.name.clone(),
            serial: s.serial.clone(),
            color: (&s.color).into(),
            depth: (&s.depth).into(),
            color_from_depth: (&s.color_from_depth).into(),
            depth_registered: s.depth_registered,
            depth_unit_m: s.depth_unit_m,
            response: s.response.into(),
            depth_to_color_offset_ns: s.depth_to_color_offset_ns,
        }
    }
}

impl TryFrom<SensorV1> for Sensor {
    type Error = String;
    fn try_from(s: SensorV1) -> Result<Self, String> {
        if !(s.depth_unit_m.is_finite() && s.depth_unit_m > 0.0) {
            return Err(format!("depth unit {} m", s.depth_unit_m));
        }
        Ok(Self {
            name: s.name,
            serial: s.serial,
            color: s.color.try_into()?,
            depth: s.depth.try_into()?,
            color_from_depth: s.color_from_depth.try_into()?,
            depth_registered: s.depth_registered,
            depth_unit_m: s.depth_unit_m,
            response: s.response.try_into()?,
            depth_to_color_offset_ns: s.depth_to_color_offset_ns,
        })
    }
}

#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) enum EncodingV1 {
    BayerGrbg,
    Rgb,
    Jpeg,
    Png,
}

impl From<ColorEncoding> for EncodingV1 {
    fn from(e: ColorEncoding) -> Self {
        match e {
            ColorEncoding::BayerGrbg => Self::BayerGrbg,
            ColorEncoding::Rgb => Self::Rgb,
            ColorEncoding::Jpeg => Self::Jpeg,
            ColorEncoding::Png => Self::Png,
        }
    }
}

impl From<EncodingV1> for ColorEncoding {
    fn from(e: EncodingV1) -> Self {
        match e {
            EncodingV1::BayerGrbg => Self::BayerGrbg,
            EncodingV1::Rgb => Self::Rgb,
            EncodingV1::Jpeg => Self::Jpeg,
            EncodingV1::Png => Self::Png,
        }
    }
}

/// Before the bytes of a colour frame.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct ColorV1 {
    pub timestamp_ns: i64,
    pub width: u32,
    pub height: u32,
    pub encoding: EncodingV1,
    pub missing_packets: u32,
}

impl From<&ColorFrame> for ColorV1 {
    fn from(c: &ColorFrame) -> Self {
        Self {
            timestamp_ns: c.timestamp_ns,
            width: c.width,
            height: c.height,
            encoding: c.encoding.into(),
            missing_packets: c.missing_packets,
        }
    }
}

impl ColorV1 {
    pub fn with_bytes(self, bytes: &[u8]) -> ColorFrame {
        ColorFrame {
            timestamp_ns: self.timestamp_ns,
            width: self.width,
            height: self.height,
            encoding: self.encoding.into(),
            bytes: bytes.to_vec(),
            missing_packets: self.missing_packets,
        }
    }
}

/// Before the bytes of a depth frame, which has the sensor's size.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct DepthV1 {
    pub timestamp_ns: i64,
    pub missing_packets: u32,
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct AccelerometerV1 {
    pub timestamp_ns: i64,
    pub acceleration: [f32; 3],
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) enum RecordingKindV1 {
    Frames,
    Packets,
}

/// Head of a recording.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct RecordingV1 {
    pub kind: RecordingKindV1,
    pub sensor: SensorV1,
}

/// Before the bytes of a keyframe's or witness's picture.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct KeyframeV1 {
    pub name: String,
    pub world_from_camera: PoseV1,
    pub camera: CameraV1,
    pub color: ColorV1,
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) enum ScanSourceV1 {
    Fusion,
    Photos,
}

impl From<ScanSource> for ScanSourceV1 {
    fn from(s: ScanSource) -> Self {
        match s {
            ScanSource::Fusion => Self::Fusion,
            ScanSource::Photos => Self::Photos,
        }
    }
}

impl From<ScanSourceV1> for ScanSource {
    fn from(s: ScanSourceV1) -> Self {
        match s {
            ScanSourceV1::Fusion => Self::Fusion,
            ScanSourceV1::Photos => Self::Photos,
        }
    }
}

/// Head of a scan.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct ScanV1 {
    pub name: String,
    pub source: ScanSourceV1,
    pub sensor: SensorV1,
    pub config: String,
    pub vertices: u32,
    pub triangles: u32,
    pub keyframes: u32,
    pub witnesses: u32,
}

/// Declares the stored twin of a struct with the same fields.
macro_rules! twin {
    ($v1:ident of $api:ident { $($field:ident: $ty:ty),+ $(,)? }) => {
        #[derive(Debug, Serialize, Deserialize)]
        pub(crate) struct $v1 { $($field: $ty),+ }
        impl From<&$api> for $v1 {
            fn from(x: &$api) -> Self { Self { $($field: x.$field.clone()),+ } }
        }
        impl From<$v1> for $api {
            fn from(x: $v1) -> Self { Self { $($field: x.$field),+ } }
        }
    };
}

twin!(StatsV1 of CaptureStats {
    depth_frames: u64,
    color_frames: u64,
    pairs: u64,
    unpaired_color: u64,
    unpaired_depth: u64,
    incomplete_frames: u64,
    missing_packets: u64,
    dropped_pairs: u64,
    tracked_pairs: u64,
    lost_pairs: u64,
    losses: u64,
    relocalisations: u64,
    coarsenings: u32,
    voxel_size_m: f64,
    blocks_used: u64,
    blocks_total: u64,
    blocks_refused: u64,
    duration_s: f64,
    keyframe_coverage: f64,
});

twin!(SegmentV1 of Segment { vertices: u32, albedo: [f64; 3], w_d: f64, w_s: f64, w_s_error: f64 });
/// Without its cost, which has a chunk of its own.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct DecisionV1 {
    name: String,
    choice: String,
    evidence: String,
    next_level: String,
}

impl From<&DecisionText> for DecisionV1 {
    fn from(d: &DecisionText) -> Self {
        let DecisionText { name, choice, evidence, next_level, .. } = d.clone();
        Self { name, choice, evidence, next_level }
    }
}

impl DecisionV1 {
    pub fn with_cost(self, cost: String) -> DecisionText {
        let Self { name, choice, evidence, next_level } = self;
        DecisionText { name, choice, evidence, cost, next_level }
    }
}

twin!(WitnessErrorV1 of WitnessError { name: String, lit_psnr_db: f64, model_psnr_db: f64, coverage: f64 });
twin!(LightV1 of Light {
    coefficients: Vec<[f64; 3]>,
    standard_deviation: Vec<[f64; 3]>,
    directions: Vec<[f32; 3]>,
    radiance: Vec<[f32; 3]>,
});

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct ResultKeyframeV1 {
    name: String,
    timestamp_ns: i64,
    gain: [f64; 3],
    world_from_camera: PoseV1,
    camera: CameraV1,
    residual_px: f64,
}

impl From<&ResultKeyframe> for ResultKeyframeV1 {
    fn from(k: &ResultKeyframe) -> Self {
        Self {
            name: k.name.clone(),
            timestamp_ns: k.timestamp_ns,
            gain: k.gain,
            world_from_camera: (&k.world_from_camera).into(),
            camera: (&k.camera).into(),
            residual_px: k.residual_px,
        }
    }
}

impl TryFrom<ResultKeyframeV1> for ResultKeyframe {
    type Error = String;
    fn try_from(k: ResultKeyframeV1) -> Result<Self, String> {
        Ok(Self {
            name: k.name,
            timestamp_ns: k.timestamp_ns,
            gain: k.gain,
            world_from_camera: k.world_from_camera.try_into()?,
            camera: k.camera.try_into()?,
            residual_px: k.residual_px,
        })
    }
}

/// Head of a result: everything but the vertices, the triangles and the light.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct EstimateV1 {
    pub name: String,
    pub response: ResponseV1,
    pub segments: Vec<SegmentV1>,
    pub keyframes: Vec<ResultKeyframeV1>,
    pub transfer: String,
    pub decisions: Vec<DecisionV1>,
    pub cuts: Vec<String>,
    pub warnings: Vec<String>,
    pub albedo_scale_rule: String,
    pub witnesses: Vec<WitnessErrorV1>,
}

/// Before the packed vertex arrays of a result.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct VerticesV1 {
    pub vertices: u32,
    /// Corners of the box that the positions are quantised in.
    pub low: [f32; 3],
    pub high: [f32; 3],
    pub has_normals: bool,
    /// Largest lit colour and largest albedo: the scales of their codes.
    pub lit_scale: f32,
    pub albedo_scale: f32,
}
