//! Small scans made up on the spot.

use glam::{DMat3, DQuat, DVec3, Vec3};
use recordings::scan::{CaptureStats, Scan, ScanSource};
use recordings::types::{
    CameraModel, ColorEncoding, ColorFrame, Distortion, Intrinsics, Keyframe, Mesh, Pose, Response, Sensor,
};
use std::f32::consts::PI;

const INTRINSICS: Intrinsics = Intrinsics { width: 96, height: 72, fx: 80.0, fy: 80.0, cx: 47.5, cy: 35.5 };

/// A sphere of `n` rings, normals outward (`sign` = 1) or inward (−1).
#[must_use]
pub fn globe(n: u32, radius: f32, sign: f32) -> Mesh {
    let mut mesh = Mesh::default();
    for i in 0..=n {
        for j in 0..2 * n {
            let (theta, phi) = (PI * i as f32 / n as f32, PI * j as f32 / n as f32);
            let ((sin, cos), (sin_phi, cos_phi)) = (libm::sincosf(theta), libm::sincosf(phi));
            let p = Vec3::new(sin * cos_phi, sin * sin_phi, cos);
            mesh.positions.push(p * radius);
            mesh.normals.push(p * sign);
            let at = |i: u32, j: u32| i * 2 * n + j % (2 * n);
            if i < n {
                mesh.triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                mesh.triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
    }
    mesh
}

/// `n` × `n` quads that span `u` and `v` from `corner`, facing `u` × `v`.
#[must_use]
pub fn sheet(n: u32, corner: Vec3, u: Vec3, v: Vec3) -> Mesh {
    let mut mesh = Mesh::default();
    let normal = u.cross(v).normalize();
    for i in 0..=n {
        for j in 0..=n {
            mesh.positions.push(corner + u * (i as f32 / n as f32) + v * (j as f32 / n as f32));
            mesh.normals.push(normal);
            if i < n && j < n {
                let at = |i: u32, j: u32| i * (n + 1) + j;
                mesh.triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                mesh.triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
    }
    mesh
}

/// Several meshes as one.
#[must_use]
pub fn joined(meshes: &[Mesh]) -> Mesh {
    let mut all = Mesh::default();
    for mesh in meshes {
        let start = all.positions.len() as u32;
        all.positions.extend(&mesh.positions);
        all.normals.extend(&mesh.normals);
        all.triangles.extend(mesh.triangles.iter().map(|t| t.map(|i| i + start)));
    }
    all
}

/// Grey levels that fall with the row.
#[must_use]
pub fn shaded(_: u32, y: u32) -> [u8; 3] {
    [200 - 2 * y.min(70) as u8; 3]
}

/// Pose of a camera at `center` that looks at `target`.
#[must_use]
pub fn looking(center: DVec3, target: DVec3) -> Pose {
    let forward = (target - center).normalize();
    let right = forward.cross(if forward.y.abs() < 0.9 { DVec3::Y } else { DVec3::X }).normalize();
    Pose::new(DQuat::from_mat3(&DMat3::from_cols(right, forward.cross(right), forward)), center)
}

/// A scan of `mesh` from `views` cameras `distance` away that look at the origin, painted by `pixel(x, y)`.
#[must_use]
pub fn scan(mesh: Mesh, views: usize, distance: f64, pixel: fn(u32, u32) -> [u8; 3]) -> Scan {
    let poses = (0..views).map(|v| {
        let angle = 0.25 * v as f64;
        let center = DVec3::new(libm::sin(angle), 0.3, libm::cos(angle)).normalize() * distance;
        looking(center, DVec3::ZERO)
    });
    let pictures = poses.map(|pose| {
        let rows = 0..INTRINSICS.height;
        (pose, rows.flat_map(|y| (0..INTRINSICS.width).flat_map(move |x| pixel(x, y))).collect())
    });
    of_pictures(mesh, INTRINSICS, Response::Srgb, pictures.collect())
}

/// A scan of `mesh` under `light(position, normal)` (lit colour of every vertex), rendered into cameras at `poses`.
///
/// Every pixel shows the point of the nearest triangle behind it; what has none is black. Linear response.
#[must_use]
pub fn lit(mesh: Mesh, poses: &[Pose], light: impl Fn(usize) -> Vec3) -> Scan {
    let camera = Intrinsics { width: 160, height: 120, fx: 150.0, fy: 150.0, cx: 79.5, cy: 59.5 };
    let scene = estimator::rays::RayScene::new(&mesh);
    let colors: Vec<Vec3> = (0..mesh.positions.len()).map(light).collect();
    let brightest = colors.iter().map(|c| c.max_element()).fold(0.0, f32::max);
    let picture = |pose: &Pose| -> Vec<u8> {
        let mut bytes = Vec::new();
        for y in 0..camera.height {
            for x in 0..camera.width {
                let ray =
                    DVec3::new((f64::from(x) - camera.cx) / camera.fx, (f64::from(y) - camera.cy) / camera.fy, 1.0);
                let direction = (pose.rotation * ray).normalize().as_vec3();
                let color = scene.closest_hit(pose.translation.as_vec3(), direction).map_or(Vec3::ZERO, |hit| {
                    let [a, b, c] = mesh.triangles[hit.triangle as usize].map(|i| colors[i as usize]);
                    a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v
                });
                bytes.extend((color / brightest * 240.0).to_array().map(|c| c.round().clamp(0.0, 255.0) as u8));
            }
        }
        bytes
    };
    let pictures = poses.iter().map(|pose| (*pose, picture(pose))).collect();
    of_pictures(mesh, camera, Response::Linear, pictures)
}

fn of_pictures(mesh: Mesh, intrinsics: Intrinsics, response: Response, pictures: Vec<(Pose, Vec<u8>)>) -> Scan {
    let camera = CameraModel { intrinsics, distortion: Distortion::default() };
    let (width, height) = (intrinsics.width, intrinsics.height);
    let keyframes = (0..).zip(pictures).map(|(v, (world_from_camera, bytes))| Keyframe {
        name: format!("{v}"),
        world_from_camera,
        camera,
        color: ColorFrame { timestamp_ns: v, width, height, encoding: ColorEncoding::Rgb, bytes, missing_packets: 0 },
    });
    Scan {
        name: "made up".into(),
        source: ScanSource::Photos,
        sensor: Sensor {
            name: "test".into(),
            serial: String::new(),
            color: camera,
            depth: camera,
            color_from_depth: Pose::IDENTITY,
            depth_registered: true,
            depth_unit_m: 0.001,
            response,
            depth_to_color_offset_ns: 0,
        },
        mesh,
        keyframes: keyframes.collect(),
        witnesses: vec![],
        config: String::new(),
        stats: CaptureStats::default(),
    }
}
