//! Memory of the extraction beside the volume. A test binary of its own, since it reads the memory of the whole process.

#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used)]

mod synthetic;

use firmware_config::FusionConfig;
use fusion::Fusion;
use glam::DVec3;
use synthetic::{Shape, SyntheticScene, look_at};

/// Bytes per vertex in the memory plan, and bytes for the current layers and the choice of keyframes.
const BYTES_A_VERTEX: u64 = 64;
const BESIDE: u64 = 6 << 20;

fn bytes(field: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find_map(|l| l.strip_prefix(field)).unwrap();
    line.trim().strip_suffix("kB").unwrap().trim().parse::<u64>().unwrap() * 1024
}

/// Extraction of a room stays within the memory plan: it holds no second copy of the mesh.
#[test]
fn extraction_holds_the_mesh_once() {
    let sensor = synthetic::sensor(320, 240);
    let room = SyntheticScene {
        shapes: vec![Shape::Room(DVec3::new(-1.5, -1.5, 0.0), DVec3::new(1.5, 1.5, 2.2))],
        mean: 120.0,
        contrast: 80.0,
        cell_m: 0.12,
    };
    let config = FusionConfig { min_weight: 0.5, ..FusionConfig::default() };
    let mut fusion = Fusion::new(&sensor, &config).unwrap();
    for i in 0..30 {
        let a = f64::from(i) * std::f64::consts::TAU / 90.0;
        let towards = DVec3::new(libm::cos(a), libm::sin(a), -0.2 - 0.3 * libm::sin(5.0 * a));
        let from = DVec3::new(0.0, 0.0, 1.1);
        assert!(
            fusion
                .push(&room.look(&sensor, &look_at(from, from + towards), i as usize))
                .unwrap()
                .world_from_camera
                .is_some()
        );
    }
    let before = bytes("VmRSS:");
    // Resets the peak.
    std::fs::write("/proc/self/clear_refs", "5").unwrap();
    let mesh = fusion.finish().mesh;
    let grown = bytes("VmHWM:").saturating_sub(before);
    let vertices = mesh.positions.len() as u64;
    println!("{vertices} vertices, {} triangles: {grown} bytes at most", mesh.triangles.len());
    assert!(vertices > 250_000, "the mesh is too small for the test: {vertices}");
    let held = 24 * vertices + 12 * mesh.triangles.len() as u64;
    assert!(grown > held / 2, "the peak was not measured");
    assert!(grown < BYTES_A_VERTEX * vertices + BESIDE, "{} bytes a vertex", grown / vertices);
}
