//! A small result for tests.

use glam::{DQuat, DVec3, Vec3};
use recordings::decision::TransferLevel;
use recordings::local_light::LocalLight;
use recordings::result::{Chart, Estimate, Light, ResultKeyframe, Segment, Texture};
use recordings::types::{CameraModel, Distortion, Intrinsics, Mesh, Pose, Response};

/// A result with one triangle, two segments, two keyframes and one coefficient.
pub fn tiny() -> Estimate {
    let intrinsics = Intrinsics { width: 64, height: 48, fx: 50.0, fy: 50.0, cx: 31.5, cy: 23.5 };
    let keyframe = |name: &str, t: i64, gain: f64, x: f64| ResultKeyframe {
        name: name.into(),
        timestamp_ns: t,
        gain: [gain; 3],
        world_from_camera: Pose::new(DQuat::IDENTITY, DVec3::new(x, 0.0, -1.0)),
        camera: CameraModel { intrinsics, distortion: Distortion::default() },
        residual_px: 0.0,
    };
    let segment = |w_s| Segment { vertices: 1, albedo: [0.5; 3], w_d: 1.0, w_s, w_s_error: f64::INFINITY };
    Estimate {
        name: "tiny".into(),
        response: Response::Srgb,
        mesh: Mesh {
            positions: vec![Vec3::new(-0.2, -0.2, 0.0), Vec3::new(0.2, -0.2, 0.0), Vec3::new(0.0, 0.2, 0.1)],
            normals: vec![Vec3::NEG_Z; 3],
            triangles: vec![[0, 2, 1]],
        },
        segment: vec![0, 0, 1],
        lit_color: vec![Vec3::splat(0.2), Vec3::X, Vec3::Y],
        albedo: vec![Vec3::splat(0.5), Vec3::new(0.1, 0.2, 0.3), Vec3::new(0.9, 0.8, 0.7)],
        confidence: vec![1.0; 3],
        light: Light { coefficients: vec![[1.0, 2.0, 3.0]], standard_deviation: vec![[0.1; 3]], ..Light::default() },
        segments: vec![segment(0.0), segment(0.25)],
        keyframes: vec![
            keyframe("keyframes/a.png", 1_305_031_102_175_304_000, 2.0, 0.0),
            keyframe("keyframes/b.png", 1_305_031_102_275_304_000, 0.5, 0.25),
        ],
        transfer: TransferLevel::Diffuse,
        decisions: vec![],
        cuts: vec![],
        warnings: vec![],
        albedo_scale_rule: "test".into(),
        witnesses: vec![],
        local_light: LocalLight::default(),
        texture: None,
    }
}

/// The same with a texture: a red and a green half.
pub fn textured() -> Estimate {
    let mut result = tiny();
    let (width, height) = (16, 8);
    let pixels: Vec<u8> =
        (0..width * height).flat_map(|i| if i % width < 8 { [200, 0, 0] } else { [0, 200, 0] }).collect();
    result.texture = Some(Texture {
        width,
        height,
        texel_m: 0.05,
        scale: 1.0,
        charts: vec![Chart { x_axis: [20.0, 0.0, 0.0], y_axis: [0.0, 10.0, 0.0], x_offset: 7.5, y_offset: 3.5 }],
        chart: vec![0],
        jpeg: crate::export::picture::encode_jpeg(width, height, &pixels, 95).unwrap(),
    });
    result
}
