//! `estimate --reference`: the albedo at a pixel is what the user says.

#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::{arg, fails, json, ok};
use estimator::numerics::robust::median;
use estimator::rays::RayScene;
use glam::Vec3;
use recordings::result::Estimate;
use std::path::{Path, PathBuf};

/// The small scan that comes with the repository.
fn tiny_scan() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../recordings/data/tiny.lscan")
}

/// Median albedo of the surface that a keyframe shows up to two pixels around a pixel.
fn albedo_around(result: &Path, keyframe: usize, x: f64, y: f64) -> Vec3 {
    let result = Estimate::read(result).unwrap();
    let from = &result.keyframes[keyframe];
    let scene = RayScene::new(&result.mesh);
    let at = |k: u32| {
        let (x, y) = (x + f64::from(k % 5) - 2.0, y + f64::from(k / 5) - 2.0);
        let direction = (from.world_from_camera.rotation * from.camera.unproject(x, y)).normalize().as_vec3();
        let hit = scene.closest_hit(from.world_from_camera.translation.as_vec3(), direction).unwrap();
        let corners = result.mesh.triangles[hit.triangle as usize].map(|i| result.albedo[i as usize]);
        corners[0] * (1.0 - hit.u - hit.v) + corners[1] * hit.u + corners[2] * hit.v
    };
    let all: Vec<Vec3> = (0..25).map(at).collect();
    Vec3::from_array([0, 1, 2].map(|c| median(all.iter().map(|a| a[c])).unwrap()))
}

/// Estimates `scan` and checks the albedo at the reference.
fn holds(scan: &Path, [keyframe, x, y]: [u32; 3], said: &str, albedo: Vec3) {
    let dir = tempfile::tempdir().unwrap();
    let output = dir.path().join("out.lres");
    let reference = format!("keyframe:{keyframe}:{x},{y}={said}");
    ok(&["estimate", &arg(scan), "--rounds", "1", "--reference", &reference, "-o", &arg(&output)]);
    let found = albedo_around(&output, keyframe as usize, f64::from(x), f64::from(y));
    assert!((found / albedo - 1.0).abs().max_element() < 0.04, "{reference}: {found}");
    let shown = json(&["--json", "inspect", &arg(&output)]);
    let decisions = shown["decisions"].as_array().unwrap();
    let scale = decisions.iter().find(|d| d["name"] == "albedo scale").unwrap();
    assert!(scale["choice"].as_str().unwrap().starts_with("by the reference"), "{scale}");
    assert_eq!(shown["albedo_scale_rule"], scale["choice"]);
}

#[test]
fn a_grey_or_coloured_thing_in_a_picture_fixes_the_albedo() {
    let scan = tiny_scan();
    holds(&scan, [0, 40, 60], "0.3", Vec3::splat(0.3));
    holds(&scan, [0, 40, 60], "0.2,0.3,0.4", Vec3::new(0.2, 0.3, 0.4));
}

#[test]
fn a_reference_that_shows_nothing_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let output = dir.path().join("out.lres");
    let scan = tiny_scan();
    let refused = |code: i32, reference: &str| {
        fails(code, &["estimate", &arg(&scan), "--rounds", "1", "--reference", reference, "-o", &arg(&output)])
    };
    assert!(refused(3, "keyframe:99:10,10=0.9").contains("there is no keyframe 99"));
    assert!(refused(3, "keyframe:0:5000,10=0.9").contains("outside keyframe 0"));
    assert!(refused(2, "keyframe:0:10=0.9").contains("must be keyframe:N:X,Y=ALBEDO"));
    assert!(refused(2, "keyframe:0:10,10=1.4").contains("from 0.01 to 1"));
    assert!(!output.exists());
}

/// A lamp beside the scene: the richer models of light keep to the reference, too.
#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: truth_near/lamp")]
fn a_reference_holds_where_light_is_not_distant() {
    let dir = tempfile::tempdir().unwrap();
    let scan = dir.path().join("lamp.lscan");
    ok(&["import", "photos", &arg(tests::shared().join("truth_near/lamp")), "-o", &arg(&scan)]);
    holds(&scan, [0, 320, 240], "0.5", Vec3::splat(0.5));
}
