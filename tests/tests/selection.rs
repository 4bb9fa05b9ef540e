//! The model that a scene requires, and no more: each scene of these gets what its evidence asks for.

#![allow(clippy::expect_used, reason = "these are tests")]

use estimator::Options;
use estimator::estimate;
use firmware_config::EstimatorConfig;
use glam::{DVec3, Vec3};
use recordings::decision::{Decision, TransferLevel, Warning};
use recordings::result::Estimate;
use recordings::scan::Scan;
use std::time::Duration;
use tests::scans::{globe, joined, lit, looking, sheet};

fn run(scan: &Scan) -> Estimate {
    let options = Options { budget: Duration::from_secs(600), rounds: Some(1), reference: None, memory_mb: None };
    let e = estimate(scan, &EstimatorConfig::default(), &options, &()).expect("a result");
    for d in e.decisions.iter().map(Decision::text) {
        println!("{}: {} · {} · cost: {} · next: {}", d.name, d.choice, d.evidence, d.cost, d.next_level);
        assert!(!d.choice.is_empty() && !d.evidence.is_empty() && !d.cost.is_empty(), "{d:?}");
    }
    println!("{:?}", e.warnings);
    e
}

fn is_near_light(warning: &Warning) -> bool {
    matches!(warning, Warning::LightNotDistant(_))
}

/// Irradiance over π under soft light: brighter from above and from one side.
fn soft(n: Vec3) -> f32 {
    1.0 + 0.5 * n.z + 0.3 * n.x
}

#[test]
fn a_flat_wall_is_three_bands_at_most_and_says_what_it_cannot_see() {
    let mesh = sheet(48, Vec3::new(-0.5, -0.5, 0.0), Vec3::X, Vec3::Y);
    let poses = [0.0, 0.3, -0.3, 0.6].map(|x| looking(DVec3::new(x, 0.2, 1.2), DVec3::ZERO));
    let e = run(&lit(mesh, &poses, |_| Vec3::new(0.5, 0.4, 0.3)));
    assert!(e.light.bands() <= 3, "{} bands", e.light.bands());
    assert_ne!(e.transfer, TransferLevel::Gi);
    assert!(e.segments.iter().all(|s| s.w_s == 0.0));
    assert!(e.warnings.iter().any(|w| matches!(w, Warning::UnseenLight { .. })), "{:?}", e.warnings);
    assert_eq!(e.light.standard_deviation.len(), e.light.coefficients.len());
    assert!(!e.warnings.iter().any(is_near_light), "{:?}", e.warnings);
}

#[test]
fn a_convex_object_under_soft_light_is_cheap() {
    let mesh = globe(40, 0.5, 1.0);
    let normals = mesh.normals.clone();
    let ring = |v: i32| {
        let angle = std::f64::consts::TAU * f64::from(v) / 8.0;
        let height = if v % 2 == 0 { 0.9 } else { -0.9 };
        looking(DVec3::new(1.5 * libm::cos(angle), 1.5 * libm::sin(angle), height), DVec3::ZERO)
    };
    let poses: Vec<_> = (0..8).map(ring).collect();
    let e = run(&lit(mesh, &poses, |i| Vec3::splat(0.5 * soft(normals[i]))));
    assert!(e.light.bands() <= 3, "{} bands", e.light.bands());
    assert!(e.transfer != TransferLevel::Gi, "{}", e.transfer);
    assert!(e.segments.iter().all(|s| s.w_s == 0.0), "a matte object has no gloss");
}

/// Three white walls that meet: their light is bounced light in good part.
#[test]
fn a_white_corner_has_bounces() {
    let walls = [
        sheet(28, Vec3::ZERO, Vec3::X, Vec3::Y),
        sheet(28, Vec3::ZERO, Vec3::Y, Vec3::Z),
        sheet(28, Vec3::ZERO, Vec3::Z, Vec3::X),
    ];
    let mesh = joined(&walls);
    let toward = |x, y, z| looking(DVec3::new(x, y, z), DVec3::splat(0.35));
    let poses = [toward(2.0, 1.6, 1.4), toward(1.4, 2.0, 1.6), toward(1.6, 1.4, 2.0), toward(1.9, 1.9, 1.0)];
    // Brighter away from the corner, as an open corner is.
    let positions = mesh.positions.clone();
    let e = run(&lit(mesh, &poses, |i| Vec3::splat(0.5 + 0.25 * positions[i].length())));
    assert_eq!(e.transfer, TransferLevel::Gi);
    let bounces = e.decisions.iter().find_map(|d| match d {
        Decision::Transfer { bounced, .. } => bounced.map(|b| b.bounces),
        _ => None,
    });
    assert!(bounces >= Some(3), "{:?}", e.decisions);
}

/// A table of 1 m with boxes on it, from six sides.
fn table(light: impl Fn(Vec3, Vec3) -> f32) -> Scan {
    let block = |x: f32, y: f32, s: f32, h: f32| {
        let (a, b) = (Vec3::new(x, y, 0.0), Vec3::new(x + s, y + s, h));
        let (u, v, w) = (Vec3::X * s, Vec3::Y * s, Vec3::Z * h);
        joined(&[
            sheet(10, a + w, u, v),
            sheet(10, a, u, w),
            sheet(10, a, w, v),
            sheet(10, b, -v, -w),
            sheet(10, b, -w, -u),
        ])
    };
    let top = sheet(60, Vec3::new(-0.5, -0.5, 0.0), Vec3::X, Vec3::Y);
    let mesh =
        joined(&[top, block(-0.35, -0.3, 0.14, 0.12), block(0.2, 0.15, 0.16, 0.1), block(0.15, -0.35, 0.12, 0.16)]);
    let (positions, normals) = (mesh.positions.clone(), mesh.normals.clone());
    let poses: Vec<_> = (0..6)
        .map(|v| {
            let angle = std::f64::consts::TAU * f64::from(v) / 6.0;
            looking(DVec3::new(1.1 * libm::cos(angle), 1.1 * libm::sin(angle), 0.9), DVec3::ZERO)
        })
        .collect();
    lit(mesh, &poses, |i| Vec3::splat(0.5 * light(positions[i], normals[i])))
}

#[test]
fn a_lamp_on_the_table_is_not_distant() {
    let lamp = Vec3::new(-0.1, 0.2, 0.35);
    let e = run(&table(|p, n| {
        let to = lamp - p;
        0.15 + 0.2 * n.dot(to.normalize()).max(0.0) / to.length_squared()
    }));
    assert!(e.warnings.iter().any(is_near_light), "{:?}", e.warnings);
}

#[test]
fn far_light_stays_silent() {
    let sun = Vec3::new(0.5, -0.3, 0.8).normalize();
    let e = run(&table(|_, n| 0.4 + 1.5 * n.dot(sun).max(0.0)));
    assert!(!e.warnings.iter().any(is_near_light), "{:?}", e.warnings);
}
