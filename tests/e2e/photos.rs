//! `import photos`, `estimate`, `export`, and photos that cannot be used.

#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::{SIZE, arg, fails, json, ok};
use std::path::{Path, PathBuf};

/// A bumpy sheet, photographed from above by four cameras: `mesh.ply` (ASCII), `transforms.json`, four PNGs.
fn photos(dir: &Path) {
    std::fs::create_dir_all(dir.join("images")).unwrap();
    const N: usize = 24;
    let mut mesh = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        N * N,
        2 * (N - 1) * (N - 1)
    );
    for i in 0..N * N {
        let (x, y) = ((i % N) as f64 / 23.0 - 0.5, (i / N) as f64 / 23.0 - 0.5);
        mesh += &format!("{x} {y} {}\n", 0.08 * libm::sin(9.0 * x) * libm::cos(7.0 * y));
    }
    for i in 0..(N - 1) * (N - 1) {
        let a = i % (N - 1) + i / (N - 1) * N;
        mesh += &format!("3 {a} {} {}\n3 {a} {} {}\n", a + 1, a + N + 1, a + N + 1, a + N);
    }
    std::fs::write(dir.join("mesh.ply"), mesh).unwrap();
    let mut frames = Vec::new();
    for i in 0..4 {
        let pixels: Vec<u8> = (0..SIZE.0 * SIZE.1)
            .flat_map(|p| {
                let (x, y) = (p % SIZE.0, p / SIZE.0);
                [(90 + x / 2) as u8, (80 + y / 2) as u8, (100 + 10 * i + (x + y) % 7) as u8]
            })
            .collect();
        let name = format!("images/{i}.png");
        common::write_png(&dir.join(&name), png::ColorType::Rgb, png::BitDepth::Eight, &pixels);
        // OpenGL axes: the camera looks along its -Z, straight down.
        let (x, y) = (0.05 * f64::from(i) - 0.075, 0.02 * f64::from(i));
        frames.push(serde_json::json!({
            "file_path": name,
            "transform_matrix": [[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, 1.1], [0, 0, 0, 1]],
        }));
    }
    let (w, h) = SIZE;
    let document = serde_json::json!({
        "camera_model": "PINHOLE", "w": w, "h": h, "fl_x": 131.25, "fl_y": 131.25,
        "cx": f64::from(w) / 2.0 - 0.5, "cy": f64::from(h) / 2.0 - 0.5, "frames": frames,
    });
    std::fs::write(dir.join("transforms.json"), document.to_string()).unwrap();
}

/// Photos, and the scan made from them.
fn scan(dir: &Path) -> (PathBuf, PathBuf) {
    let (folder, file) = (dir.join("sheet"), dir.join("sheet.lscan"));
    photos(&folder);
    assert_eq!(ok(&["import", "photos", &arg(&folder), "-o", &arg(&file)]).trim(), arg(&file));
    (folder, file)
}

#[test]
fn photos_become_a_folder_that_scripts_read() {
    let dir = tempfile::tempdir().unwrap();
    let (_, scan) = scan(dir.path());
    let summary = json(&["inspect", &arg(&scan), "--json"]);
    assert_eq!((&summary["kind"], &summary["keyframes"]), (&"scan".into(), &4.into()));
    assert_eq!((&summary["vertices"], &summary["triangles"]), (&576.into(), &1058.into()));

    let result = dir.path().join("sheet.lres");
    assert_eq!(ok(&["estimate", &arg(&scan), "--rounds", "1"]).trim(), arg(&result), "beside the scan");
    let named = dir.path().join("named.lres");
    ok(&["estimate", &arg(&scan), "-o", &arg(&named), "--rounds", "1", "--threads", "1"]);
    assert!(std::fs::read(&result).unwrap() == std::fs::read(&named).unwrap(), "the same, byte for byte");

    let out = dir.path().join("out");
    ok(&["export", &arg(&result), "--to", "folder", "-o", &arg(&out)]);
    let read = |name: &str| -> serde_json::Value {
        serde_json::from_str(&std::fs::read_to_string(out.join(name)).unwrap()).unwrap()
    };
    let frames = read("poses.json")["frames"].as_array().unwrap().clone();
    let names: Vec<&str> = frames.iter().map(|f| f["file"].as_str().unwrap()).collect();
    assert_eq!(names, ["images/0.png", "images/1.png", "images/2.png", "images/3.png"], "as imported, in that order");
    // OpenCV axes: the camera's +Z looks down.
    assert!((frames[0]["camera_to_world"][2][2].as_f64().unwrap() + 1.0).abs() < 0.05, "{}", frames[0]);
    let gains = read("exposures.json");
    assert_eq!(gains["gain"].as_array().unwrap().len(), 4);
    assert_eq!(gains["timestamp"].as_array().unwrap().len(), 4);
    let rows = read("lighting_sh.json")["coefficients"].as_array().unwrap().len();
    assert!([1, 4, 9, 16, 25, 36, 49, 64, 81].contains(&rows), "{rows}");
    let segments = read("materials.json")["segments"].as_array().unwrap().clone();
    assert!(!segments.is_empty() && segments[0]["w_s"].is_number() && segments[0]["id"] == 0);
    let ply = std::fs::read(out.join("vertices.ply")).unwrap();
    let head = String::from_utf8_lossy(&ply[..700.min(ply.len())]).into_owned();
    for line in
        ["format binary_little_endian 1.0", "property float albedo_r", "property int segment", "property float nx"]
    {
        assert!(head.contains(line), "{line} in {head}");
    }
    assert!(fails(2, &["export", &arg(&result), "--to", "folder", "-o", &arg(&out)]).contains("name a new one"));

    let (mesh, light) = (dir.path().join("mesh.ply"), dir.path().join("light.hdr"));
    ok(&["export", &arg(&result), "--to", "ply", "-o", &arg(&mesh)]);
    ok(&["export", &arg(&result), "--to", "hdr", "-o", &arg(&light)]);
    assert!(std::fs::read(&mesh).unwrap().starts_with(b"ply\n"));
    assert!(std::fs::read(&light).unwrap().starts_with(b"#?RADIANCE\n"));
}

#[test]
fn photos_that_cannot_be_used_are_3() {
    type Case = (&'static str, &'static str, fn(&Path));
    let cases: [Case; 6] = [
        ("transforms.json", "no transforms", |f| std::fs::remove_file(f.join("transforms.json")).unwrap()),
        ("mesh.ply", "no mesh", |f| std::fs::remove_file(f.join("mesh.ply")).unwrap()),
        ("transforms.json", "NaN pose", |f| {
            let path = f.join("transforms.json");
            let text = std::fs::read_to_string(&path).unwrap();
            // JSON has no NaN; 1e999 is infinity where it is read at all.
            std::fs::write(path, text.replacen("[1,0,0,", "[1e999,0,0,", 1)).unwrap();
        }),
        ("transforms.json", "no rotation", |f| {
            let path = f.join("transforms.json");
            let text = std::fs::read_to_string(&path).unwrap();
            std::fs::write(path, text.replacen("[1,0,0,", "[0,0,0,", 1)).unwrap();
        }),
        ("mesh.ply", "no triangles", |f| {
            let path = f.join("mesh.ply");
            let text = std::fs::read_to_string(&path).unwrap();
            let vertices: Vec<&str> = text.lines().filter(|l| !l.starts_with("3 ")).collect();
            std::fs::write(path, vertices.join("\n").replace("element face 1058", "element face 0")).unwrap();
        }),
        ("images/2.png", "cut picture", |f| {
            let path = f.join("images/2.png");
            let bytes = std::fs::read(&path).unwrap();
            std::fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
        }),
    ];
    for (file, case, spoil) in cases {
        let dir = tempfile::tempdir().unwrap();
        let (folder, output) = (dir.path().join("sheet"), dir.path().join("sheet.lscan"));
        photos(&folder);
        spoil(&folder);
        let message = fails(3, &["import", "photos", &arg(&folder), "-o", &arg(&output)]);
        assert!(message.contains(file), "{case}: {message}");
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "{case}: only the photos");
    }
}
