//! Analytic scenes and a simulated Kinect, with exact ground truth.

#![allow(dead_code)]

use glam::{DQuat, DVec3, IVec3};
use recordings::types::{
    CameraModel, ColorEncoding, ColorFrame, DepthFrame, Distortion, Intrinsics, Pose, Response, RgbImage, RgbdFrame,
    Sensor,
};

/// A surface of a scene.
pub enum Shape {
    /// The inside of an axis-aligned box: walls, floor, ceiling.
    Room(DVec3, DVec3),
    /// An axis-aligned box.
    Box(DVec3, DVec3),
    /// A sphere.
    Ball(DVec3, f64),
    /// The half space below z.
    Floor(f64),
}

/// Surfaces with one texture, grey 0 … 255: smooth noise of `mean` ± `contrast` with cells of `cell_m` metres.
pub struct SyntheticScene {
    pub shapes: Vec<Shape>,
    pub mean: f64,
    pub contrast: f64,
    pub cell_m: f64,
}

/// A textured desk: a floor with two boxes and a ball.
pub fn desk() -> SyntheticScene {
    SyntheticScene {
        shapes: vec![
            Shape::Floor(0.0),
            Shape::Box(DVec3::new(-0.4, -0.1, 0.0), DVec3::new(-0.1, 0.2, 0.25)),
            Shape::Box(DVec3::new(0.15, 0.1, 0.0), DVec3::new(0.35, 0.5, 0.12)),
            Shape::Ball(DVec3::new(0.1, -0.25, 0.12), 0.12),
        ],
        mean: 120.0,
        contrast: 90.0,
        cell_m: 0.03,
    }
}

/// A textured room with two boxes.
pub fn room() -> SyntheticScene {
    SyntheticScene {
        shapes: vec![
            Shape::Room(DVec3::new(-2.0, -1.5, 0.0), DVec3::new(2.0, 1.5, 2.5)),
            Shape::Box(DVec3::new(-0.4, 0.9, 0.0), DVec3::new(0.5, 1.5, 0.9)),
            Shape::Box(DVec3::new(1.2, -0.4, 0.0), DVec3::new(2.0, 0.5, 1.2)),
        ],
        mean: 120.0,
        contrast: 80.0,
        cell_m: 0.12,
    }
}

fn slab(lo: DVec3, hi: DVec3, o: DVec3, d: DVec3) -> (f64, f64) {
    let (a, b) = ((lo - o) / d, (hi - o) / d);
    (a.min(b).max_element(), a.max(b).min_element())
}

fn hash(v: IVec3) -> f64 {
    let mut h = (v.x as u32).wrapping_mul(0x8DA6_B343) ^ (v.y as u32).wrapping_mul(0xD816_3841);
    h ^= (v.z as u32).wrapping_mul(0xCB1A_B31F);
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
    f64::from(h ^ (h >> 15)) / f64::from(u32::MAX)
}

impl SyntheticScene {
    /// Distance along the ray in units of `d`.
    fn hit(&self, o: DVec3, d: DVec3) -> Option<f64> {
        let hits = self.shapes.iter().filter_map(|s| match *s {
            Shape::Room(lo, hi) => Some(slab(lo, hi, o, d).1),
            Shape::Box(lo, hi) => Some(slab(lo, hi, o, d)).filter(|(a, b)| a < b && *a > 0.0).map(|h| h.0),
            Shape::Ball(c, r) => {
                let (b, q) = ((c - o).dot(d), (c - o).length_squared() - r * r);
                let e = b * b - d.length_squared() * q;
                (e > 0.0).then(|| (b - e.sqrt()) / d.length_squared()).filter(|t| *t > 0.0)
            }
            Shape::Floor(z) => Some((z - o.z) / d.z).filter(|t| *t > 0.0),
        });
        hits.min_by(f64::total_cmp)
    }

    /// Distance of a point to the nearest surface, metres.
    pub fn distance(&self, p: DVec3) -> f64 {
        let outside = |lo: DVec3, hi: DVec3| {
            let d = (lo - p).max(p - hi);
            if d.max_element() > 0.0 { d.max(DVec3::ZERO).length() } else { d.max_element().abs() }
        };
        let distances = self.shapes.iter().map(|s| match *s {
            Shape::Room(lo, hi) | Shape::Box(lo, hi) => outside(lo, hi),
            Shape::Ball(c, r) => ((p - c).length() - r).abs(),
            Shape::Floor(z) => (p.z - z).abs(),
        });
        distances.fold(f64::INFINITY, f64::min)
    }

    fn grey(&self, p: DVec3) -> f64 {
        let q = p / self.cell_m;
        let (b, f) = (q.floor(), q - q.floor());
        let f = f * f * (DVec3::splat(3.0) - 2.0 * f);
        let corner = |x: i32, y: i32, z: i32| hash(b.as_ivec3() + IVec3::new(x, y, z));
        let lerp = |a: f64, b: f64, t: f64| a + t * (b - a);
        let row = |y, z| lerp(corner(0, y, z), corner(1, y, z), f.x);
        let n = lerp(lerp(row(0, 0), row(1, 0), f.y), lerp(row(0, 1), row(1, 1), f.y), f.z);
        (self.mean + self.contrast * (2.0 * n - 1.0)).clamp(0.0, 255.0)
    }

    /// The frame from a pose, with the Kinect's depth noise; `index` is its number at 30 frames per second.
    pub fn look(&self, sensor: &Sensor, pose: &Pose, index: usize) -> RgbdFrame {
        self.look_during(sensor, &|_| *pose, index, 1, 0.0)
    }

    /// The frame of a moving camera, `pose(t)` at `t` frame times. Colour is the mean of `samples` instants while the shutter
    /// is open; read-out of both images takes `readout` frame times, with the middle row at the time stamp.
    pub fn look_during(
        &self,
        sensor: &Sensor,
        pose: &dyn Fn(f64) -> Pose,
        index: usize,
        samples: usize,
        readout: f64,
    ) -> RgbdFrame {
        /// Exposure time, in frame times.
        const SHUTTER: f64 = 0.6;
        let k = sensor.color.intrinsics;
        let (mut depth, mut data) = (Vec::new(), Vec::new());
        let open = |s: usize| index as f64 + SHUTTER * ((s as f64 + 0.5) / samples as f64 - 0.5);
        for v in 0..k.height {
            let row = readout * ((f64::from(v) + 0.5) / f64::from(k.height) - 0.5);
            let poses: Vec<Pose> = (0..samples).map(|s| pose(open(s) + row)).collect();
            for u in 0..k.width {
                let ray = DVec3::new((f64::from(u) - k.cx) / k.fx, (f64::from(v) - k.cy) / k.fy, 1.0);
                let noise = |salt: i32| {
                    let at = |i: i32| hash(IVec3::new(u as i32, v as i32, index as i32 * 64 + salt * 8 + i));
                    at(0) + at(1) + at(2) + at(3) - 2.0
                };
                let hit = |pose: &Pose| {
                    let (o, d) = (pose.translation, pose.rotation * ray);
                    self.hit(o, d).filter(|z| *z < 9.0).map(|z| (z, o + d * z))
                };
                let hits: Vec<_> = poses.iter().map(hit).collect();
                // The sum of four uniform values has a variance of 1/3.
                let sigma = |z: f64| 0.0012 + 0.0019 * (z - 0.4) * (z - 0.4);
                let measured = hits[samples / 2].map_or(0.0, |(z, _)| z + sigma(z) * 1.7 * noise(0));
                depth.push((measured * 1000.0).round() as u16);
                let greys = hits.iter().map(|h| h.map_or(10.0, |(_, p)| self.grey(p)));
                let grey = greys.sum::<f64>() / samples as f64 + 2.0 * noise(1);
                data.extend([grey.clamp(0.0, 255.0).round() as u8; 3]);
            }
        }
        frame(sensor, index, depth, data)
    }
}

/// A frame from raw pixels.
pub fn frame(sensor: &Sensor, index: usize, depth: Vec<u16>, rgb: Vec<u8>) -> RgbdFrame {
    let (width, height) = (sensor.color.intrinsics.width, sensor.color.intrinsics.height);
    let timestamp_ns = index as i64 * 33_333_333;
    RgbdFrame {
        depth: DepthFrame { timestamp_ns, width, height, depth, missing_packets: 0 },
        color: ColorFrame {
            timestamp_ns,
            width,
            height,
            encoding: ColorEncoding::Rgb,
            bytes: Vec::new(),
            missing_packets: 0,
        },
        rgb: RgbImage { width, height, data: rgb },
    }
}

/// A frame without depth and light.
pub fn black(sensor: &Sensor, index: usize) -> RgbdFrame {
    let n = (sensor.color.intrinsics.width * sensor.color.intrinsics.height) as usize;
    frame(sensor, index, vec![0; n], vec![0; 3 * n])
}

/// A registered sensor with the field of view of a Kinect.
pub fn sensor(width: u32, height: u32) -> Sensor {
    let f = 0.82 * f64::from(width);
    let intrinsics =
        Intrinsics { width, height, fx: f, fy: f, cx: f64::from(width) * 0.5 - 0.5, cy: f64::from(height) * 0.5 - 0.5 };
    let camera = CameraModel { intrinsics, distortion: Distortion::default() };
    Sensor {
        name: "analytic".into(),
        serial: String::new(),
        color: camera,
        depth: camera,
        color_from_depth: Pose::IDENTITY,
        depth_registered: true,
        depth_unit_m: 0.001,
        response: Response::Srgb,
        depth_to_color_offset_ns: 0,
    }
}

/// Pose of an upright camera at `from` that looks at `to`.
pub fn look_at(from: DVec3, to: DVec3) -> Pose {
    let z = (to - from).normalize();
    let x = z.cross(DVec3::Z).normalize();
    let y = z.cross(x);
    let rows = [[x.x, y.x, z.x, from.x], [x.y, y.y, z.y, from.y], [x.z, y.z, z.z, from.z], [0.0, 0.0, 0.0, 1.0]];
    Pose::from_rows(&rows).unwrap()
}

/// A pose translated by `metres` along and rotated by `degrees` about the axes of the camera.
pub fn moved(pose: &Pose, metres: DVec3, degrees: DVec3) -> Pose {
    pose.compose(&Pose::new(DQuat::from_scaled_axis(degrees * std::f64::consts::PI / 180.0), metres))
}

/// Error of the estimated motion since the first frame, metres and degrees; each argument is (estimate, truth).
pub fn error(first: (&Pose, &Pose), now: (&Pose, &Pose)) -> (f64, f64) {
    let (estimated, truth) = (first.0.inverse().compose(now.0), first.1.inverse().compose(now.1));
    let e = truth.inverse().compose(&estimated);
    (e.translation.length(), e.rotation.angle_between(DQuat::IDENTITY) * 180.0 / std::f64::consts::PI)
}
