use super::SMALL;
use crate::synth::color_sensor::{AutoExposure, ColorSensor, Gain};
use crate::synth::depth_sensor::DepthSensor;
use crate::synth::environment::Environment;
use crate::synth::kinect::Kinect;
use crate::synth::path::look_at;
use crate::synth::random::Rng;
use crate::synth::render::{self, Image, Shading};
use crate::synth::scene::Scene;
use crate::synth::scenes::{cuboid, matte, rectangle, room, room_tour, wall};
use crate::synth::{cache, tabletop};
use glam::{DVec3, Vec3};
use recordings::types::Pose;

#[test]
fn depth_readings_are_steps_of_disparity_with_the_published_noise() {
    let sensor = DepthSensor::default();
    let mut rng = Rng::new(4, 4);
    for z in [0.6, 1.0, 2.0, 3.5] {
        let readings: Vec<f64> =
            (0..20_000).map(|_| f64::from(sensor.read(z, f64::from(rng.normal()))) * sensor.unit_m).collect();
        for depth in &readings {
            let steps = sensor.focal_px * sensor.baseline_m / depth * sensor.steps_per_px;
            // A millimetre of rounding, in steps.
            let slack = 0.5 * sensor.unit_m * steps / depth + 1e-6;
            assert!((steps - steps.round()).abs() <= slack, "{depth} m is {steps} steps");
        }
        let mean = readings.iter().sum::<f64>() / readings.len() as f64;
        let deviation = (readings.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / readings.len() as f64).sqrt();
        let expected = DepthSensor::deviation_m(z);
        assert!((mean - z).abs() < 0.1 * expected + 0.0002, "{z} m reads {mean}");
        assert!((deviation / expected - 1.0).abs() < 0.08, "{z} m: σ {deviation}, not {expected}");
    }
    assert_eq!((sensor.read(0.44, 0.0), sensor.read(4.1, 0.0)), (0, 0));
}

#[test]
fn depth_noise_of_a_wall_has_unit_patches_and_the_right_spread() {
    let mut kinect = Kinect::new(2, 7, 2);
    let pose = look_at(DVec3::new(0.0, -1.5, 0.0), DVec3::ZERO, 0.0);
    kinect.samples = 1;
    let depth = kinect.frame(&wall(true), Shading::Flat, 0, &|_| pose).depth.depth;
    let seen: Vec<f64> = depth.iter().filter(|d| **d > 0).map(|d| f64::from(*d) * 1e-3).collect();
    assert!(seen.len() as f64 > 0.99 * depth.len() as f64);
    let mean = seen.iter().sum::<f64>() / seen.len() as f64;
    let deviation = (seen.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / seen.len() as f64).sqrt();
    assert!(
        (mean - 1.5).abs() < 0.001 && (deviation / DepthSensor::deviation_m(1.5) - 1.0).abs() < 0.1,
        "{mean} {deviation}"
    );
}

#[test]
fn the_projector_on_the_right_throws_its_shadow_to_the_left() {
    let mut parts =
        vec![matte("back", rectangle(Vec3::new(-1.0, 0.5, -1.0), Vec3::X * 2.0, Vec3::Z * 2.0, 0.5), |_| Vec3::ONE)];
    let block = cuboid(Vec3::new(-0.1, -0.05, -0.1), Vec3::new(0.1, 0.05, 0.1), 0.5, false);
    parts.push(matte("block", block, |_| Vec3::ONE));
    let scene = Scene::new(parts, Environment::uniform(Vec3::ONE));
    let camera = Kinect::new(2, 1, 1).camera;
    let pose = look_at(DVec3::new(0.0, -0.8, 0.0), DVec3::ZERO, 0.0);
    let depth = DepthSensor::default().frame(&scene, &camera, &pose, 0, 1, 2).depth;
    let row = &depth[120 * 320..121 * 320];
    let half = 0.1 / 0.75 * camera.fx;
    let (left, right) = ((camera.cx - half) as usize, (camera.cx + half) as usize);
    let holes = |range: std::ops::Range<usize>| row[range].iter().filter(|d| **d == 0).count();
    // f·b (1/z_front − 1/z_back) pixels of shadow, at this camera's focal length.
    let expected = camera.fx * 0.075 * (1.0 / 0.75 - 1.0 / 1.3);
    let found = holes(left.saturating_sub(30)..left + 2);
    assert!((found as f64 - expected).abs() < 3.0, "{found} holes on the left, not {expected}");
    assert!(holes(right..right + 30) <= 2 && holes(left + 4..right - 4) == 0);
}

#[test]
fn a_frame_is_the_same_on_any_number_of_threads() {
    let scene = tabletop::tabletop(0.012);
    let frames = [1, 2, 3].map(|threads| {
        let light = cache::diffuse_light(&scene, 4, 1, threads);
        let mut kinect = Kinect::new(8, 3, threads);
        kinect.samples = 2;
        let arc = tabletop::arc();
        let frame = kinect.frame(&scene, Shading::Cached(&light), 5, &|t| arc.pose(t));
        (light, frame.rgb, frame.depth, frame.gain)
    });
    assert!(frames[0] == frames[1] && frames[0] == frames[2]);
    assert!(frames[0].2.depth.iter().filter(|d| **d > 0).count() > 1000);
}

#[test]
fn the_hand_moves_smoothly_and_keeps_the_table_in_view() {
    let arc = tabletop::arc();
    let poses: Vec<Pose> = (0..tabletop::FRAMES).map(|k| arc.pose(f64::from(k) / 15.0)).collect();
    for pair in poses.windows(2) {
        let step = pair[0].inverse().compose(&pair[1]);
        let angle = 2.0 * libm::acos(step.rotation.w.abs().min(1.0)).to_degrees();
        assert!(step.translation.length() < 0.021, "{} m in one frame", step.translation.length());
        assert!(angle < 2.05, "{angle}° in one frame");
    }
    for pose in &poses {
        let centre = pose.inverse().transform(arc.target);
        assert!(centre.z > 0.6 && (centre.x / centre.z).abs() < 0.05 && (centre.y / centre.z).abs() < 0.05);
        assert!((pose.rotation * DVec3::Y).z < -0.5, "image-up is not up");
    }
    let (a, b) = (poses[0].translation - arc.target, poses[poses.len() - 1].translation - arc.target);
    let turned = a.truncate().angle_to(b.truncate()).abs().to_degrees();
    assert!(turned > 120.0, "the arc spans {turned}°");
}

#[test]
fn the_room_is_closed_and_within_reach() {
    let scene = room();
    for k in 0..8 {
        let pose = room_tour(f64::from(k), 8.0);
        let depth = render::depth(&scene, &SMALL, &pose, 2);
        assert!(depth.data.iter().all(|d| (0.4..4.6).contains(d)), "view {k}: something is too near or far");
    }
}

#[test]
fn the_color_sensor_adds_the_noise_it_states_and_steers_its_gain() {
    let picture = Image { width: 200, height: 100, data: vec![Vec3::splat(2.0); 20_000] };
    let sensor = ColorSensor { hunting: 0.0, ..ColorSensor::default() };
    let gain = Gain { gain: 0.1, white_balance: Vec3::ONE };
    let rgb = sensor.expose(&picture, gain, 1);
    let linear: Vec<f64> = rgb
        .data
        .iter()
        .map(|v| {
            let s = f64::from(*v) / 255.0;
            if s <= 0.040_45 { s / 12.92 } else { libm::pow((s + 0.055) / 1.055, 2.4) }
        })
        .collect();
    let mean = linear.iter().sum::<f64>() / linear.len() as f64;
    let variance = linear.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / linear.len() as f64;
    let expected = 0.2 / 6000.0 + 0.0012 * 0.0012 + (1.0 / (255.0 * 1.12f64)).powi(2) / 12.0;
    assert!((mean - 0.2).abs() < 0.001 && (variance / expected - 1.0).abs() < 0.1, "{mean} {variance} {expected}");

    let mut exposure = AutoExposure::default();
    let mut rng = Rng::new(1, 1);
    let first = exposure.next(&sensor, &picture, 0.0, &mut rng).gain;
    assert!((first * 2.0 / sensor.target_mean - 1.0).abs() < 0.05, "gain {first}");
    let dark = Image { data: vec![Vec3::splat(0.5); 20_000], ..picture };
    let gains: Vec<f32> =
        (1..60).map(|k| exposure.next(&sensor, &dark, f64::from(k) / 15.0, &mut rng).gain / first).collect();
    assert!(gains[0] < 1.3 && gains.iter().all(|g| *g <= 1.6 + 1e-5), "steps at once, or out of range");
    assert!(gains[58] > 1.55, "does not follow the light: {}", gains[58]);
}
