//! Association, segmentation and regularisation without usable input: the output stays valid.

use estimator::association::{Association, AssociationContext, associate};
use estimator::mesh::graph::Graph;
use estimator::mesh::regularise;
use estimator::rays::RayScene;
use estimator::segmentation;
use firmware_config::EstimatorConfig;
use glam::{DQuat, DVec3, Vec3};
use recordings::scan::ScanSource;
use recordings::types::{
    CameraModel, ColorEncoding, ColorFrame, Distortion, Intrinsics, Keyframe, Mesh, Pose, Response,
};

/// A square of `n` × `n` vertices in z = 0, edge length `size`.
fn square(n: u32, size: f32) -> Mesh {
    let at = |i: u32| (i as f32 / (n - 1) as f32 - 0.5) * size;
    let positions = (0..n * n).map(|i| Vec3::new(at(i % n), at(i / n), 0.0)).collect::<Vec<_>>();
    let normals = vec![Vec3::Z; positions.len()];
    let quad = |x: u32, y: u32| {
        let a = y * n + x;
        [[a, a + 1, a + n + 1], [a, a + n + 1, a + n]]
    };
    let triangles = (0..n - 1).flat_map(|y| (0..n - 1).flat_map(move |x| quad(x, y))).collect();
    Mesh { positions, normals, triangles }
}

/// A camera above the origin that looks down; every pixel has the value that `pixel` gives.
fn keyframe(height: f64, shift: f64, pixel: impl Fn(u32, u32) -> [u8; 3]) -> Keyframe {
    let (width, rows) = (64, 48);
    let intrinsics = Intrinsics { width, height: rows, fx: 60.0, fy: 60.0, cx: 31.5, cy: 23.5 };
    let bytes = (0..rows).flat_map(|y| (0..width).map(move |x| (x, y))).flat_map(|(x, y)| pixel(x, y)).collect();
    Keyframe {
        name: "k".into(),
        // Half a turn about x: the optical axis points down.
        world_from_camera: Pose::new(DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0), DVec3::new(shift, 0.0, height)),
        camera: CameraModel { intrinsics, distortion: Distortion::default() },
        color: ColorFrame {
            timestamp_ns: 0,
            width,
            height: rows,
            encoding: ColorEncoding::Rgb,
            bytes,
            missing_packets: 0,
        },
    }
}

fn run(mesh: &Mesh, keyframes: &[Keyframe]) -> (Association, Vec<u32>) {
    let config = EstimatorConfig::default();
    let scene = RayScene::new(mesh);
    let found = associate(&mut AssociationContext::new(mesh, &scene, &Response::Srgb, &config), keyframes, &());
    let segment = segmentation::segment(mesh, &Graph::of(mesh), &scene, &found.lit_color, &found.lit_weight, &config);
    let n = mesh.positions.len();
    assert_eq!((found.lit_color.len(), found.lit_weight.len(), found.views.len()), (n, n, keyframes.len()));
    assert_eq!((segment.len(), found.offsets.len()), (n, n + 1));
    assert!(found.lit_color.iter().all(|c| c.is_finite() && c.min_element() >= 0.0));
    assert!(found.lit_weight.iter().all(|w| w.is_finite() && *w >= 0.0));
    assert!(found.views.iter().all(|v| v.world_from_camera.is_finite() && v.gain.iter().all(|g| *g > 0.0)));
    let segments = segment.iter().max().map_or(0, |s| s + 1);
    assert!((0..segments).all(|s| segment.contains(&s)), "segments are numbered without gaps");
    (found, segment)
}

#[test]
fn no_keyframe_sees_nothing() {
    let (found, _) = run(&square(10, 1.0), &[]);
    assert!(found.lit_weight.iter().all(|w| *w == 0.0));
}

#[test]
fn one_keyframe_gives_its_own_colours_at_any_scale() {
    for scale in [0.01, 1.0, 100.0] {
        let (found, segment) = run(&square(30, scale), &[keyframe(f64::from(scale), 0.0, |_, _| [128, 64, 32])]);
        let center = found.lit_color[30 * 15 + 15];
        assert!((center - Vec3::new(0.2159, 0.0513, 0.0144)).abs().max_element() < 1e-3, "{center} at {scale}");
        assert!(segment.iter().all(|s| *s == 0));
    }
}

#[test]
fn black_clipped_and_broken_pictures() {
    let mesh = square(30, 1.0);
    let gray = |value: u8| keyframe(1.0, 0.01, move |_, _| [value; 3]);
    run(&mesh, &[gray(0), gray(0), gray(0)]);
    let (found, _) = run(&mesh, &[gray(255), gray(255)]);
    assert!(found.lit_weight[30 * 15 + 15] > 0.0, "a clipped colour is better than none");
    let mut broken = gray(100);
    broken.color.bytes.truncate(100);
    let (found, _) = run(&mesh, &[broken.clone(), gray(100)]);
    assert!(found.observations.iter().all(|o| o.keyframe == 1));
    let (found, _) = run(&mesh, &[broken]);
    assert!(found.observations.is_empty());
}

#[test]
fn exposures_far_apart_are_found() {
    let mesh = square(40, 1.0);
    let shade = |x: u32, y: u32| 40 + ((x / 8 + y / 8) % 2) as u8 * 20;
    let bright = keyframe(1.0, 0.0, |x, y| [shade(x, y) * 4; 3]);
    let dark = keyframe(1.0, 0.0, |x, y| [shade(x, y); 3]);
    let config = EstimatorConfig { refine_poses: firmware_config::Switch::Off, ..EstimatorConfig::default() };
    let scene = RayScene::new(&mesh);
    let found =
        associate(&mut AssociationContext::new(&mesh, &scene, &Response::Linear, &config), &[bright, dark], &());
    let ratio = found.views[0].gain[0] / found.views[1].gain[0];
    assert!((ratio / 4.0 - 1.0).abs() < 0.01, "{ratio}");
}

/// A print that cameras with and without a shoulder show at five exposures: gains, and the light of bright and dim surface.
#[test]
fn highlights_that_the_camera_compresses_are_expanded() {
    const GAINS: [f64; 5] = [0.4, 0.6, 0.9, 1.3, 1.8];
    let mesh = square(60, 1.0);
    let wave = |x: f64| 0.5 - 0.5 * libm::cos(x);
    let light =
        |x: u32, y: u32, c: usize| 0.05 + 0.75 * wave(f64::from(x) / (3.0 + c as f64)) * wave(f64::from(y) / 4.0 + 0.5);
    for strength in [0.9, 0.0] {
        let camera = if strength > 0.0 { Response::Shoulder(strength) } else { Response::Srgb };
        let shown = |gain: f64, x: u32, y: u32| [0, 1, 2].map(|c| camera.encode((gain * light(x, y, c)) as f32));
        let keyframes = GAINS.map(|gain| keyframe(1.0, 0.0, move |x, y| shown(gain, x, y)));
        let config = EstimatorConfig { refine_poses: firmware_config::Switch::Off, ..EstimatorConfig::default() };
        let scene = RayScene::new(&mesh);
        let mut context = AssociationContext::new(&mesh, &scene, &Response::Srgb, &config);
        let found = associate(&mut context, &keyframes, &());
        assert_eq!(found.lens.response, context.response);
        let white = context.response.full_scale();
        assert!((white / camera.full_scale() - 1.0).abs() < 0.05, "{white} for a strength of {strength}");
        for (view, gain) in found.views.iter().zip(GAINS) {
            let ratio = view.gain[0] / found.views[0].gain[0] * GAINS[0] / gain;
            assert!((ratio - 1.0).abs() < 0.03, "{ratio} at a gain of {gain}");
        }
    }
}

/// Exposures 1 : 10⁴ apart: no two pictures at the ends share a pixel that is neither clipped nor black, but a chain does.
#[test]
fn exposures_ten_thousand_to_one() {
    const FACTOR: f64 = 2.05;
    let mesh = square(40, 1.0);
    // Sixteen stripes, each about twice as bright as the one before; picture j shows stripe j at 200 and all that are
    // brighter clipped. Stripe 0, at the pictures' border, has no information.
    let value = |j: i32, x: u32| {
        let level = 200.0 * libm::pow(FACTOR, f64::from(x / 4) - f64::from(j));
        [level.clamp(0.0, 255.0).round() as u8; 3]
    };
    let keyframes: Vec<Keyframe> = (0..15).map(|j| keyframe(1.0, 0.0, move |x, _| value(j, x))).collect();
    let config = EstimatorConfig { refine_poses: firmware_config::Switch::Off, ..EstimatorConfig::default() };
    let scene = RayScene::new(&mesh);
    let found = associate(&mut AssociationContext::new(&mesh, &scene, &Response::Linear, &config), &keyframes, &());
    let ratio = found.views[1].gain[1] / found.views[14].gain[1];
    let expected = libm::pow(FACTOR, 13.0);
    // Eight bits round a value of 6 by several per cent: each link of the chain may be off by four.
    assert!(expected > 1e4 && libm::log(ratio / expected).abs() < 13.0 * 0.04, "{ratio} instead of {expected}");
}

#[test]
fn single_vertices_and_bad_triangles() {
    let camera = || vec![keyframe(1.0, 0.0, |_, _| [90; 3]), keyframe(1.0, 0.1, |_, _| [90; 3])];
    let config = EstimatorConfig::default();
    let empty = Mesh::default();
    let lone = Mesh { positions: vec![Vec3::ZERO], normals: vec![Vec3::Z], triangles: vec![] };
    let mut bad = square(5, 1.0);
    bad.positions.extend([Vec3::NAN, Vec3::INFINITY, Vec3::ZERO]);
    bad.normals.clear();
    // Degenerate, duplicate, an edge of three triangles, indices beyond the end.
    bad.triangles.extend([[0, 0, 1], [0, 1, 6], [0, 1, 7], [25, 26, 1], [900, 1, 2], [27, 12, 13]]);
    for mesh in [empty, lone, bad] {
        for source in [ScanSource::Photos, ScanSource::Fusion] {
            let mesh = regularise::regularise(&mesh, &config, source);
            assert_eq!(mesh.positions.len(), mesh.normals.len());
            assert!(mesh.positions.iter().chain(&mesh.normals).all(|v| v.is_finite()));
            assert!(mesh.triangles.iter().flatten().all(|i| (*i as usize) < mesh.positions.len()));
            run(&mesh, &camera());
        }
    }
}

#[test]
fn a_step_of_colour_is_a_border_and_shading_is_none() {
    let mesh = square(60, 1.0);
    let seen = vec![1.0; mesh.positions.len()];
    let scene = RayScene::new(&mesh);
    let config = EstimatorConfig::default();
    // Brightness falls to a sixth across the square; the right half is of another colour.
    let shaded = |base: Vec3, p: Vec3| base * (1.0 - 0.83 * (p.y + 0.5));
    let one: Vec<Vec3> = mesh.positions.iter().map(|p| shaded(Vec3::new(0.5, 0.45, 0.4), *p)).collect();
    let two: Vec<Vec3> = mesh
        .positions
        .iter()
        .map(|p| shaded(if p.x > 0.1 { Vec3::new(0.3, 0.45, 0.5) } else { Vec3::new(0.5, 0.45, 0.4) }, *p))
        .collect();
    let segments = |colors: &[Vec3]| segmentation::segment(&mesh, &Graph::of(&mesh), &scene, colors, &seen, &config);
    assert!(segments(&one).iter().all(|s| *s == 0), "shading shattered the square");
    let found = segments(&two);
    let wrong = mesh.positions.iter().zip(&found).filter(|(p, s)| (**s == 1) != (p.x > 0.1)).count();
    assert!(wrong < 60, "{wrong} vertices on the wrong side");
}

#[test]
fn unseen_vertices_take_the_nearest_segment() {
    let mesh = square(40, 1.0);
    let color: Vec<Vec3> =
        mesh.positions.iter().map(|p| if p.x > 0.0 { Vec3::new(0.6, 0.1, 0.1) } else { Vec3::splat(0.5) }).collect();
    let weight: Vec<f32> = mesh.positions.iter().map(|p| if p.y > 0.2 { 0.0 } else { 1.0 }).collect();
    let scene = RayScene::new(&mesh);
    let found = segmentation::segment(&mesh, &Graph::of(&mesh), &scene, &color, &weight, &EstimatorConfig::default());
    let top = |x: usize| found[39 * 40 + x];
    assert_eq!(top(5), found[5]);
    assert_eq!(top(35), found[35]);
    assert_ne!(top(5), top(35));
}
