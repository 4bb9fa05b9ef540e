//! OpenNI2 as a source (feature `openni`; see capture/README.md).

#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::{arg, fails, json, run, text};
use tests::shared;

#[test]
#[cfg_attr(not(shared), ignore = "needs LUMISCAN_SHARED: kinect/depth30.oni")]
fn an_oni_file_plays() {
    let shared = shared();
    let (file, dir) = (arg(shared.join("kinect/depth30.oni")), tempfile::tempdir().unwrap());
    let path = arg(dir.path().join("a.lrec"));
    assert_eq!(json(&["--json", "record", &path, "--openni", &file])["depth_frames"], 30);
    let seen = json(&["--json", "inspect", &path]);
    assert_eq!((&seen["depth"]["frames"], &seen["color"]["frames"]), (&30.into(), &0.into()), "{seen}");
    let size = &seen["sensor"]["depth"]["intrinsics"];
    assert!(size["width"] == 320 && size["height"] == 240, "{seen}");
    // Its field of view of 58 degrees.
    assert!((size["fx"].as_f64().unwrap() - 287.7).abs() < 1.0, "{seen}");
    // A scan needs colour, too.
    let replayed = run(&["replay", &file, "--no-estimate", "--device", &arg(dir.path())]);
    assert!(replayed.status.code() == Some(4) && text(&replayed.stderr).contains("holds no colour"));
}

#[test]
fn what_is_no_oni_file_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.oni");
    std::fs::write(&path, b"no recording").unwrap();
    assert!(fails(3, &["replay", &arg(&path), "--device", &arg(dir.path())]).contains("OpenNI2"));
}
