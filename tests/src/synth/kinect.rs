//! The whole sensor: what a Kinect V1 would have recorded of a scene.

use super::color_sensor::{AutoExposure, ColorSensor, Gain};
use super::depth_sensor::DepthSensor;
use super::glare::Glare;
use super::random::Rng;
use super::render::{self, Exposure, Shading};
use super::scene::Scene;
use glam::DVec3;
use recordings::types::{
    Accelerometer, CameraModel, ColorEncoding, ColorFrame, DepthFrame, Distortion, Intrinsics, Pose, Response,
    RgbImage, RgbdFrame, Sensor, TimestampNs,
};

/// Colour, depth and accelerometer on one bar.
#[derive(Debug, Clone)]
pub struct Kinect {
    /// Both cameras: depth is registered to colour.
    pub camera: Intrinsics,
    /// Colour camera.
    pub color: ColorSensor,
    /// Depth camera.
    pub depth: DepthSensor,
    /// Time between frames in nanoseconds.
    pub period_ns: TimestampNs,
    /// The depth frame is taken this much later than the colour frame.
    pub depth_delay_ns: TimestampNs,
    /// How long the colour shutter is open, in seconds.
    pub shutter_s: f64,
    /// Time from the first row's exposure to the last row's, in seconds: 0 for a global shutter.
    pub readout_s: f64,
    /// Light that the lens scatters, if any.
    pub glare: Option<Glare>,
    /// Rays per colour pixel.
    pub samples: usize,
    /// Seed of all noise.
    pub seed: u64,
    /// Threads; the frames are the same for any number.
    pub threads: usize,
    exposure: AutoExposure,
}

/// Time stamp of the first colour frame: a clock that was running before.
const START_NS: TimestampNs = 1_000_000_000;

/// One frame and its truth.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Time of the middle of the colour exposure.
    pub color_timestamp_ns: TimestampNs,
    /// Colour.
    pub rgb: RgbImage,
    /// Depth, with its own time stamp.
    pub depth: DepthFrame,
    /// Specific force, at the depth frame's time.
    pub accelerometer: Accelerometer,
    /// True pose at the colour frame's time.
    pub world_from_camera: Pose,
    /// True gain of the colour frame.
    pub gain: Gain,
}

impl Frame {
    /// The frame as fusion takes it, colour uncompressed.
    #[must_use]
    pub fn into_rgbd(self) -> RgbdFrame {
        let color = ColorFrame {
            timestamp_ns: self.color_timestamp_ns,
            width: self.rgb.width,
            height: self.rgb.height,
            encoding: ColorEncoding::Rgb,
            bytes: self.rgb.data.clone(),
            missing_packets: 0,
        };
        RgbdFrame { depth: self.depth, color, rgb: self.rgb }
    }
}

impl Kinect {
    /// A Kinect V1 whose images are `1/divide` of 640×480 in each direction.
    #[must_use]
    pub fn new(divide: u32, seed: u64, threads: usize) -> Self {
        let divide = divide.max(1);
        let by = f64::from(divide);
        let camera = Intrinsics {
            width: 640 / divide,
            height: 480 / divide,
            fx: 525.0 / by,
            fy: 525.0 / by,
            cx: 320.0 / by - 0.5,
            cy: 240.0 / by - 0.5,
        };
        Self {
            camera,
            color: ColorSensor::default(),
            depth: DepthSensor::default(),
            period_ns: 66_666_667,
            depth_delay_ns: 4_000_000,
            shutter_s: 0.004,
            readout_s: 0.0,
            glare: None,
            samples: 16,
            seed,
            threads,
            exposure: AutoExposure::default(),
        }
    }

    /// The recording header that goes with the frames.
    #[must_use]
    pub fn sensor(&self) -> Sensor {
        let camera = CameraModel { intrinsics: self.camera, distortion: Distortion::default() };
        Sensor {
            name: "synthetic Kinect V1".into(),
            serial: String::new(),
            color: camera,
            depth: camera,
            color_from_depth: Pose::IDENTITY,
            depth_registered: true,
            depth_unit_m: self.depth.unit_m,
            response: Response::Srgb,
            depth_to_color_offset_ns: 0,
        }
    }

    /// Takes frame `index`; call in order, for the exposure follows the frames before. `pose(seconds)` is the path, from
    /// the first frame on.
    pub fn frame(&mut self, scene: &Scene, shading: Shading, index: u32, pose: &dyn Fn(f64) -> Pose) -> Frame {
        let seed = Rng::family(self.seed, u64::from(index));
        let since_start_ns = TimestampNs::from(index) * self.period_ns;
        let (color_timestamp_ns, time_s) = (START_NS + since_start_ns, since_start_ns as f64 * 1e-9);
        let depth_timestamp_ns = color_timestamp_ns + self.depth_delay_ns;
        let depth_pose = pose(time_s + self.depth_delay_ns as f64 * 1e-9);
        let mut rng = Rng::new(seed, u64::MAX);
        let (rgb, gain) = self.picture(scene, shading, seed, time_s, pose, &mut rng);
        let depth = self.depth.frame(scene, &self.camera, &depth_pose, depth_timestamp_ns, seed ^ 2, self.threads);
        let up = depth_pose.rotation.conjugate() * DVec3::new(0.0, 0.0, 9.81);
        let acceleration = up.as_vec3().to_array().map(|a| a + 0.05 * rng.normal());
        let accelerometer = Accelerometer { timestamp_ns: depth_timestamp_ns, acceleration };
        Frame { color_timestamp_ns, rgb, depth, accelerometer, world_from_camera: pose(time_s), gain }
    }

    /// Takes a picture alone, at `time_s`; call in order, for the exposure follows the pictures before.
    pub fn photo(
        &mut self,
        scene: &Scene,
        shading: Shading,
        index: u32,
        time_s: f64,
        pose: &dyn Fn(f64) -> Pose,
    ) -> (RgbImage, Gain) {
        let seed = Rng::family(self.seed, u64::from(index));
        self.picture(scene, shading, seed, time_s, pose, &mut Rng::new(seed, u64::MAX))
    }

    fn picture(
        &mut self,
        scene: &Scene,
        shading: Shading,
        seed: u64,
        time_s: f64,
        pose: &dyn Fn(f64) -> Pose,
        rng: &mut Rng,
    ) -> (RgbImage, Gain) {
        let whole_s = self.shutter_s + self.readout_s;
        let shutter = [pose(time_s - 0.5 * whole_s), pose(time_s + 0.5 * whole_s)];
        let rolling = (self.readout_s / whole_s) as f32;
        let exposure = Exposure { shutter, rolling, samples: self.samples, seed, threads: self.threads };
        let mut picture = render::color(scene, shading, &self.camera, &exposure);
        if let Some(glare) = &self.glare {
            glare.add(&mut picture, scene, shading, &self.camera, &pose(time_s), seed ^ 3);
        }
        let gain = self.exposure.next(&self.color, &picture, time_s, rng);
        (self.color.expose(&picture, gain, seed ^ 1), gain)
    }
}
