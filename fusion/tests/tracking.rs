//! Tracking, loss and relocalisation in synthetic scenes with exact ground truth.

#![allow(clippy::unwrap_used, clippy::expect_used)]

mod synthetic;

use firmware_config::FusionConfig;
use fusion::Fusion;
use fusion::FusionError;
use fusion::Tracking;
use glam::{DQuat, DVec3};
use recordings::types::{Pose, RgbdFrame, Sensor};
use synthetic::{Shape, SyntheticScene, desk, error, look_at, moved};

fn small_config() -> FusionConfig {
    FusionConfig { pool_blocks: 16384, ..FusionConfig::default() }
}

/// Poses that fusion reports for the frames, `None` where lost.
fn track(sensor: &Sensor, frames: &[RgbdFrame]) -> Vec<Option<Pose>> {
    let mut fusion = Fusion::new(sensor, &small_config()).unwrap();
    frames.iter().map(|f| fusion.push(f).unwrap().world_from_camera).collect()
}

fn worst_error(sensor: &Sensor, scene: &SyntheticScene, truth: &[Pose]) -> (f64, f64) {
    let frames: Vec<RgbdFrame> = truth.iter().enumerate().map(|(i, p)| scene.look(sensor, p, i)).collect();
    worst_error_of(sensor, &frames, truth)
}

fn worst_error_of(sensor: &Sensor, frames: &[RgbdFrame], truth: &[Pose]) -> (f64, f64) {
    let found = track(sensor, frames);
    let first = found[0].unwrap();
    found.iter().zip(truth).fold((0.0, 0.0), |worst, (f, t)| {
        let e = error((&first, &truth[0]), (&f.expect("lost"), t));
        (e.0.max(worst.0), e.1.max(worst.1))
    })
}

#[test]
fn an_arc_over_a_desk_is_tracked() {
    let sensor = synthetic::sensor(320, 240);
    let truth: Vec<Pose> = (0..40)
        .map(|i| {
            let a = f64::from(i) * 0.02;
            look_at(DVec3::new(1.1 * libm::sin(a), -1.1 * libm::cos(a), 0.7), DVec3::new(0.0, 0.0, 0.1))
        })
        .collect();
    let (metres, degrees) = worst_error(&sensor, &desk(), &truth);
    assert!(metres < 0.006 && degrees < 0.5, "{metres} m, {degrees}°");
}

#[test]
fn a_textured_plane_does_not_slide() {
    let sensor = synthetic::sensor(320, 240);
    let plane = SyntheticScene { shapes: vec![Shape::Floor(0.0)], mean: 120.0, contrast: 90.0, cell_m: 0.03 };
    let start = look_at(DVec3::new(0.0, -0.6, 0.8), DVec3::ZERO);
    let truth: Vec<Pose> =
        (0..40).map(|i| moved(&start, DVec3::new(0.006 * f64::from(i), 0.0, 0.0), DVec3::ZERO)).collect();
    let (metres, degrees) = worst_error(&sensor, &plane, &truth);
    assert!(metres < 0.008 && degrees < 0.5, "{metres} m, {degrees}°");
}

#[test]
fn a_plane_without_texture_stays_put() {
    let sensor = synthetic::sensor(320, 240);
    let plane = SyntheticScene { shapes: vec![Shape::Floor(0.0)], mean: 120.0, contrast: 0.0, cell_m: 0.03 };
    let truth = vec![look_at(DVec3::new(0.0, -0.6, 0.8), DVec3::ZERO); 60];
    let (metres, degrees) = worst_error(&sensor, &plane, &truth);
    assert!(metres < 0.005 && degrees < 0.3, "{metres} m, {degrees}°");
}

/// Without texture, motion along a plane is unobserved: height and tilt must stay right, the pose must not drift far, and it
/// must be corrected when the texture returns.
#[test]
fn over_a_bare_plane_the_pose_stays_near_and_texture_corrects_it() {
    let sensor = synthetic::sensor(320, 240);
    let plane = |contrast| SyntheticScene { shapes: vec![Shape::Floor(0.0)], mean: 120.0, contrast, cell_m: 0.03 };
    let start = look_at(DVec3::new(0.0, -0.6, 0.8), DVec3::ZERO);
    // 24 cm to the side and half of the way back, smoothly.
    let side = |i: usize| 0.12 * (1.0 - libm::cos(0.075 * i as f64));
    let mut fusion = Fusion::new(&sensor, &small_config()).unwrap();
    let mut first = None;
    let mut right_again = 0;
    for i in 0..70 {
        let bare = (10..55).contains(&i);
        let pose = Pose::new(start.rotation, start.translation + DVec3::X * side(i));
        let frame = plane(if bare { 0.0 } else { 90.0 }).look(&sensor, &pose, i);
        let Some(found) = fusion.push(&frame).unwrap().world_from_camera else { continue };
        let first: &Pose = first.get_or_insert(found);
        let ours_in_truth = start.compose(&first.inverse()).compose(&found);
        let off = ours_in_truth.translation - pose.translation;
        let tilt = (ours_in_truth.rotation * pose.rotation.conjugate() * DVec3::Z).angle_between(DVec3::Z).to_degrees();
        assert!(off.z.abs() < 0.01 && tilt < 0.7, "frame {i}: {} m, {tilt}°", off.z);
        assert!(off.length() < if bare { 0.3 } else { 0.2 }, "frame {i}: drifted by {off} m");
        let (metres, degrees) = error((first, &start), (&found, &pose));
        assert!(i >= 10 || metres < 0.005, "frame {i}: {metres} m");
        right_again += usize::from(i >= 60 && metres < 0.01 && degrees < 0.5);
    }
    assert!(right_again >= 9, "right in {right_again} of the last ten frames only");
}

/// Depth as the Kinect tells it, in eighths of a pixel of disparity: the steps that a slanted wall gets move with the camera.
fn with_steps(mut frame: RgbdFrame) -> RgbdFrame {
    // Focal length in pixels times baseline in millimetres, times 8.
    const PER_STEP: f64 = 575.8 * 75.0 * 8.0;
    for z in frame.depth.depth.iter_mut().filter(|z| **z > 0) {
        *z = (PER_STEP / (PER_STEP / f64::from(*z)).round()).round() as u16;
    }
    frame
}

#[test]
fn faint_texture_holds_against_the_steps_of_a_bare_wall() {
    let sensor = synthetic::sensor(320, 240);
    let wall = SyntheticScene { shapes: vec![Shape::Floor(0.0)], mean: 120.0, contrast: 25.0, cell_m: 0.15 };
    let start = look_at(DVec3::new(0.0, -0.9, 2.0), DVec3::ZERO);
    let truth: Vec<Pose> = (0..40)
        .map(|i| {
            let t = f64::from(i);
            moved(&start, DVec3::new(0.016 * t, 0.004 * t, 0.0), DVec3::new(0.004 * t, 0.01 * t, 0.0))
        })
        .collect();
    let frames: Vec<RgbdFrame> = truth.iter().enumerate().map(|(i, p)| with_steps(wall.look(&sensor, p, i))).collect();
    let (metres, degrees) = worst_error_of(&sensor, &frames, &truth);
    // Over 64 cm; 36 cm and 3.5° where the scattered normals of the wall count in full.
    assert!(metres < 0.1 && degrees < 2.0, "{metres} m, {degrees}°");
}

#[test]
fn a_fast_rotation_is_tracked() {
    let sensor = synthetic::sensor(320, 240);
    let room = SyntheticScene {
        shapes: vec![
            Shape::Room(DVec3::new(-2.0, -1.5, 0.0), DVec3::new(2.0, 1.5, 2.5)),
            Shape::Box(DVec3::new(-0.4, 0.9, 0.0), DVec3::new(0.5, 1.5, 0.9)),
        ],
        mean: 120.0,
        contrast: 80.0,
        cell_m: 0.12,
    };
    let start = look_at(DVec3::new(0.1, -0.8, 1.2), DVec3::new(0.0, 1.0, 1.0));
    // Up to 4° a frame, 120° a second.
    let truth: Vec<Pose> = (0..40)
        .map(|i| moved(&start, DVec3::ZERO, DVec3::new(0.0, 40.0 * libm::sin(f64::from(i) * 0.1), 0.0)))
        .collect();
    let (metres, degrees) = worst_error(&sensor, &room, &truth);
    assert!(metres < 0.03 && degrees < 1.0, "{metres} m, {degrees}°");
}

/// Ten frames of the desk, ten frames `between`, ten more frames of the desk from the same pose. Returns states, blocks in
/// use and poses.
fn interrupted(between: impl Fn(&Sensor, &Pose, usize) -> RgbdFrame) -> (Vec<Tracking>, Vec<u64>, Vec<Option<Pose>>) {
    let sensor = synthetic::sensor(320, 240);
    let scene = desk();
    let at = look_at(DVec3::new(0.2, -1.1, 0.7), DVec3::new(0.0, 0.0, 0.1));
    let mut fusion = Fusion::new(&sensor, &small_config()).unwrap();
    let (mut states, mut blocks, mut poses) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..30 {
        let frame = if (10..20).contains(&i) { between(&sensor, &at, i) } else { scene.look(&sensor, &at, i) };
        let report = fusion.push(&frame).unwrap();
        states.push(report.tracking);
        blocks.push(report.blocks_used);
        poses.push(report.world_from_camera);
    }
    let output = fusion.finish();
    assert_eq!(output.stats.lost_pairs, states.iter().filter(|s| **s == Tracking::Lost).count() as u64);
    assert_eq!(output.trajectory.len(), states.iter().filter(|s| **s == Tracking::Tracked).count());
    (states, blocks, poses)
}

fn assert_lost_and_found(states: &[Tracking], blocks: &[u64], poses: &[Option<Pose>]) {
    assert!(states[..10].iter().all(|s| *s == Tracking::Tracked));
    assert!(states[10..12].contains(&Tracking::Lost), "not lost within two frames: {states:?}");
    assert!(states[12..20].iter().all(|s| *s == Tracking::Lost), "{states:?}");
    assert_eq!(blocks[11], blocks[19], "something was integrated while lost");
    let back = states[20..].iter().position(|s| *s == Tracking::Tracked).expect("never found again");
    assert!(back < 10);
    let (before, after) = (poses[9].unwrap(), poses[29].unwrap());
    let e = before.inverse().compose(&after);
    assert!(e.translation.length() < 0.01, "found in the wrong place: {} m", e.translation.length());
}

#[test]
fn black_frames_are_lost_and_the_camera_is_found_again() {
    let (states, blocks, poses) = interrupted(|sensor, _, i| synthetic::black(sensor, i));
    assert_lost_and_found(&states, &blocks, &poses);
}

#[test]
fn a_covered_lens_is_lost_and_the_camera_is_found_again() {
    // A hand covers projector and camera: no depth, a dim uniform image.
    let (states, blocks, poses) = interrupted(|sensor, _, i| {
        let n = (sensor.color.intrinsics.width * sensor.color.intrinsics.height) as usize;
        synthetic::frame(sensor, i, vec![0; n], vec![40; 3 * n])
    });
    assert_lost_and_found(&states, &blocks, &poses);
}

#[test]
fn a_view_of_something_else_is_lost_and_the_camera_is_found_again() {
    let elsewhere = SyntheticScene {
        shapes: vec![Shape::Room(DVec3::new(-1.0, -3.0, -0.4), DVec3::new(2.5, 1.0, 2.0))],
        mean: 90.0,
        contrast: 70.0,
        cell_m: 0.07,
    };
    let (states, blocks, poses) = interrupted(|sensor, at, i| elsewhere.look(sensor, at, i));
    assert_lost_and_found(&states, &blocks, &poses);
}

#[test]
fn a_jump_is_detected_and_recovered() {
    let sensor = synthetic::sensor(320, 240);
    let scene = desk();
    let at = look_at(DVec3::new(0.2, -1.1, 0.7), DVec3::new(0.0, 0.0, 0.1));
    let away = moved(&at, DVec3::new(0.28, 0.0, -0.1), DVec3::new(0.0, -20.0, 0.0));
    let truth: Vec<Pose> = (0..40).map(|i| if (15..25).contains(&i) { away } else { at }).collect();
    let mut fusion = Fusion::new(&sensor, &small_config()).unwrap();
    let mut found = Vec::new();
    for (i, p) in truth.iter().enumerate() {
        found.push(fusion.push(&scene.look(&sensor, p, i)).unwrap().world_from_camera);
    }
    assert!(found[15..17].iter().any(Option::is_none), "the jump went unnoticed");
    assert!(found[25..35].iter().any(Option::is_some), "never found again");
    assert!(found[39].is_some());
    let first = found[0].unwrap();
    for (f, t) in found.iter().zip(&truth) {
        if let Some(f) = f {
            let e = error((&first, &truth[0]), (f, t));
            assert!(e.0 < 0.02 && e.1 < 1.5, "fused in a wrong place: {e:?}");
        }
    }
    assert!(fusion.finish().stats.losses >= 1);
}

#[test]
fn the_world_is_upright() {
    let sensor = synthetic::sensor(320, 240);
    let at = look_at(DVec3::new(0.2, -1.1, 0.7), DVec3::new(0.0, 0.0, 0.1));
    let mut fusion = Fusion::new(&sensor, &small_config()).unwrap();
    let up = at.rotation.conjugate() * DVec3::Z;
    fusion.set_gravity(9.81 * up);
    let pose = fusion.push(&desk().look(&sensor, &at, 0)).unwrap().world_from_camera.unwrap();
    assert!((pose.rotation * up - DVec3::Z).length() < 1e-6);
}

#[test]
fn one_thread_or_two_give_the_same_bits() {
    let sensor = synthetic::sensor(320, 240);
    let scene = desk();
    let frames: Vec<RgbdFrame> = (0..12)
        .map(|i| {
            let from = DVec3::new(0.02 * f64::from(i), -1.1, 0.7);
            scene.look(&sensor, &look_at(from, DVec3::new(0.0, 0.0, 0.1)), i as usize)
        })
        .collect();
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut fusion = Fusion::new(&sensor, &small_config()).unwrap();
            for f in &frames {
                fusion.push(f).unwrap();
            }
            fusion.finish()
        })
    };
    let (a, b) = (run(1), run(2));
    assert_eq!(a.trajectory, b.trajectory);
    assert_eq!(a.mesh, b.mesh);
    assert_eq!(a.keyframes, b.keyframes);
}

#[test]
fn no_image_causes_a_panic() {
    for (w, h) in [(1, 1), (2, 3), (7, 5), (64, 48), (161, 121), (330, 250)] {
        let sensor = synthetic::sensor(w, h);
        let n = (w * h) as usize;
        let mut fusion = Fusion::new(&sensor, &small_config()).unwrap();
        for i in 0..6 {
            let value = [0u16, 65535, 1000, 40_000, 1500, 1][i];
            let depth = (0..n).map(|p| if p % 3 == i % 3 { value } else { value.wrapping_mul(p as u16) }).collect();
            let rgb = (0..3 * n).map(|p| (p * (i + 37)) as u8).collect();
            fusion.push(&synthetic::frame(&sensor, i, depth, rgb)).unwrap();
        }
        let even = synthetic::frame(&sensor, 9, vec![65535; n], vec![255; 3 * n]);
        fusion.push(&even).unwrap();
        let output = fusion.finish();
        assert!(output.mesh.positions.iter().all(|p| p.is_finite()));
        assert!(output.mesh.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-3));
    }
}

#[test]
fn invalid_sensors_and_frames_are_refused() {
    let good = synthetic::sensor(64, 48);
    let spoil = |f: fn(&mut Sensor)| {
        let mut s = good.clone();
        f(&mut s);
        assert!(matches!(Fusion::new(&s, &small_config()), Err(FusionError::BadSensor(_))));
    };
    spoil(|s| s.color.intrinsics.fx = 0.0);
    spoil(|s| s.depth.intrinsics.fy = f64::NAN);
    spoil(|s| s.depth.intrinsics.cx = 1e12);
    spoil(|s| s.color.intrinsics.width = 0);
    spoil(|s| s.depth.intrinsics.height = u32::MAX);
    spoil(|s| s.depth_unit_m = -1.0);
    spoil(|s| s.color.distortion.k2 = f64::INFINITY);
    spoil(|s| s.color_from_depth.translation.x = f64::NAN);
    spoil(|s| s.color_from_depth.rotation = DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0));
    let mut fusion = Fusion::new(&good, &small_config()).unwrap();
    let mut wrong = synthetic::black(&good, 0);
    wrong.depth.depth.pop();
    assert!(matches!(fusion.push(&wrong), Err(FusionError::BadFrame(_))));
    let other = synthetic::black(&synthetic::sensor(32, 48), 0);
    assert!(matches!(fusion.push(&other), Err(FusionError::BadFrame(_))));
}

/// An object visible in two frames gives no surface; with `min_weight` 0 it would.
#[test]
fn min_weight_drops_phantoms() {
    let sensor = synthetic::sensor(320, 240);
    let at = look_at(DVec3::new(0.2, -1.1, 0.7), DVec3::new(0.0, 0.0, 0.1));
    let phantom = (DVec3::new(-0.05, -0.3, 0.4), 0.06);
    let mut haunted = desk();
    haunted.shapes.push(Shape::Ball(phantom.0, phantom.1));
    let near_phantom = |min_weight: f64| {
        let config = FusionConfig { min_weight, min_component_triangles: 0, ..small_config() };
        let mut fusion = Fusion::new(&sensor, &config).unwrap();
        let first = fusion.push(&desk().look(&sensor, &at, 0)).unwrap().world_from_camera.unwrap();
        for i in 1..20 {
            let scene = if i >= 18 { &haunted } else { &desk() };
            assert_eq!(fusion.push(&scene.look(&sensor, &at, i)).unwrap().tracking, Tracking::Tracked);
        }
        let ours_from_truth = first.compose(&at.inverse());
        let centre = ours_from_truth.transform(phantom.0);
        let mesh = fusion.finish().mesh;
        assert!(mesh.triangles.len() > 1000);
        mesh.positions.iter().filter(|p| (p.as_dvec3() - centre).length() < phantom.1 + 0.02).count()
    };
    assert!(near_phantom(0.0) > 100, "the phantom is no surface even without the test");
    assert_eq!(near_phantom(FusionConfig::default().min_weight), 0);
}

/// A sensor whose readings are too short, more so at a distance and off the axis: the polynomial of the settings corrects them.
#[test]
fn a_known_depth_distortion_is_removed() {
    let sensor = synthetic::sensor(320, 240);
    let wall = SyntheticScene { shapes: vec![Shape::Floor(0.0)], mean: 120.0, contrast: 90.0, cell_m: 0.03 };
    let at = look_at(DVec3::new(0.0, -0.4, 1.4), DVec3::ZERO);
    let known = FusionConfig {
        depth_linear: 0.01,
        depth_linear_radial: 0.03,
        depth_square: 0.004,
        depth_square_radial: -0.01,
        ..small_config()
    };
    let k = sensor.depth.intrinsics;
    let distorted = |i: usize| {
        let mut frame = wall.look(&sensor, &at, i);
        for (p, d) in frame.depth.depth.iter_mut().enumerate() {
            let (u, v) = ((p % k.width as usize) as f64, (p / k.width as usize) as f64);
            let r2 = ((u - k.cx) / k.fx).powi(2) + ((v - k.cy) / k.fy).powi(2);
            let a = 1.0 + known.depth_linear + known.depth_linear_radial * r2;
            let b = known.depth_square + known.depth_square_radial * r2;
            // The reading z for which a z + b z² is the true depth.
            let t = f64::from(*d) * 0.001;
            let z = 2.0 * t / (a + (a * a + 4.0 * b * t).sqrt());
            *d = (z * 1000.0).round() as u16;
        }
        frame
    };
    let off = |config: &FusionConfig| {
        let mut fusion = Fusion::new(&sensor, config).unwrap();
        let mut first = None;
        for i in 0..12 {
            first = first.or(fusion.push(&distorted(i)).unwrap().world_from_camera);
        }
        let truth_from_ours = at.compose(&first.unwrap().inverse());
        let mut heights: Vec<f64> =
            fusion.finish().mesh.positions.iter().map(|p| truth_from_ours.transform(p.as_dvec3()).z.abs()).collect();
        heights.sort_by(f64::total_cmp);
        (heights[heights.len() / 2], heights[heights.len() * 9 / 10])
    };
    let (before, after) = (off(&small_config()), off(&known));
    assert!(before.0 > 0.01, "{before:?}");
    assert!(after.0 < 0.002 && after.1 < 0.004, "{before:?} {after:?}");
}

/// More than once around a small object on the floor: the loop closes without a second sheet of surface.
#[test]
fn a_loop_around_a_small_object_closes() {
    let sensor = synthetic::sensor(320, 240);
    let object = SyntheticScene {
        shapes: vec![
            Shape::Floor(0.0),
            Shape::Box(DVec3::new(-0.09, -0.06, 0.0), DVec3::new(0.06, 0.05, 0.1)),
            Shape::Ball(DVec3::new(0.03, -0.02, 0.14), 0.05),
        ],
        mean: 120.0,
        contrast: 60.0,
        cell_m: 0.02,
    };
    let around = |i: usize| {
        let a = i as f64 * std::f64::consts::TAU / 120.0;
        let distance = 0.75 - 0.15 * libm::cos(2.0 * a);
        let from = DVec3::new(distance * libm::sin(a), -distance * libm::cos(a), 0.4 + 0.05 * libm::sin(3.0 * a));
        look_at(from, DVec3::new(0.0, 0.0, 0.05))
    };
    let mut fusion = Fusion::new(&sensor, &small_config()).unwrap();
    let mut first = None;
    let (mut squares, mut worst): (f64, (f64, f64)) = (0.0, (0.0, 0.0));
    for i in 0..=130 {
        let found = fusion.push(&object.look(&sensor, &around(i), i)).unwrap().world_from_camera.expect("lost");
        let first: &Pose = first.get_or_insert(found);
        let e = error((first, &around(0)), (&found, &around(i)));
        squares += e.0 * e.0 / 131.0;
        worst = (e.0.max(worst.0), e.1.max(worst.1));
    }
    let truth_from_ours = around(0).compose(&first.unwrap().inverse());
    let mesh = fusion.finish().mesh;
    let mut off: Vec<f64> =
        mesh.positions.iter().map(|p| object.distance(truth_from_ours.transform(p.as_dvec3()))).collect();
    off.sort_by(f64::total_cmp);
    let share = |q: f64| off[((off.len() - 1) as f64 * q) as usize];
    let (median, most) = (share(0.5), share(0.99));
    println!("loop: RMS {:.4} m, at worst {worst:?}; mesh off by {median:.4} m, 99 % by {most:.4}", squares.sqrt());
    assert!(squares.sqrt() < 0.004 && worst.0 < 0.008 && worst.1 < 0.5, "{} m RMS, {worst:?}", squares.sqrt());
    assert!(off.len() > 10_000 && median < 0.002 && most < 0.006, "{median} m, {most} m");
}

/// A thin plate above the floor, seen from one side: no wall behind its far rim, where no ray passed, and no hole in it. With
/// fine voxels, which a small near scene gets, and with voxels of the set size.
#[test]
fn a_thin_plate_has_no_skirt() {
    let sensor = synthetic::sensor(320, 240);
    let plate = SyntheticScene {
        shapes: vec![Shape::Floor(0.0), Shape::Box(DVec3::new(-0.12, -0.1, 0.06), DVec3::new(0.12, 0.1, 0.064))],
        mean: 120.0,
        contrast: 60.0,
        cell_m: 0.02,
    };
    let along = |i: usize| {
        let a = 0.8 * libm::sin(i as f64 * std::f64::consts::TAU / 120.0);
        let from = DVec3::new(0.42 * libm::sin(a), -0.42 * libm::cos(a), 0.5 + 0.05 * libm::cos(3.0 * a));
        look_at(from, DVec3::new(0.0, 0.0, 0.06))
    };
    for (fine_blocks, voxel_size_m) in [(FusionConfig::default().fine_blocks, 0.0025), (0, 0.005)] {
        let mut fusion = Fusion::new(&sensor, &FusionConfig { fine_blocks, ..small_config() }).unwrap();
        let mut first = None;
        for i in 0..60 {
            let found = fusion.push(&plate.look(&sensor, &along(i), i)).unwrap().world_from_camera.expect("lost");
            first.get_or_insert(found);
        }
        let truth_from_ours = along(0).compose(&first.unwrap().inverse());
        let output = fusion.finish();
        assert_eq!(output.stats.voxel_size_m, f64::from(voxel_size_m as f32));
        let points: Vec<DVec3> =
            output.mesh.positions.iter().map(|p| truth_from_ours.transform(p.as_dvec3())).collect();
        let between = |lo: f64, hi: f64| points.iter().filter(|p| p.z > lo && p.z < hi).count();
        let (skirt, whole) = (between(0.012, 0.05), between(0.055, 0.07));
        println!("{voxel_size_m} m: {skirt} vertices in mid-air, {whole} on the plate");
        assert!((skirt as f64) < 0.006 * whole as f64, "{voxel_size_m} m: {skirt} of {whole}");
        let on_plate = |x: f64, y: f64| points.iter().any(|p| (*p - DVec3::new(x, y, 0.064)).length() < 0.006);
        assert!((-10..=10).all(|x| (-8..=8).all(|y| on_plate(0.01 * f64::from(x), 0.01 * f64::from(y)))));
    }
}

/// With dropped frames, a hand-held rotation in place reaches 8° between frames.
#[test]
fn a_very_fast_rotation_in_place_is_tracked() {
    let sensor = synthetic::sensor(320, 240);
    let room = synthetic::room();
    let start = look_at(DVec3::new(0.1, -0.8, 1.2), DVec3::new(0.0, 1.0, 1.0));
    // Up to 8° a frame about a tilted axis, there and back.
    let truth: Vec<Pose> = (0..40)
        .map(|i| {
            let a = 80.0 * libm::sin(f64::from(i) * 0.1);
            moved(&start, DVec3::ZERO, DVec3::new(0.15 * a, a, 0.1 * a))
        })
        .collect();
    let (metres, degrees) = worst_error(&sensor, &room, &truth);
    assert!(metres < 0.05 && degrees < 1.5, "{metres} m, {degrees}°");
}

/// Pose at `t` frame times of a rotation in place, back and forth, at up to 150° per second.
fn rotating(t: f64) -> Pose {
    let start = look_at(DVec3::new(0.1, -0.8, 1.2), DVec3::new(0.0, 1.0, 1.0));
    let a = 40.0 * (1.0 - libm::cos(0.12 * t));
    moved(&start, DVec3::new(0.001 * a, 0.0, 0.0), DVec3::new(0.2 * a, a, 0.1 * a))
}

/// The rotation, with motion blur of ten pixels.
#[test]
fn a_fast_rotation_is_tracked_with_motion_blur() {
    let sensor = synthetic::sensor(240, 180);
    let room = synthetic::room();
    let (rms, _) = moving_error(&sensor, &room, &rotating, 64, 4, 0.0);
    assert!(rms < 0.02, "{rms} m");
}

/// RMS and largest error of the positions along a path, metres; see `SyntheticScene::look_during`.
fn moving_error(
    sensor: &Sensor,
    scene: &SyntheticScene,
    pose: &dyn Fn(f64) -> Pose,
    frames: usize,
    samples: usize,
    readout: f64,
) -> (f64, f64) {
    let mut fusion = Fusion::new(sensor, &small_config()).unwrap();
    let mut first = None;
    let mut squares = Vec::new();
    for i in 0..frames {
        let frame = scene.look_during(sensor, pose, i, samples, readout);
        let found = fusion.push(&frame).unwrap().world_from_camera.expect("lost");
        let first: &Pose = first.get_or_insert(found);
        squares.push(error((first, &pose(0.0)), (&found, &pose(i as f64))).0.powi(2));
    }
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    (rms, squares.iter().copied().fold(0.0, f64::max).sqrt())
}

/// A rolling shutter shears a rotation of up to 140° per second: the read-out time is estimated from the first frames and
/// compensated (4 and 8 cm without).
#[test]
fn a_rolling_shutter_is_compensated() {
    let sensor = synthetic::sensor(240, 180);
    let room = synthetic::room();
    for (readout, most) in [(0.5, 0.01), (0.9, 0.02)] {
        let (rms, worst) = moving_error(&sensor, &room, &rotating, 80, 1, readout);
        println!("{readout} of the frame time: {rms:.4} m, at worst {worst:.4}");
        assert!(rms < most, "{readout}: {rms} m");
    }
}

/// A full rotation in place at up to 130° per second, with motion blur and rolling shutter, also with every second frame left
/// out.
#[test]
fn a_fast_full_rotation_returns_to_its_start() {
    let sensor = synthetic::sensor(240, 180);
    let room = synthetic::room();
    for (step, most) in [(1.0, 0.03), (2.0, 0.05)] {
        let pose = |t: f64| {
            // Three seconds of rotation, then almost one second at rest.
            let s = (t * step / 100.0).min(1.0);
            let a = s - libm::sin(std::f64::consts::TAU * s) / std::f64::consts::TAU * 0.3;
            let yaw = std::f64::consts::TAU * a;
            let from = DVec3::new(0.1 * libm::sin(yaw), -0.3 - 0.1 * libm::cos(yaw), 1.3);
            look_at(from, from + DVec3::new(libm::sin(yaw), libm::cos(yaw), -0.2 + 0.1 * libm::sin(2.0 * yaw)))
        };
        let frames = (120.0 / step) as usize;
        let (rms, worst) = moving_error(&sensor, &room, &pose, frames, 2, 0.9 / step);
        println!("every {step}: {rms:.4} m, at worst {worst:.4}");
        assert!(rms < most, "every {step}: {rms} m");
    }
}

/// A ball on a floor has the same shape from all sides: a jump around it must not pass as no motion.
#[test]
fn a_jump_around_a_round_object_is_detected() {
    let sensor = synthetic::sensor(320, 240);
    let round = SyntheticScene {
        shapes: vec![Shape::Floor(0.0), Shape::Ball(DVec3::new(0.0, 0.0, 0.1), 0.12)],
        mean: 120.0,
        contrast: 90.0,
        cell_m: 0.04,
    };
    let around = |a: f64| look_at(DVec3::new(0.8 * libm::sin(a), -0.8 * libm::cos(a), 0.5), DVec3::new(0.0, 0.0, 0.05));
    let mut fusion = Fusion::new(&sensor, &small_config()).unwrap();
    let mut first = None;
    for i in 0..40 {
        let away = (15..25).contains(&i);
        let pose = around(0.01 * i as f64 + if away { 1.8 } else { 0.0 });
        let report = fusion.push(&round.look(&sensor, &pose, i)).unwrap();
        assert_eq!(report.tracking == Tracking::Lost, away, "frame {i}");
        let Some(found) = report.world_from_camera else { continue };
        let first: &Pose = first.get_or_insert(found);
        let e = error((first, &around(0.0)), (&found, &pose));
        assert!(e.0 < 0.02 && e.1 < 1.5, "frame {i}: fused in a wrong place: {e:?}");
    }
}

/// Half a second of missing frames while the camera circles the scene: the motion is extrapolated.
#[test]
fn a_gap_in_the_recording_is_bridged() {
    let sensor = synthetic::sensor(320, 240);
    let around = |i: usize| {
        let a = 0.03 * i as f64;
        look_at(DVec3::new(1.1 * libm::sin(a), -1.1 * libm::cos(a), 0.7), DVec3::new(0.0, 0.0, 0.1))
    };
    let mut fusion = Fusion::new(&sensor, &small_config()).unwrap();
    let mut first = None;
    for i in (0..12).chain(26..38) {
        let found = fusion.push(&desk().look(&sensor, &around(i), i)).unwrap().world_from_camera.expect("lost");
        let first: &Pose = first.get_or_insert(found);
        let e = error((first, &around(0)), (&found, &around(i)));
        assert!(e.0 < 0.01 && e.1 < 0.7, "frame {i}: {e:?}");
    }
}

#[test]
fn a_room_fits_a_small_pool_by_coarsening() {
    let sensor = synthetic::sensor(160, 120);
    let room = SyntheticScene {
        shapes: vec![
            Shape::Room(DVec3::new(-2.5, -2.0, 0.0), DVec3::new(2.5, 2.0, 2.5)),
            Shape::Box(DVec3::new(0.5, 0.6, 0.0), DVec3::new(1.5, 1.4, 0.8)),
        ],
        mean: 120.0,
        contrast: 80.0,
        cell_m: 0.15,
    };
    let config = FusionConfig { pool_blocks: 4096, ..FusionConfig::default() };
    let mut fusion = Fusion::new(&sensor, &config).unwrap();
    let mut coarsened = 0;
    let mut errors = Vec::new();
    let mut first = None;
    for i in 0..240 {
        let a = f64::from(i) * std::f64::consts::TAU / 240.0;
        let from = DVec3::new(0.3 * libm::cos(a), 0.3 * libm::sin(a), 1.2);
        let pose = look_at(from, from + DVec3::new(libm::cos(a), libm::sin(a), -0.25));
        let report = fusion.push(&room.look(&sensor, &pose, i as usize)).unwrap();
        assert!(report.blocks_used <= 4096);
        coarsened += u32::from(report.coarsened);
        let found = report.world_from_camera.expect("lost in the room");
        let first = first.get_or_insert((found, pose));
        errors.push(error((&first.0, &first.1), (&found, &pose)).0);
    }
    let output = fusion.finish();
    assert!(coarsened >= 1 && output.stats.coarsenings == coarsened);
    assert!((output.stats.voxel_size_m - 0.005 * f64::from(1 << coarsened)).abs() < 1e-6);
    assert!(errors.iter().all(|e| *e < 0.08), "{:?}", errors.iter().copied().fold(0.0, f64::max));
    assert!(output.mesh.triangles.len() > 1000);
}

#[test]
fn a_camera_that_hardly_moves_gives_one_keyframe() {
    let sensor = synthetic::sensor(320, 240);
    let at = look_at(DVec3::new(0.2, -1.1, 0.7), DVec3::new(0.0, 0.0, 0.1));
    let mut fusion = Fusion::new(&sensor, &small_config()).unwrap();
    for i in 0..20 {
        let pose = moved(&at, DVec3::new(0.001 * i as f64, 0.0, 0.0), DVec3::ZERO);
        fusion.push(&desk().look(&sensor, &pose, i)).unwrap();
    }
    let output = fusion.finish();
    assert_eq!(output.keyframes.len(), 1);
    assert!(output.stats.keyframe_coverage > 0.97);
    assert!(output.mesh.triangles.len() > 1000);
}
