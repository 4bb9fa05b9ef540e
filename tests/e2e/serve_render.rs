//! Pictures of finished scans through the web page: what `lumiscan render` makes, byte for byte, one at a time, and from the viewer in a
//! browser.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "these are tests")]

mod common;

use common::http::Served;
use common::{arg, ok, scanned_table, text};
use serde_json::{Value, json};
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

/// A box with a simulated Kinect and the synthetic table as its one scan.
fn box_with_a_scan(name: &str) -> (Served, std::path::PathBuf, String) {
    let (folder, scan) = scanned_table(name);
    let device = arg(folder.join("device"));
    let args = ["capture", "--device", &device, "--simulate", "pattern", "--serve", "127.0.0.1:0"];
    let mut s = Served::start(&folder, &[&args[..], &["--set", "daemon.min_free_mb=1"]].concat());
    s.wait("ready", |s| s["state"] == "ready");
    let id = scan.file_name().unwrap().to_str().unwrap().to_owned();
    (s, scan, id)
}

/// A tetrahedron of 4 cm.
const OBJECT: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 4\n\
property list uchar int vertex_indices\nend_header\n-0.04 -0.03 0\n0.04 -0.03 0\n0 0.05 0\n0 0 0.06\n\
3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n";

/// Waits for the end of the job; its last report.
fn done(s: &Served) -> Value {
    let began = Instant::now();
    loop {
        let job = s.get("/api/scans").json()["job"].clone();
        if job["done"] == true {
            return job;
        }
        assert!(began.elapsed() < Duration::from_secs(240), "{job}\n{}", s.log());
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn a_picture_is_what_the_command_renders() {
    let (s, scan, id) = box_with_a_scan("serve_render");
    let render = |wish: &Value| s.post(&format!("/api/scans/{id}/render"), &wish.to_string());
    assert_eq!(s.get("/api/render.png").status, 404);
    let insert = json!([{ "object": "thing.ply", "at": [0.0, 0.0, 0.0], "yaw": 20, "scale": 1.5 }]);
    let wish = json!({ "view": "keyframe:1", "over": "photo", "insert": insert, "size": null });
    let refused = render(&wish);
    assert!(refused.status == 400 && refused.text().contains("send the file first"), "{}", refused.text());

    // The file comes in pieces; one that does not follow the last is refused.
    let (first, rest) = OBJECT.split_at(100);
    assert_eq!(s.post("/api/render/files/thing.ply", first).status, 200);
    assert_eq!(s.post("/api/render/files/thing.ply?offset=7", rest).status, 409);
    assert_eq!(s.post("/api/render/files/thing.ply?offset=100", rest).json()["bytes"], OBJECT.len());
    assert_eq!(s.post("/api/render/files/..%5cthing.ply", rest).status, 404);
    assert_eq!(s.post("/api/render/files/thing.sh", rest).status, 400);

    assert_eq!(render(&wish).status, 200);
    // One at a time: everything else that would work on scans is refused meanwhile, and says why.
    let busy = [
        render(&wish),
        s.post("/api/render/files/thing.ply", OBJECT),
        s.post(&format!("/api/scans/{id}/estimate"), "{\"quality\": \"draft\"}"),
        s.ask("DELETE", "/api/render/files", &s.access, ""),
        s.ask("DELETE", &format!("/api/scans/{id}"), &s.access, ""),
    ];
    for reply in &busy {
        assert!(reply.status == 409 && reply.text().contains("wait"), "{} {}", reply.status, reply.text());
    }
    assert_eq!(done(&s)["problem"], Value::Null);
    let object = scan.join("../../thing.ply");
    std::fs::write(&object, OBJECT).unwrap();
    let (out, insert) = (arg(scan.join("../../own.png")), format!("{}@0,0,0,20,1.5", arg(&object)));
    let result = arg(scan.join("result.lres"));
    ok(&["render", &result, "--view", "keyframe:1", "--over", "photo", "--insert", &insert, "-o", &out]);
    let picture = s.get("/api/render.png");
    assert_eq!((picture.status, picture.headers["content-type"].as_str()), (200, "image/png"));
    assert!(picture.body == std::fs::read(&out).unwrap(), "the same picture");

    // What cannot be rendered is told.
    assert_eq!(render(&json!({ "view": "keyframe:99" })).status, 200);
    let problem = done(&s)["problem"].as_str().unwrap_or_default().to_owned();
    assert!(problem.contains("there is no keyframe 99"), "{problem}");
    assert_eq!(s.get("/api/render.png").status, 404, "an older picture is none of this");
    assert_eq!(render(&json!({ "view": "/etc/x.json" })).status, 400);
    assert_eq!(render(&json!({ "sise": [1, 1] })).status, 400);
    assert_eq!(s.post("/api/scans/none/render", "{}").status, 404);
    s.signal("-TERM");
    assert_eq!(s.ended().0, Some(0));
}

#[test]
fn a_view_of_the_viewer_is_rendered() {
    let chromium = std::env::var("CHROMIUM").unwrap_or_else(|_| "/usr/bin/chromium".into());
    let playwright = Command::new("node").args(["-e", "require.resolve('playwright-core')"]).output();
    if !Path::new(&chromium).exists() || !playwright.is_ok_and(|o| o.status.success()) {
        eprintln!("skipped: Chromium or the npm package playwright-core is not there (CHROMIUM, NODE_PATH)");
        return;
    }
    let (s, scan, id) = box_with_a_scan("serve_render_page");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/foreign/render_page.cjs");
    let url = format!("http://{}/?code={}", s.host, s.code);
    let folder = arg(scan.join("../../.."));
    let output = Command::new("node").arg(script).args([&url, &id, &folder]).output().unwrap();
    let report = format!("{}{}", text(&output.stdout), text(&output.stderr));
    assert!(output.status.success(), "{report}\n{}", s.log());
    eprintln!("{report}");
}
