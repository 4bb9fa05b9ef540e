//! The bundled data are whole, agree with their truth, and stay small.
#![allow(clippy::unwrap_used)]

use recordings::import::trajectory::read_trajectory;
use recordings::recording::{Event, RecordingKind, RecordingReader};
use recordings::types::Pose;
use std::path::{Path, PathBuf};
use tests::synth::{render, tabletop};

fn data() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../recordings/data")
}

fn size(path: &Path) -> u64 {
    if path.is_file() {
        return path.metadata().unwrap().len();
    }
    std::fs::read_dir(path).unwrap().map(|entry| size(&entry.unwrap().path())).sum()
}

/// Colour stamps in nanoseconds, number of depth frames, smallest share of pixels with depth.
fn contents(name: &str, width: u32) -> (Vec<i64>, usize, f64) {
    let mut reader = RecordingReader::open(&data().join(name)).unwrap();
    assert_eq!(reader.kind(), RecordingKind::Frames);
    let sensor = reader.sensor().clone();
    assert_eq!((sensor.color.intrinsics.width, sensor.depth.intrinsics.width), (width, width));
    assert!(sensor.depth_registered);
    let (mut stamps, mut depth_frames, mut least) = (Vec::new(), 0, 1.0f64);
    while let Some(event) = reader.next_event().unwrap() {
        match event {
            Event::Color(frame) => {
                let rgb = frame.decode().unwrap();
                assert_eq!((rgb.width, rgb.height), (width, width * 3 / 4));
                stamps.push(frame.timestamp_ns);
            }
            Event::Depth(frame) => {
                assert_eq!((frame.width, frame.height), (width, width * 3 / 4));
                let seen = frame.depth.iter().filter(|d| **d > 0).count() as f64 / frame.depth.len() as f64;
                (depth_frames, least) = (depth_frames + 1, least.min(seen));
            }
            Event::Accelerometer(reading) => {
                let size = reading.acceleration.iter().map(|a| a * a).sum::<f32>().sqrt();
                assert!((size - 9.81).abs() < 0.5, "at rest a sensor feels {size} m/s²");
            }
            Event::Packet(_) => panic!("{name}: a packet among frames"),
        }
    }
    (stamps, depth_frames, least)
}

#[test]
fn the_bundled_data_stay_within_ten_megabytes() {
    let bytes = size(&data());
    assert!(bytes <= 10_000_000, "recordings/data holds {bytes} bytes");
}

#[test]
fn the_tabletop_recording_is_whole_and_its_truth_fits() {
    let (stamps, depth_frames, least) = contents("tabletop.lrec", 640);
    assert_eq!((stamps.len(), depth_frames), (tabletop::FRAMES as usize, tabletop::FRAMES as usize));
    assert!(least > 0.4, "a depth frame is only {least} full");

    let truth = data().join("tabletop_truth");
    let trajectory = read_trajectory(&truth.join("trajectory.txt")).unwrap();
    assert_eq!(trajectory.len(), stamps.len());
    let arc = tabletop::arc();
    for ((time, truth), stamp) in trajectory.iter().zip(&stamps) {
        assert_eq!(time, stamp);
        let pose: Pose = arc.pose((stamp - stamps[0]) as f64 * 1e-9);
        assert!(pose.translation.distance(truth.translation) < 1e-6, "the path has changed: make the data again");
    }

    let exposures: serde_json::Value =
        serde_json::from_slice(&std::fs::read(truth.join("exposures.json")).unwrap()).unwrap();
    let gains: Vec<f64> = exposures["gain"].as_array().unwrap().iter().map(|g| g.as_f64().unwrap()).collect();
    assert_eq!(gains.len(), stamps.len());
    assert!(gains.iter().all(|g| (0.59..1.61).contains(&(g / gains[0]))));
    let light: serde_json::Value =
        serde_json::from_slice(&std::fs::read(truth.join("lighting_sh.json")).unwrap()).unwrap();
    assert_eq!(light["coefficients"].as_array().unwrap().len(), 81);
    let materials: serde_json::Value =
        serde_json::from_slice(&std::fs::read(truth.join("materials.json")).unwrap()).unwrap();
    let materials = materials["materials"].as_array().unwrap();
    assert_eq!(materials.len(), tabletop::tabletop(0.012).parts.len());
    assert!(materials.iter().all(|m| m["vertices"].as_u64().unwrap() > 100));
    assert!(truth.join("mesh.ply").is_file());
}

#[test]
fn the_tiny_recording_is_whole() {
    let (stamps, depth_frames, least) = contents("tiny.lrec", 160);
    assert_eq!((stamps.len(), depth_frames), (6, 6));
    assert!(least > 0.4, "a depth frame is only {least} full");
    assert!(size(&data().join("tiny.lrec")) <= 300_000);
}

#[test]
fn depth_shows_the_scene_from_the_true_poses() {
    let scene = tabletop::tabletop(0.008);
    let arc = tabletop::arc();
    let mut reader = RecordingReader::open(&data().join("tabletop.lrec")).unwrap();
    let camera = reader.sensor().depth.intrinsics;
    let (mut start, mut index) = (None, 0);
    while let Some(event) = reader.next_event().unwrap() {
        if let Event::Color(color) = &event {
            start.get_or_insert(color.timestamp_ns);
        }
        let (Event::Depth(frame), Some(start)) = (event, start) else { continue };
        index += 1;
        if index % 28 != 1 {
            continue;
        }
        let pose = arc.pose((frame.timestamp_ns - start) as f64 * 1e-9);
        let truth = render::depth(&scene, &camera, &pose, 2);
        let mut errors: Vec<f64> = frame
            .depth
            .iter()
            .zip(&truth.data)
            .filter(|(d, t)| **d > 0 && **t > 0.0)
            .map(|(d, t)| (f64::from(*d) * 1e-3 - f64::from(*t)).abs())
            .collect();
        errors.sort_by(f64::total_cmp);
        let (median, high) = (errors[errors.len() / 2], errors[errors.len() * 95 / 100]);
        assert!(median < 0.0016 && high < 0.006, "frame {index}: median {median} m, 95 % {high} m");
    }
    assert_eq!(index, 84);
}
