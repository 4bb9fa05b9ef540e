//! `config`, `--help`, `--version`, and what the command line refuses.

#![allow(clippy::unwrap_used, reason = "these are tests")]

mod common;

use common::{arg, fails, json, ok, run, text};

#[test]
fn help_and_version_are_results() {
    let version = ok(&["--version"]);
    assert!(version.starts_with("lumiscan ") && version.contains("-linux-"), "{version}");
    let help = ok(&["--help"]);
    for command in ["replay", "estimate", "import", "export", "config", "inspect", "Exit codes"] {
        assert!(help.contains(command), "{command} in {help}");
    }
    for command in ["replay", "estimate", "import", "export", "config", "inspect"] {
        assert!(ok(&[command, "--help"]).contains("Examples"), "{command}");
    }
}

#[test]
fn config_prints_a_file_that_config_reads() {
    let printed = ok(&["config"]);
    assert!(printed.contains("voxel_size_m = 0.005"), "{printed}");
    assert!(printed.contains("c1, Eq. (1)") && printed.contains("unit m · range 0.01"), "{printed}");
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("a.toml");
    std::fs::write(&file, &printed).unwrap();
    let file = arg(file);
    assert_eq!(ok(&["config", "--config", &file]), printed);
    let changed = ok(&["config", "--config", &file, "--set", "fusion.voxel_size_m=0.01"]);
    assert!(changed.contains("voxel_size_m = 0.01\n"), "{changed}");
}

#[test]
fn config_as_json_has_every_setting_with_unit_range_and_default() {
    let settings = json(&["config", "--json"]);
    let all = settings.as_array().unwrap();
    assert!(all.len() > 30, "{}", all.len());
    let voxel = all.iter().find(|s| s["key"] == "fusion.voxel_size_m").unwrap();
    assert_eq!((&voxel["default"], &voxel["unit"]), (&0.005.into(), &"m".into()));
    assert_eq!(voxel["range"], "0.001 … 0.1");
}

#[test]
fn usage_errors_are_2() {
    for args in [
        &[][..],
        &["frobnicate"],
        &["replay"],
        &["replay", "x", "--budget", "0"],
        &["replay", "x", "--budget", "NaN"],
        &["replay", "x", "--rounds", "0"],
        &["replay", "x", "--threads", "0"],
        &["replay", "x", "--loop", "0"],
        &["estimate", "x", "--budget", "-1"],
        &["export", "x", "--to", "vrml", "-o", "y"],
        &["export", "x", "--to", "ply"],
        &["import", "photos", "x"],
    ] {
        fails(2, args);
    }
    assert!(fails(2, &["import", "tum", "x", "-o", "y.lrec", "--mesh", "m.ply"]).contains("--mesh"));
    assert!(fails(2, &["import", "tum", "x", "-o", "/nowhere/y.lrec"]).contains("/nowhere"));
}

#[test]
fn config_errors_are_2_and_name_the_key() {
    let dir = tempfile::tempdir().unwrap();
    let device = arg(dir.path().join("device"));
    let source = arg(dir.path());
    let replay = |set: &str| fails(2, &["replay", &source, "--device", &device, "--set", set]);
    assert!(replay("fusion.voxel_sise_m=0.01").contains("fusion.voxel_size_m"));
    assert!(replay("fusion.voxel_size_m=7").contains("0.001"));
    assert!(replay("fusion.voxel_size_m=nan").contains("fusion.voxel_size_m"));
    assert!(replay("nonsense").contains("nonsense"));

    let file = dir.path().join("bad.toml");
    for (content, expected) in [
        ("[fusion]\nvoxel_sise_m = 0.01\n", "voxel_size_m"),
        ("[fusion]\nvoxel_size_m = 7\n", "0.001"),
        ("[fusion\n", "bad.toml"),
    ] {
        std::fs::write(&file, content).unwrap();
        let message = fails(2, &["replay", &source, "--device", &device, "--config", &arg(&file)]);
        assert!(message.contains(expected) && message.contains("bad.toml"), "{message}");
    }
    let missing = fails(2, &["replay", &source, "--device", &device, "--config", "/nowhere.toml"]);
    assert!(missing.contains("/nowhere.toml") && missing.contains("lumiscan config"), "{missing}");
    assert!(!dir.path().join("device").exists(), "the device folder is untouched");
}

#[test]
fn json_errors_are_json() {
    let output = run(&["--json", "inspect", "/nowhere.lres"]);
    assert_eq!(output.status.code(), Some(3));
    let line: serde_json::Value = serde_json::from_str(text(&output.stderr).trim()).unwrap();
    assert_eq!((&line["level"], &line["exit_code"]), (&"ERROR".into(), &3.into()));
    assert!(line["message"].as_str().unwrap().contains("/nowhere.lres"));
}
