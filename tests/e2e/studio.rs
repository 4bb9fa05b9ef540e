//! Many scans: what an engine that runs the executable relies on, and `tools/studio`, which gives scans to HyperQueue. Its tests are in
//! Python; where the package `hyperqueue` is not installed they print that they were skipped. `.ci/run` installs it.

#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::{EXECUTABLE, arg, lumiscan, python, small_scan, text};
use serde_json::Value;
use std::path::Path;

/// The line that `estimate` prints, and its exit code.
fn estimate(scan: &Path, more: &[&str]) -> (Value, i32) {
    let output = lumiscan().args(["--json", "estimate", &arg(scan), "--if-changed"]).args(more).output().unwrap();
    let printed = text(&output.stdout);
    assert_eq!(printed.lines().count(), 1, "{printed}{}", text(&output.stderr));
    (serde_json::from_str(&printed).unwrap(), output.status.code().unwrap())
}

#[test]
fn a_result_is_made_again_when_something_changed() {
    let dir = tempfile::tempdir().unwrap();
    let scan = small_scan(dir.path(), &["--no-estimate"]).join("scan.lscan");
    let result = scan.with_file_name("result.lres");
    let outcome = |more: &[&str]| {
        let (line, code) = estimate(&scan, more);
        assert_eq!((code, &line["exit_code"]), (0, &0.into()), "{line}");
        (line["outcome"].as_str().unwrap().to_owned(), std::fs::read(&result).unwrap(), line)
    };
    let (first, bytes, line) = outcome(&["--rounds", "1"]);
    assert_eq!(first, "done");
    for digest in ["scan", "settings"] {
        assert_eq!(line["origin"][digest].as_str().unwrap().len(), 64, "{line}");
    }
    assert!(line["cpu_seconds"].as_f64().unwrap() > 0.0 && line["vertices"].as_u64().unwrap() > 100, "{line}");
    let (again, same, unchanged) = outcome(&["--rounds", "1", "--threads", "1"]);
    assert_eq!((again.as_str(), same == bytes), ("unchanged", true));
    assert_eq!((&unchanged["decisions"], &unchanged["origin"]), (&line["decisions"], &line["origin"]));
    // Other settings; another scan; a damaged result; a picture that is missing.
    assert_eq!(outcome(&["--rounds", "2"]).0, "done");
    assert_eq!(outcome(&["--rounds", "1"]).0, "done");
    let other = small_scan(dir.path(), &["--no-estimate"]).join("scan.lscan");
    std::fs::write(&scan, std::fs::read(&other).unwrap()).unwrap();
    assert_eq!(outcome(&["--rounds", "1"]).0, "unchanged", "the same scan, from another run");
    std::fs::write(&result, &bytes[..bytes.len() / 2]).unwrap();
    let (healed, whole, _) = outcome(&["--rounds", "1"]);
    assert_eq!((healed.as_str(), whole == bytes), ("done", true));
    let preview = arg(dir.path().join("preview.png"));
    assert_eq!(outcome(&["--rounds", "1", "--preview", &preview]).0, "done");
    assert_eq!(outcome(&["--rounds", "1", "--preview", &preview]).0, "unchanged");
}

#[test]
fn the_line_says_whether_to_try_again() {
    let dir = tempfile::tempdir().unwrap();
    let scan = small_scan(dir.path(), &["--no-estimate"]).join("scan.lscan");
    // More than the least limits hold, the program itself not counted.
    let large = small_scan(dir.path(), &["--no-estimate", "--set", "fusion.voxel_size_m=0.015"]).join("scan.lscan");
    let bad = dir.path().join("bad.lscan");
    std::fs::write(&bad, &std::fs::read(&scan).unwrap()[..1000]).unwrap();
    for (scan, more, code, retry) in [
        (&bad, &[][..], 3, "never"),
        (&large, &["--memory", "16", "--rounds", "1"], 6, "elsewhere"),
        (&large, &["--memory", "20", "--threads", "1", "--rounds", "1"], 6, "elsewhere"),
    ] {
        let (line, status) = estimate(scan, more);
        assert_eq!((status, &line["exit_code"]), (code, &code.into()), "{line}");
        assert_eq!((&line["outcome"], &line["retry"]), (&"failed".into(), &retry.into()), "{line}");
        assert!(line["problem"].is_string(), "{line}");
    }
    assert!(!large.with_file_name("result.lres").exists());
}

#[test]
fn scans_through_hyperqueue() {
    let Some(mut python) = python("hyperqueue") else { return };
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tools/studio");
    let command =
        python.args(["-m", "unittest", "discover", "--start-directory", "tests", "--top-level-directory", "."]);
    let output = command.current_dir(folder).env("LUMISCAN", EXECUTABLE).output().unwrap();
    println!("{}", text(&output.stderr));
    assert!(output.status.success(), "{}", text(&output.stderr));
}
