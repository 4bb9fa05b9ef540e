//! The types that cross crate borders: sensors, frames, poses, meshes.
//!
//! Frames of reference: right-handed world in metres, +Z up where gravity is known. Camera frame: +X right, +Y down,
//! +Z forward (OpenCV); pixel centres stand at integer coordinates, so `u = fx X/Z + cx`.

use bytemuck::{Pod, Zeroable};
use glam::{DMat3, DMat4, DQuat, DVec3, Vec3};
use serde::{Deserialize, Serialize};

/// Nanoseconds on the recording's own clock. Integers, so that a time stamp read is the time stamp written.
pub type TimestampNs = i64;

/// Pinhole intrinsics in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Focal length along x in pixels.
    pub fx: f64,
    /// Focal length along y in pixels.
    pub fy: f64,
    /// Principal point, x, in pixels.
    pub cx: f64,
    /// Principal point, y, in pixels.
    pub cy: f64,
}

/// Radial-tangential (Brown–Conrady) distortion, OpenCV's k1 k2 p1 p2 k3; all zero = none.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Distortion {
    /// Radial, r².
    pub k1: f64,
    /// Radial, r⁴.
    pub k2: f64,
    /// Tangential.
    pub p1: f64,
    /// Tangential.
    pub p2: f64,
    /// Radial, r⁶.
    pub k3: f64,
}

/// A camera: intrinsics and distortion.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CameraModel {
    /// Pinhole part.
    pub intrinsics: Intrinsics,
    /// Lens distortion.
    pub distortion: Distortion,
}

/// How the camera turns linear light (0..1) into its 8-bit values.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub enum Response {
    /// IEC 61966-2-1.
    #[default]
    Srgb,
    /// Proportional.
    Linear,
    /// value = light^(1/gamma).
    Gamma(f64),
    /// sRGB with a [`shoulder`](crate::shoulder) of this strength.
    Shoulder(f64),
}

/// What stands in the header of every recording and scan about the sensor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sensor {
    /// Model name, free text ("Kinect V1 (1414)", "TUM RGB-D folder").
    pub name: String,
    /// Serial number, empty where unknown.
    pub serial: String,
    /// Colour camera.
    pub color: CameraModel,
    /// Depth camera. Where depth is registered to colour this is the colour camera.
    pub depth: CameraModel,
    /// Transform from the depth to the colour camera; identity where depth is registered to colour.
    pub color_from_depth: Pose,
    /// True if depth pixels are already those of the colour camera as it comes, lens distortion included.
    pub depth_registered: bool,
    /// Metres per depth unit (0.001 for millimetres, 0.0002 for TUM's 5000 per metre).
    pub depth_unit_m: f64,
    /// Colour response.
    pub response: Response,
    /// Depth stamp + this = the colour clock's time of the same instant, in nanoseconds.
    pub depth_to_color_offset_ns: i64,
}

/// A rigid transform x ↦ R x + t in f64; poses are named `a_from_b` and map b's coordinates to a's.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Unit quaternion (x, y, z, w).
    pub rotation: DQuat,
    /// Translation in metres.
    pub translation: DVec3,
}

impl Default for Pose {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Pose {
    /// The identity.
    pub const IDENTITY: Self = Self { rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// From rotation and translation; the rotation is normalised.
    #[must_use]
    pub fn new(rotation: DQuat, translation: DVec3) -> Self {
        Self { rotation: rotation.normalize(), translation }
    }

    /// The rigid motion by a rotation vector (axis times angle, radians) and a translation (metres): exact in the rotation;
    /// the coupling of the translation with the rotation is left out, which is of second order in the motion.
    #[must_use]
    pub fn exp(rotation: DVec3, translation: DVec3) -> Self {
        Self::new(DQuat::from_scaled_axis(rotation), translation)
    }

    /// Rotation vector (radians, at most π long) and translation: the inverse of [`Pose::exp`].
    #[must_use]
    pub fn log(&self) -> (DVec3, DVec3) {
        let q = if self.rotation.w < 0.0 { -self.rotation } else { self.rotation };
        (q.to_scaled_axis(), self.translation)
    }

    /// From a row-major 4×4 matrix. `None` if it holds NaN or infinity or is no proper rotation (within 1e-3).
    #[must_use]
    pub fn from_rows(rows: &[[f64; 4]; 4]) -> Option<Self> {
        if rows.iter().flatten().any(|x| !x.is_finite()) {
            return None;
        }
        let m = DMat3::from_cols(
            DVec3::new(rows[0][0], rows[1][0], rows[2][0]),
            DVec3::new(rows[0][1], rows[1][1], rows[2][1]),
            DVec3::new(rows[0][2], rows[1][2], rows[2][2]),
        );
        let error = m.transpose() * m - DMat3::IDENTITY;
        if error.to_cols_array().iter().any(|e| e.abs() > 1e-3) || m.determinant() < 0.0 {
            return None;
        }
        Some(Self::new(DQuat::from_mat3(&m), DVec3::new(rows[0][3], rows[1][3], rows[2][3])))
    }

    /// Row-major 4×4 matrix.
    #[must_use]
    pub fn to_rows(&self) -> [[f64; 4]; 4] {
        let c = DMat4::from_rotation_translation(self.rotation, self.translation).to_cols_array_2d();
        std::array::from_fn(|r| std::array::from_fn(|k| c[k][r]))
    }

    /// The inverse transform.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let r = self.rotation.conjugate();
        Self { rotation: r, translation: -(r * self.translation) }
    }

    /// `a_from_b.compose(b_from_c)` = `a_from_c`.
    #[must_use]
    pub fn compose(&self, other: &Self) -> Self {
        Self::new(self.rotation * other.rotation, self.rotation * other.translation + self.translation)
    }

    /// Transforms a point.
    #[must_use]
    pub fn transform(&self, p: DVec3) -> DVec3 {
        self.rotation * p + self.translation
    }

    /// True if every component is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.rotation.is_finite() && self.translation.is_finite()
    }
}

/// A depth image; row-major, `width * height` values in the sensor's `depth_unit_m`, 0 = no value.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct DepthFrame {
    /// Time of the frame on the depth clock.
    pub timestamp_ns: TimestampNs,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Depth values.
    pub depth: Vec<u16>,
    /// USB packets that were lost in this frame; > 0 marks it incomplete.
    pub missing_packets: u32,
}

/// How the bytes of a colour frame are to be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum ColorEncoding {
    /// 8-bit Bayer mosaic, first row G R G R, second B G B G (the Kinect's).
    BayerGrbg,
    /// 8-bit RGB, interleaved.
    Rgb,
    /// A JPEG file.
    Jpeg,
    /// A PNG file.
    Png,
}

/// A colour image as it came from the sensor or the file.
#[derive(Debug, Clone, PartialEq)]
pub struct ColorFrame {
    /// Time of the frame on the colour clock.
    pub timestamp_ns: TimestampNs,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Encoding of `bytes`.
    pub encoding: ColorEncoding,
    /// The encoded image.
    pub bytes: Vec<u8>,
    /// USB packets that were lost in this frame; > 0 marks it incomplete.
    pub missing_packets: u32,
}

/// Unit vertex normals `[vertex]`: the mean of the adjacent triangles' normals by area; +Z where there is none.
#[must_use]
pub fn vertex_normals(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut sums = vec![DVec3::ZERO; positions.len()];
    for t in triangles {
        let [a, b, c] = t.map(|i| positions[i as usize].as_dvec3());
        let normal = (b - a).cross(c - a);
        t.iter().for_each(|i| sums[*i as usize] += normal);
    }
    sums.into_iter().map(|n| n.normalize_or(DVec3::Z).as_vec3()).collect()
}

/// A decoded 8-bit RGB image, interleaved, row-major.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct RgbImage {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `3 * width * height` bytes.
    pub data: Vec<u8>,
}

/// One accelerometer reading in m/s², camera axes; at rest it points up (against gravity).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Accelerometer {
    /// Time on the depth clock.
    pub timestamp_ns: TimestampNs,
    /// Specific force.
    pub acceleration: [f32; 3],
}

/// One isochronous USB packet, as it came.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UsbPacket {
    /// Host time of arrival.
    pub timestamp_ns: TimestampNs,
    /// Endpoint address (0x81 video, 0x82 depth).
    pub endpoint: u8,
    /// Payload, at most 3072 bytes.
    pub data: Vec<u8>,
}

/// A colour frame and the depth frame nearest to it in time, decoded.
#[derive(Debug, Clone)]
pub struct RgbdFrame {
    /// Depth.
    pub depth: DepthFrame,
    /// Colour as it came (for keyframes).
    pub color: ColorFrame,
    /// The same, decoded.
    pub rgb: RgbImage,
}

/// An indexed triangle mesh. `normals` are unit and as many as `positions` (or empty where not yet computed).
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Mesh {
    /// Vertex positions in metres.
    pub positions: Vec<Vec3>,
    /// Unit vertex normals.
    pub normals: Vec<Vec3>,
    /// Vertex indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

/// A frame that is kept with its pose: a keyframe, or a witness.
#[derive(Debug, Clone, PartialEq)]
pub struct Keyframe {
    /// Name as imported ("keyframes/000.png"), or made from the time stamp.
    pub name: String,
    /// Camera-to-world pose as the tracker or the importer gives it.
    pub world_from_camera: Pose,
    /// The camera that took it.
    pub camera: CameraModel,
    /// The picture.
    pub color: ColorFrame,
}

/// The 12 bytes of a vertex position, for raw arrays on disk.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub struct RawVec3(pub [f32; 3]);
