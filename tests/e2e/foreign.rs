//! What is exported, opened by programs that are not ours: the Khronos validator, three.js, Blender, trimesh, Open3D,
//! OpenEXR's tools, COLMAP, and a browser. Where such a program is not installed its test prints that it was skipped, and
//! why; `.ci/run` installs them all but Open3D, which is 400 MB.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "these are tests")]

mod common;

use common::{arg, ok, python, scanned_table, text, works};
use recordings::local_light::{Lamp, LightModel, LocalLight};
use recordings::result::Estimate;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

/// A lamp that is put into the result: finding lamps is tested elsewhere.
const LAMP: Lamp = Lamp { center: [0.1, -0.2, 0.5], radius_m: 0.05, radiance: [80.0, 60.0, 40.0] };

/// A published scan and its exports.
struct Exported {
    dir: PathBuf,
    scan: PathBuf,
    estimate: Estimate,
}

static EXPORTED: OnceLock<Exported> = OnceLock::new();

fn exported() -> &'static Exported {
    EXPORTED.get_or_init(|| {
        let (dir, scan) = scanned_table("foreign");
        let mut estimate = Estimate::read(&scan.join("result.lres")).unwrap();
        estimate.local_light = LocalLight { model: LightModel::Lamps, lamps: vec![LAMP], ..LocalLight::default() };
        let result = arg(dir.join("lamp.lres"));
        estimate.write(Path::new(&result)).unwrap();
        std::fs::copy(scan.join("scan.lscan"), dir.join("lamp.lscan")).unwrap();
        for (form, name) in [
            ("glb", "result.glb"),
            ("ply", "result.ply"),
            ("hdr", "light.hdr"),
            ("exr", "light.exr"),
            ("colmap", "colmap"),
            ("nerf", "nerf"),
        ] {
            ok(&["export", &result, "--to", form, "-o", &arg(dir.join(name))]);
        }
        Exported { dir, scan, estimate }
    })
}

/// The script of this folder's neighbour `foreign`.
fn script(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/foreign").join(name)
}

/// Node, if it finds the npm package; otherwise says why not.
fn node(package: &str) -> Option<Command> {
    let found = works(Command::new("node").args(["-e", &format!("require.resolve('{package}')")]));
    if !found {
        eprintln!("skipped: node does not find the npm package {package} (NODE_PATH names the folder of packages)");
    }
    found.then(|| Command::new("node"))
}

fn accepted(output: &Output) -> serde_json::Value {
    assert!(output.status.success(), "{}{}", text(&output.stdout), text(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap_or_default()
}

#[test]
fn khronos_validator() {
    let Some(mut node) = node("gltf-validator") else { return };
    let glb = exported().dir.join("result.glb");
    accepted(&node.arg(script("gltf.cjs")).arg(glb).output().unwrap());
}

#[test]
fn three_js() {
    let Some(mut node) = node("three") else { return };
    let e = exported();
    let found = accepted(&node.arg(script("three.cjs")).arg(&e.dir).output().unwrap());
    // Vertices on seams are there once per chart.
    assert!(found["vertices"][0].as_u64() > Some(e.estimate.mesh.positions.len() as u64), "{found}");
    assert_eq!(found["triangles"], e.estimate.mesh.triangles.len());
    assert_eq!(found["cameras"], e.estimate.keyframes.len());
    // Candela: L π r² of the brightest channel; +Z up here is +Y up there.
    let lamp = &found["lamps"][0];
    assert!(is_near(&lamp["place"], [0.1, 0.5, 0.2]) && is_near(&lamp["color"], [1.0, 0.75, 0.5]), "{lamp}");
    assert!((lamp["intensity"].as_f64().unwrap() - 80.0 * std::f64::consts::PI * 0.0025).abs() < 1e-6, "{lamp}");
    let [width, height] = texture_size(e);
    assert_eq!((&found["textured"], &found["sizes"]), (&true.into(), &[format!("{width}x{height}")].into()));
    assert_eq!((&found["hdr"], &found["exr"]), (&[512, 256].into(), &[512, 256].into()));
}

fn texture_size(e: &Exported) -> [u32; 2] {
    e.estimate.texture.as_ref().map(|t| [t.width, t.height]).unwrap()
}

/// Mesh and height as a Python module reads them from GLB and PLY.
fn read_by(module: &str) {
    let Some(mut python) = python(module) else { return };
    let e = exported();
    let found = accepted(&python.arg(script("read.py")).arg(module).arg(&e.dir).output().unwrap());
    let mesh = &e.estimate.mesh;
    assert_eq!(
        (found["ply_vertices"].as_u64(), found["ply_triangles"].as_u64()),
        (Some(mesh.positions.len() as u64), Some(mesh.triangles.len() as u64))
    );
    assert_eq!(found["glb_triangles"], mesh.triangles.len());
    // +Z up here is +Y up there.
    for up in ["glb_up", "ply_up"] {
        assert!((found[up].as_f64().unwrap() - top(mesh)).abs() < 1e-4, "{found}");
    }
}

fn top(mesh: &recordings::types::Mesh) -> f64 {
    mesh.positions.iter().map(|p| f64::from(p.z)).fold(f64::NEG_INFINITY, f64::max)
}

#[test]
fn trimesh() {
    read_by("trimesh");
}

#[test]
fn open3d() {
    read_by("open3d");
}

#[test]
fn blender() {
    if !works(Command::new("blender").arg("--version")) {
        eprintln!("skipped: blender is not on the PATH");
        return;
    }
    let e = exported();
    let run = ["-b", "--factory-startup", "--python-exit-code", "1", "--python"];
    let output = Command::new("blender").args(run).arg(script("blender.py")).arg("--").arg(&e.dir).output().unwrap();
    let said = text(&output.stdout);
    let found =
        said.lines().find_map(|l| l.strip_prefix("found ")).unwrap_or_else(|| panic!("{said}{}", text(&output.stderr)));
    let found: serde_json::Value = serde_json::from_str(found).unwrap();
    assert_eq!(found["triangles"], e.estimate.mesh.triangles.len());
    assert_eq!(found["cameras"], e.estimate.keyframes.len());
    assert_eq!((&found["coordinates"], &found["light"]), (&true.into(), &[512, 256].into()));
    assert_eq!(found["texture"], serde_json::json!([texture_size(e)]));
    assert!((found["up"].as_f64().unwrap() - top(&e.estimate.mesh)).abs() < 1e-4, "{found}");
    let lamp = &found["lamps"][0];
    assert!(is_near(&lamp["place"], LAMP.center.map(f64::from)) && is_near(&lamp["color"], [1.0, 0.75, 0.5]), "{lamp}");
    assert!(lamp["watts"].as_f64().unwrap() > 0.0, "{lamp}");
}

fn is_near(found: &serde_json::Value, expected: [f64; 3]) -> bool {
    (0..3).all(|k| found[k].as_f64().is_some_and(|x| (x - expected[k]).abs() < 1e-5))
}

#[test]
fn colmap() {
    let Some(mut python) = python("pycolmap") else { return };
    let e = exported();
    let found = accepted(&python.arg(script("read.py")).arg("pycolmap").arg(&e.dir).output().unwrap());
    assert_eq!(found["images"], e.estimate.keyframes.len());
    let eyes = e.estimate.keyframes.iter().map(|k| k.world_from_camera.translation);
    let center: Vec<f64> = serde_json::from_value(found["center"].clone()).unwrap();
    let nearest = eyes.map(|p| p.distance(glam::DVec3::from_slice(&center))).fold(f64::INFINITY, f64::min);
    assert!(nearest < 1e-6, "{nearest}");
}

#[test]
fn openexr_tools() {
    let e = exported();
    if !Command::new("exrmakepreview").arg("-h").output().is_ok_and(|_| true) {
        eprintln!("skipped: OpenEXR's tools (exrmakepreview) are not on the PATH");
        return;
    }
    let out = e.dir.join("preview.exr");
    let picture = e.dir.join("picture.exr");
    ok(&["render", &arg(e.scan.join("result.lres")), "--size", "40x30", "-o", &arg(&picture)]);
    for file in [e.dir.join("light.exr"), picture] {
        accepted(&Command::new("exrmakepreview").arg(&file).arg(&out).output().unwrap());
    }
}

#[test]
fn browser() {
    let Some(mut node) = node("playwright-core") else { return };
    let chromium = std::env::var("CHROMIUM").unwrap_or_else(|_| "/usr/bin/chromium".into());
    if !Path::new(&chromium).exists() {
        eprintln!("skipped: {chromium} is not there (CHROMIUM names another)");
        return;
    }
    let e = exported();
    let page = e.scan.join("viewer.html");
    let rendering = e.dir.join("rendering.png");
    ok(&[
        "render",
        &arg(e.scan.join("result.lres")),
        "--view",
        "keyframe:0",
        "--size",
        "640x480",
        "-o",
        &arg(&rendering),
    ]);
    let panorama = e.dir.join("panorama.png");
    let pixels: Vec<u8> = (0..64 * 32).flat_map(|i| if i % 64 < 20 { [255, 240, 200] } else { [30, 40, 60] }).collect();
    estimator::export::picture::write_png(&panorama, 64, 32, &pixels).unwrap();
    let object = e.dir.join("result.glb");
    let lamp = arg(e.dir.join("lamp.lres"));
    let (lamp_page, lamp_rendering) = (e.dir.join("lamp.html"), e.dir.join("lamp.png"));
    ok(&["export", &lamp, "--to", "html", "-o", &arg(&lamp_page)]);
    let view = ["--view", "keyframe:0", "--size", "640x480"];
    ok(&[&["render", &lamp, "--lamp", "0=*2", "-o", &arg(&lamp_rendering)], &view[..]].concat());
    let files = [&page, &rendering, &panorama, &object, &lamp_page, &lamp_rendering];
    let output = node.arg(script("viewer.cjs")).args(files).output().unwrap();
    let report = accepted(&output);
    eprintln!("{report}");
    assert!(std::fs::metadata(&page).unwrap().len() < 8_000_000);
}
